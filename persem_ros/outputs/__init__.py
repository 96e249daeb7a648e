"""
Results become files; nothing here imports ROS.

Rooms: map/ (the map file, PLY), recording/ (rosbag2), results/ (folder, numbers), report/.
Entered by replay, evaluate, convert, simulate, commands and the node.

"""
