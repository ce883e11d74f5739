"""A drone that ullage flies through gz-sim along the world's path, its radars live: world:=ntnu-mapping rviz:=true.

`gazebo_server` starts gz-sim with the world and the drone, `gazebo_pilot` flies it, and `ullage run` is its radars.
"""

from pathlib import Path

from ament_index_python.packages import get_package_share_directory
from launch import LaunchDescription
from launch.actions import DeclareLaunchArgument, ExecuteProcess, SetEnvironmentVariable
from launch.conditions import IfCondition
from launch.substitutions import LaunchConfiguration
from launch_ros.actions import Node
from ullage_ros.gazebo import NAME

ARGUMENTS = {
    "world": ("ntnu-mapping", "library world (ullage list)"),
    "fidelity": ("physical", "physical, or thesis for the ray model of 2018"),
    "speed_m_s": ("0.5", "on the path"),
    "server": ("gz sim", "command that starts gz-sim; with -s it opens no window"),
    "out": ("runs", "folder for the run"),
    "rviz": ("false", "also show drone, beams, rays and map"),
}


def generate_launch_description() -> LaunchDescription:
    """What to start."""
    of, shown = LaunchConfiguration, IfCondition(LaunchConfiguration("rviz"))
    share = Path(get_package_share_directory("ullage_ros"))
    urdf = share / "urdf" / "quadrotor.urdf"
    model = urdf.read_text().replace('type="continuous"', 'type="fixed"')  # RViz needs no states of the motors
    radars = ["gazebo:?world=", of("world"), f"&model={NAME}&rig={urdf}&fidelity=", of("fidelity")]
    mapping = ["--do", "detect,map", "--force", "--out", of("out"), "--to", "ros2:?rays=true"]
    return LaunchDescription(
        [
            *(DeclareLaunchArgument(name, default_value=v, description=d) for name, (v, d) in ARGUMENTS.items()),
            SetEnvironmentVariable("GZ_IP", "127.0.0.1"),
            SetEnvironmentVariable("IGN_IP", "127.0.0.1"),
            Node(package="ullage_ros", executable="gazebo_server", arguments=[of("world"), of("server")]),
            Node(package="ullage_ros", executable="gazebo_pilot", arguments=[of("world"), of("speed_m_s")]),
            ExecuteProcess(cmd=["ullage", "run", radars, *mapping], output="screen"),
            Node(
                package="robot_state_publisher",
                executable="robot_state_publisher",
                parameters=[{"robot_description": model}],
                condition=shown,
            ),
            Node(
                package="rviz2",
                executable="rviz2",
                arguments=["-d", str(share / "config" / "ullage.rviz")],
                parameters=[{"use_sim_time": True}],
                condition=shown,
            ),
        ]
    )
