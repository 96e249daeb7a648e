"""
What the memory makes of its histories: methods, regions, explanations.

In: a VoxelMemory and settings. Out: a label and a source for every voxel.
Enters memory/ and geometry/; the pipeline, a replay, mosaic, outputs, evaluate and the node enter
here.

"""
