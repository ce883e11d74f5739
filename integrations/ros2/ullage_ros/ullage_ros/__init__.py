"""Entry points of ullage for ROS 2."""
