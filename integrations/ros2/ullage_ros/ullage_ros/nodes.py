"""The nodes, from the Python package ullage."""

from ullage.experiments.ros2_nodes import radar_mapping, radar_simulator

__all__ = ["radar_mapping", "radar_simulator"]
