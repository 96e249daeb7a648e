"""
A simulated flight: world, path, camera and a segmenter that makes mistakes.

In: a Plan. Out: frames with truth, or a recording of them.
Entered by commands, tests and benchmarks.

"""
