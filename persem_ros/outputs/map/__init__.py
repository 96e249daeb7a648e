"""
The map as files: map.persem, map.ply, explanations in words.

In: a VoxelMemory. Out: files, and a VoxelMemory from them.
Entered by replay, commands and the node.

"""
