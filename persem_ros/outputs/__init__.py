"""Results become files; nothing here imports ROS."""
