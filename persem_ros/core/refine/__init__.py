"""
What the memory makes of its histories: methods, regions, explanations.

In: a VoxelMemory and settings. Out: a label and a source for every voxel.
Enters memory/; the pipeline, outputs, evaluate and the node enter here.

"""
