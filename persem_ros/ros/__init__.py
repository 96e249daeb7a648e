"""
The ROS 2 node: the only place that imports rclpy and messages. Start at node.py.

In: parameters, topics, services. Out: label images, the map, diagnostics.
Nobody enters but `ros2 run persem_ros mapper`.

"""
