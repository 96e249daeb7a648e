"""
The map as a flat grid for vehicles on the ground: what a cell costs and what it is.

In: voxels of a map, and the costs of the legend. Out: costs 0 .. 100, -1 unknown, and classes.
Entered by the export --grid and by the node's ~/grid.

"""
