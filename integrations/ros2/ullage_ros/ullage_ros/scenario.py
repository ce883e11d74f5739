"""What the launch files of the scenarios share."""

from launch import LaunchDescription
from launch.actions import DeclareLaunchArgument, ExecuteProcess
from launch.conditions import IfCondition
from launch.substitutions import LaunchConfiguration, PathJoinSubstitution
from launch_ros.actions import Node
from launch_ros.substitutions import FindPackageShare


def describe(scenario: str) -> LaunchDescription:
    """A scenario that ullage flies by itself, published in real time.

    Args:
        scenario: its name, as `ullage list` tells it.
    """
    rviz = PathJoinSubstitution([FindPackageShare("ullage_ros"), "config", "ullage.rviz"])
    sink = ["ros2:?linger_s=60&pace=", LaunchConfiguration("pace")]
    return LaunchDescription(
        [
            DeclareLaunchArgument("pace", default_value="1", description="times real time"),
            DeclareLaunchArgument("rviz", default_value="false", description="also show"),
            ExecuteProcess(cmd=["ullage", "run", scenario, "--force", "--to", sink], output="screen"),
            Node(
                package="rviz2",
                executable="rviz2",
                arguments=["-d", rviz],
                parameters=[{"use_sim_time": True}],
                condition=IfCondition(LaunchConfiguration("rviz")),
            ),
        ]
    )
