"""The managed nodes, driven through their services by a real client as `ros2 lifecycle set` would."""

from __future__ import annotations

import subprocess
import time

import pytest

from .network import Network, result_of

pytestmark = pytest.mark.ros2


def interrupted(node: subprocess.Popen[str]) -> str:
    """What a node said as an error once Ctrl-C has ended it."""
    node.send_signal(2)
    _, err = node.communicate(timeout=120)
    assert node.returncode == 0, err
    return err


def test_a_node_goes_through_its_states_and_refuses_what_it_cannot(network: Network) -> None:
    robot = network.ready("move.py")
    node = network.start(
        "-m", "ullage.experiments.ros2_nodes", "radar_simulator", "--ros-args", "-p", "autostart:=false",
        "-p", "simulate:=nowhere", "-p", "pose:=/robot/odom", "-p", "fidelity:=thesis",
    )  # fmt: skip
    got = result_of(network.start("drive.py", "/radar_simulator", "/radar/front/range"))
    assert got["first"] == ["unconfigured", False]  # no such world
    assert got["parameter"]
    assert got["states"] == ["inactive", "active", "inactive", "unconfigured", "inactive", "active"]
    assert got["heard"]["active"] > 5
    assert got["heard"]["inactive"] <= 2  # what was under way
    err = interrupted(node)
    assert "no world 'nowhere'" in err
    robot.kill()


def test_the_mapping_node_publishes_a_map_of_what_it_hears(network: Network) -> None:
    node = network.start("-m", "ullage.experiments.ros2_nodes", "radar_mapping", "--ros-args", "-p", "reach_m:=5.0")
    listener = network.start("hear.py", "--all", "/map=nav_msgs/msg/OccupancyGrid:latched")
    speaker = network.start("speak.py", "ros2:/flying?pace=0.5&node=speaker&listeners=1")
    got = result_of(listener)
    assert got["last"]["/map"]["info"]["width"] in (100, 101)
    interrupted(node)
    assert speaker.poll() in (None, 0)


def test_the_mapping_node_maps_as_the_thesis_did_and_publishes_often(network: Network) -> None:
    words = ("reach_m:=5.0", "method:=elfes", "threshold:=0.05", "every_s:=0.2")
    node = network.start(
        "-m", "ullage.experiments.ros2_nodes", "radar_mapping", "--ros-args", "-r", "map_updates:=updates",
        *(word for text in words for word in ("-p", text)),
    )  # fmt: skip
    listener = network.ready(
        "hear.py", "/map=nav_msgs/msg/OccupancyGrid:latched", "/updates=map_msgs/msg/OccupancyGridUpdate:stream",
        "/map/cells=ullage_msgs/msg/CellMap:latched",
    )  # fmt: skip
    speaker = network.start("fly.py", "8", "ros2:/flying?node=speaker&listeners=1")
    assert speaker.wait(120) == 0, speaker.communicate()
    time.sleep(1.0)
    got = result_of(listener, stop=True)
    assert got["last"]["/map/cells"]["method"] == "elfes"
    assert got["count"]["/map"] + got["count"]["/updates"] > 12  # one a second would be 8
    interrupted(node)


STOPPED_BEFORE_IT_SPINS = """
import signal, sys, rclpy
from ullage.experiments import ros2_nodes

def spin(node):
    signal.raise_signal(signal.SIGINT)
    while rclpy.ok():
        pass
    spun(node)

spun, rclpy.spin = rclpy.spin, spin
signal.signal(signal.SIGINT, signal.SIG_IGN)  # as in the background of a shell: only rclpy hears it
sys.exit(ros2_nodes.main(sys.argv[1], sys.argv[1:]))
"""


def test_a_refused_parameter_takes_one_line_and_a_signal_while_the_node_starts_ends_it(network: Network) -> None:
    node = network.start("-c", STOPPED_BEFORE_IT_SPINS, "radar_mapping", "--ros-args", "-p", "method:=magic")
    _, err = node.communicate(timeout=120)
    assert node.returncode == 0, err
    (line,) = (line for line in err.splitlines() if "method" in line)
    assert "elfes" in line


@pytest.mark.slow
def test_the_mapping_node_outlives_a_flight_that_leaves_its_map(network: Network) -> None:
    node = network.start("-m", "ullage.experiments.ros2_nodes", "radar_mapping", "--ros-args", "-p", "reach_m:=0.5")
    listener = network.ready(
        "hear.py", "/map=nav_msgs/msg/OccupancyGrid:latched", "/rosout=rcl_interfaces/msg/Log:stream"
    )
    speaker = network.start("speak.py", "ros2:/flying?pace=0.5&node=speaker&listeners=1")
    assert speaker.wait(120) == 0
    again = network.start("speak.py", "ros2:/flying?pace=0.5&node=speaker&listeners=1")  # it begins anew, inside
    assert again.wait(120) == 0
    got = result_of(listener, stop=True)
    assert got["last"]["/map"]["info"]["width"] in (10, 11)
    err = interrupted(node)
    assert "the flight has left the map" in err
    assert "does not hold the flight" not in err
