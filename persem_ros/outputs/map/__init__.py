"""
The map as files: map.persem, map.ply, explanations in words.

In: a VoxelMemory. Out: files, and a VoxelMemory from them.
Entered by the other rooms of outputs, replay, mosaic, evaluate, commands, open_map and the node.

"""
