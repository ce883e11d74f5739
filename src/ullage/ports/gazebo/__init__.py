"""Gazebo (gz-sim, Fortress and later): simulate the radars of a model in its world and publish their frames."""
