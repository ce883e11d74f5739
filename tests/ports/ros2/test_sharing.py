"""A network is shared: names, frames of reference and topics of others are left to them, whenever they appear."""

from __future__ import annotations

import json
import subprocess
import time
from typing import Any

import pytest

from .network import Network, result_of

pytestmark = pytest.mark.ros2
OURS = {"odom>base_link", "odom of base_link", "clock of the flight"}
THEIRS = {"earth>base_link", "odom of robot", "clock of the robot"}


def lines_until(tree: subprocess.Popen[str], wanted: Any, *, within_s: float = 60.0) -> set[str]:
    """What is published within a second, once it is as wanted."""
    assert tree.stdout is not None
    end, found = time.monotonic() + within_s, set[str]()
    while time.monotonic() < end:
        found = set(json.loads(tree.stdout.readline()))
        if wanted(found):
            return found
    raise AssertionError(f"never came; last {found}")


@pytest.mark.parametrize("first", ["robot", "flight"])
def test_what_another_node_publishes_is_left_to_it_also_when_it_appears_later(network: Network, first: str) -> None:
    words = ("earth>base_link", "base_link>front", "odom", "clock")
    tree = network.ready("tree.py")
    robot = network.ready("robot.py", *words) if first == "robot" else None
    flight = network.start("fly.py", "60", "ros2:?listeners=1")
    if robot is None:
        lines_until(tree, lambda found: found >= OURS)
        robot = network.ready("robot.py", *words)
    lines_until(tree, lambda found: found >= THEIRS)
    later = lines_until(tree, lambda found: not found & OURS)
    assert later >= THEIRS
    robot.communicate(timeout=30)  # the robot goes, and what it published is ours again
    lines_until(tree, lambda found: found >= OURS)
    flight.kill()
    tree.communicate(timeout=30)


def test_a_second_drone_has_names_of_its_own_and_topics_can_be_remapped(network: Network) -> None:
    listener = network.ready(
        "hear.py", "--all", "/drone2/radar/front/range=sensor_msgs/msg/Range:sensor",
        "/where=nav_msgs/msg/Odometry:stream", "/tf=tf2_msgs/msg/TFMessage:stream",
        "/tf_static=tf2_msgs/msg/TFMessage:latched",
    )  # fmt: skip
    flight = network.start(
        "fly.py", "5", "ros2:/drone2?frame_prefix=drone2/&remap=odom:=/where&listeners=1&linger_s=60"
    )
    got = result_of(listener)["last"]
    names = result_of(network.start("ask.py", "/drone2/ullage"))  # the node is spun, so its services answer
    assert "use_sim_time" in names
    flight.kill()
    assert got["/drone2/radar/front/range"]["header"]["frame_id"] == "drone2/front"
    assert (got["/where"]["header"]["frame_id"], got["/where"]["child_frame_id"]) == ("drone2/odom", "drone2/base_link")
    moved = got["/tf"]["transforms"][0]
    assert (moved["header"]["frame_id"], moved["child_frame_id"]) == ("drone2/odom", "drone2/base_link")
    fixed = {(t["header"]["frame_id"], t["child_frame_id"]) for t in got["/tf_static"]["transforms"]}
    mounts = {("drone2/base_link", f"drone2/{name}") for name in ("front", "left", "back", "right")}
    assert fixed == {("map", "drone2/odom")} | mounts


def test_a_remapping_that_is_none_is_one_line(network: Network) -> None:
    flight = network.start("fly.py", "1", "ros2:?remap=odom")
    _, err = flight.communicate(timeout=60)
    assert "not a remapping 'odom' (allowed: FROM:=TO, with commas between)" in err.strip().splitlines()[-1]


@pytest.mark.parametrize("later_s", [0.0, 0.7])
def test_two_drones_share_a_clock_that_never_falls_and_a_tree(network: Network, later_s: float) -> None:
    timer, tree = network.ready("timing.py"), network.ready("tree.py")
    flights = []
    for name in ("drone1", "drone2"):
        flights.append(network.start("fly.py", "30", f"ros2:/{name}?frame_prefix={name}/"))
        time.sleep(later_s)
    moves = {f"{name}/odom>{name}/base_link" for name in ("drone1", "drone2")}
    lines_until(tree, lambda found: found >= moves)
    time.sleep(2.0)
    clock = result_of(timer, stop=True)["clock"]
    for flight in flights:
        flight.kill()
    tree.communicate(timeout=30)
    assert clock["falls"] == 0
    assert clock["count"] > 40


LISTENER = """
import json, time
from ullage.data import Trajectory
from ullage.ports.conversions import transform_messages
from ullage.ports.publisher import on
from ullage.ports.ros2.middleware import Peer
from ullage.ports.ros2.options import NodeOptions
peer = Peer("/drone1", NodeOptions())
peer.spin()
peer.claim("/drone1/odom")  # as a source of its poses does
while not peer.others("/tf"):
    time.sleep(0.05)
(data,) = transform_messages("drone1/base_link", Trajectory.stationary(n=1), parent="drone1/odom")
print(json.dumps(peer.send(on("/tf", 0, data))))
peer.close()
"""


def test_a_drone_that_listens_to_its_own_poses_tells_its_place_beside_another_one(network: Network) -> None:
    robot = network.ready("robot.py", "earth>drone2/base_link")
    assert result_of(network.start("-c", LISTENER)) is True
    robot.communicate(timeout=30)
