"""Poses from radars and an inertial unit."""
