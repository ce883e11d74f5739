"""Gazebo (gz-sim and Classic): simulate the radars of a model in its world and publish their frames."""
