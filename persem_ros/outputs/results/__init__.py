"""
A run as a folder: metrics, timing, versions, and that nothing half-written lies there.

The map of a replay begins here, whole in memory (mapped.py) or a part of a file (paged.py).
In: counts of labels. Out: metrics.json, timing.json, a Rerun log.
Entered by replay, mosaic and evaluate.

"""
