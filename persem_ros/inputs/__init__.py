"""
Sensors or recordings become frames; nothing here imports ROS.

Rooms: decode/ (messages to arrays), sync/ (what belongs together), recording/ (rosbag2).
Entered by preflight, replay, convert, evaluate and the node.

"""
