"""Radars on a robot that others move, and a map of what they see: world:=NAME pose:=TOPIC rviz:=true."""

from launch import LaunchDescription
from launch.actions import DeclareLaunchArgument
from launch.conditions import IfCondition
from launch.substitutions import LaunchConfiguration, PathJoinSubstitution
from launch_ros.actions import Node
from launch_ros.substitutions import FindPackageShare

ARGUMENTS = {
    "world": ("ntnu-room", "library world (ullage list) or an .sdf file"),
    "pose": ("/odom", "topic of the robot's pose: Odometry, PoseStamped, PoseWithCovarianceStamped or TFMessage"),
    "rig": ("thesis-4", "radars: thesis-4, single, or an .sdf or .urdf file that declares them"),
    "fidelity": ("physical", "physical, or thesis for the ray model of 2018"),
    "mapping": ("true", "also map"),
    "rviz": ("false", "also show"),
}


def generate_launch_description() -> LaunchDescription:
    """What to start."""
    of = LaunchConfiguration
    rviz = PathJoinSubstitution([FindPackageShare("ullage_ros"), "config", "ullage.rviz"])
    simulator = {"simulate": of("world"), "pose": of("pose"), "rig": of("rig"), "fidelity": of("fidelity")}
    return LaunchDescription(
        [
            *(DeclareLaunchArgument(name, default_value=v, description=d) for name, (v, d) in ARGUMENTS.items()),
            Node(package="ullage_ros", executable="radar_simulator", parameters=[simulator], output="screen"),
            Node(package="ullage_ros", executable="radar_mapping", condition=IfCondition(of("mapping"))),
            Node(package="rviz2", executable="rviz2", arguments=["-d", rviz], condition=IfCondition(of("rviz"))),
        ]
    )
