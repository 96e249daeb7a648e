"""
The map for other programs: LAZ, GeoTIFF, meshes, tables, cost maps.

In: a map file, read a few blocks at a time, so that a map may be larger than memory.
Out: files that the programs of their users open.
Entered by commands, tiles/, view/, results/ and persem_ros.open_map.

"""
