"""
The map as 3D Tiles: an octree of point clouds, coarse from afar and every voxel close by.

In: a map file, read by blocks. Out: tileset.json and .glb as OGC 3D Tiles 1.1 has them. Entered
by the viewer, which makes tiles when they are asked for, and by the export --tiles.

"""
