"""
The algorithm: frames in, a map and label images out; numpy and numba only.

Rooms: frame/ (pixels and voxels), memory/ (what was seen), geometry/ (what shapes say of it),
refine/ (what is made of it). Everybody may enter; nothing in here knows ROS, files or the command
line.

"""
