"""Sensors or recordings become frames; nothing here imports ROS."""
