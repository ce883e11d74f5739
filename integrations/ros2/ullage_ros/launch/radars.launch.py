"""Radars on a robot that others move, and a map of what they see: world:=NAME pose:=TOPIC rviz:=true.

For a second drone: namespace:=drone2 frame_prefix:=drone2/ pose:=/drone2/odom.
"""

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
    "namespace": ("", "of the topics, as drone2"),
    "frame_prefix": ("", "before all frames of reference but map, as drone2/"),
    "tf": ("/tf", "the topic /tf under another name"),
    "tf_static": ("/tf_static", "the topic /tf_static under another name"),
    "map": ("map", "the topic map under another name"),
    "map_updates": ("map_updates", "the topic map_updates under another name"),
    "method": ("ullage", "of mapping: ullage, likelihood, or elfes as in 2018"),
    "mapping": ("true", "also map"),
    "rviz": ("false", "also show"),
}


def generate_launch_description() -> LaunchDescription:
    """What to start."""
    of = LaunchConfiguration
    rviz = PathJoinSubstitution([FindPackageShare("ullage_ros"), "config", "ullage.rviz"])
    simulator = {
        "simulate": of("world"),
        "pose": of("pose"),
        "rig": of("rig"),
        "fidelity": of("fidelity"),
        "frame_prefix": of("frame_prefix"),
    }
    mapping = {"method": of("method"), "frame_prefix": of("frame_prefix")}
    remapped = [
        ("/tf", of("tf")),
        ("/tf_static", of("tf_static")),
        ("map", of("map")),
        ("map_updates", of("map_updates")),
    ]
    return LaunchDescription(
        [
            *(DeclareLaunchArgument(name, default_value=v, description=d) for name, (v, d) in ARGUMENTS.items()),
            Node(
                package="ullage_ros",
                executable="radar_simulator",
                namespace=of("namespace"),
                parameters=[simulator],
                remappings=remapped,
                output="screen",
            ),
            Node(
                package="ullage_ros",
                executable="radar_mapping",
                namespace=of("namespace"),
                parameters=[mapping],
                remappings=remapped,
                condition=IfCondition(of("mapping")),
            ),
            Node(package="rviz2", executable="rviz2", arguments=["-d", rviz], condition=IfCondition(of("rviz"))),
        ]
    )
