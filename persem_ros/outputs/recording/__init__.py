"""
Recordings as we write them: rosbag2 without ROS.

In: arrays, stamps, frames. Out: a folder with mcap or sqlite3.
Entered by replay, convert, simulate, commands and the node.

"""
