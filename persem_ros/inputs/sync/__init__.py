"""
What belongs to one instant: pairs of images, poses between stamps, clocks.

In: arrays with stamps in any order. Out: matches in the order of their stamps.
No ROS, no clock, no randomness; live and replay share it.

"""
