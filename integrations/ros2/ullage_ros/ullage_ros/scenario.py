"""What the launch files of the scenarios share."""

from launch import LaunchDescription
from launch.actions import DeclareLaunchArgument, ExecuteProcess
from launch.conditions import IfCondition
from launch.substitutions import LaunchConfiguration, PathJoinSubstitution
from launch_ros.actions import Node
from launch_ros.substitutions import FindPackageShare

ARGUMENTS = {
    "pace": ("1", "times real time"),
    "namespace": ("", "of the topics, as /drone2"),
    "frame_prefix": ("", "before all frames of reference but map, as drone2/"),
    "remap": ("", "topics under other names: FROM:=TO, with commas between"),
    "out": ("runs", "folder for the run; each of two drones needs its own"),
    "rviz": ("false", "also show"),
}


def describe(scenario: str) -> LaunchDescription:
    """A scenario that ullage flies by itself, published in real time.

    Args:
        scenario: its name, as `ullage list` tells it.
    """
    rviz = PathJoinSubstitution([FindPackageShare("ullage_ros"), "config", "ullage.rviz"])
    of = LaunchConfiguration
    sink = ["ros2:", of("namespace"), "?linger_s=60&pace=", of("pace")]
    sink += ["&frame_prefix=", of("frame_prefix"), "&remap=", of("remap")]
    command = ["ullage", "run", scenario, "--force", "--out", of("out"), "--to", sink]
    return LaunchDescription(
        [
            *(DeclareLaunchArgument(name, default_value=v, description=d) for name, (v, d) in ARGUMENTS.items()),
            ExecuteProcess(cmd=command, output="screen"),
            Node(
                package="rviz2",
                executable="rviz2",
                arguments=["-d", rviz],
                parameters=[{"use_sim_time": True}],
                condition=IfCondition(of("rviz")),
            ),
        ]
    )
