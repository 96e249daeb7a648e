"""
Messages to arrays: images, compressed images, cameras.

In: messages of rclpy or rosbags, alike. Out: numpy arrays, or a BadMessage.
Enters nothing beside it; all other rooms of inputs enter here.

"""
