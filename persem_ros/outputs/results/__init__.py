"""
A run as a folder: metrics, timing, versions, and that nothing half-written lies there.

In: counts of labels. Out: metrics.json, timing.json, config.yaml, a Rerun log.
Entered by replay and evaluate.

"""
