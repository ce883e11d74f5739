"""The scenario ntnu-wire: pace:=1 namespace:=/drone1 frame_prefix:=drone1/ rviz:=false."""

from launch import LaunchDescription
from ullage_ros.scenario import describe


def generate_launch_description() -> LaunchDescription:
    """What to start."""
    return describe("ntnu-wire")
