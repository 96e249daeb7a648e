"""
A rosbag2 recording as messages and as frames, whatever its storage or damage.

In: a folder or file. Out: raw messages, topics in use, Frames in stamp order.
Entered by preflight, replay, mosaic, evaluate, commands and outputs/report; the node asks it which
topics a camera has (kinds.py).

"""
