"""The algorithm: arrays in, arrays out; knows nothing of ROS, files or the command line."""
