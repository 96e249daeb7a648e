"""
Results become files; nothing here imports ROS.

Rooms: map/ (the map file, PLY), recording/ (rosbag2), results/ (folder, numbers), report/ (page),
export/ (files of other programs), grid/ (costs), tiles/ and view/ (the map in a browser).
Entered by replay, mosaic, evaluate, convert, simulate, commands, open_map and the node.

"""
