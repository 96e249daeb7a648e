"""
The voxel memory: pools, blocks under a hash, histories, evidence, what is let go.

In: Observations, a MemoryDump. Out: columns of voxels, histories, a MemoryDump.
Entered by frame/, refine/, pipeline, preflight, outputs; enters none of them.

"""
