"""
The work: tasks side by side, the stream of frames, what a result was made of.

In: recordings and settings. Out: counts of all methods, pictures to choose from.
Enters measure/; entered by run.py and sweep.py, and by mosaic for its tasks.

"""
