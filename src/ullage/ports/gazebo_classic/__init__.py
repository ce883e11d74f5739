"""Gazebo Classic 11: simulate the radars of a model in its world and publish their frames."""
