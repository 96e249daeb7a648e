"""
Sensors or recordings become frames; nothing here imports ROS.

Rooms: decode/ (messages to arrays), sync/ (what belongs together), recording/ (rosbag2); beside
them intake.py, which leads through these, and live.py, the same for messages as they arrive.
Entered by preflight, replay, mosaic, convert, simulate, evaluate, outputs/report and the node.

"""
