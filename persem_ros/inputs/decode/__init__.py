"""
Messages to arrays: images, clouds, cameras, poses, tables of class names.

In: messages of rclpy or rosbags, alike. Out: numpy arrays, or a BadMessage.
Enters nothing beside it; the other rooms of inputs, preflight and the node enter here.

"""
