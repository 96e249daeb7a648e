"""
The voxel memory: pools, blocks under a hash, histories, evidence, what is let go.

In: Observations, a MemoryDump. Out: columns of voxels, histories, a MemoryDump.
Entered by the other rooms of core, the pipeline, and whoever holds a map; enters none of them.

"""
