"""What `--to ros2:` publishes, heard by a real rclpy subscriber in another process."""

from __future__ import annotations

import math
from typing import Any

import pytest

from .network import Network, result_of

pytestmark = pytest.mark.ros2
TOPICS = (
    "/radar/front/frame=ullage_msgs/msg/RadarFrame:sensor",
    "/radar/front/settings=ullage_msgs/msg/RadarSettings:latched",
    "/radar/front/profile=sensor_msgs/msg/PointCloud2:sensor",
    "/radar/left/range=sensor_msgs/msg/Range:sensor",
    "/tf=tf2_msgs/msg/TFMessage:stream",
    "/tf_static=tf2_msgs/msg/TFMessage:latched",
    "/odom=nav_msgs/msg/Odometry:stream",
    "/truth/odom=nav_msgs/msg/Odometry:stream",
    "/clock=rosgraph_msgs/msg/Clock:stream",
    "/map=nav_msgs/msg/OccupancyGrid:latched",
    "/map_updates=map_msgs/msg/OccupancyGridUpdate:stream",
    "/map/occupied=sensor_msgs/msg/PointCloud2:latched",
    "/map/cubes=visualization_msgs/msg/MarkerArray:latched",
    "/world=visualization_msgs/msg/MarkerArray:latched",
    "/path=nav_msgs/msg/Path:latched",
    "/image=sensor_msgs/msg/Image:latched",
    "/image/amplitude=sensor_msgs/msg/Image:latched",
    "/diagnostics=diagnostic_msgs/msg/DiagnosticArray:stream",
)
FRAMES = 35


@pytest.fixture(scope="module")
def heard(network: Network) -> Any:
    listener = network.ready("hear.py", *TOPICS)
    speaker = network.start("speak.py", "ros2:?pace=1&linger_s=1&listeners=1")
    out, err = speaker.communicate(timeout=120)
    assert speaker.returncode == 0, out + err
    assert "warning" not in err.lower()
    return result_of(listener, stop=True)


def test_a_stranger_hears_everything_with_ros_own_frames_and_units(heard: Any) -> None:
    count, last = heard["count"], heard["last"]
    assert set(count) == {topic.partition("=")[0] for topic in TOPICS}
    for topic in ("/tf", "/odom", "/truth/odom"):  # reliable: all of them
        assert count[topic] == FRAMES
    for topic in ("/radar/front/frame", "/radar/front/profile", "/radar/left/range"):
        assert FRAMES // 2 <= count[topic] <= FRAMES  # best effort; bench_ros2.py counts what is lost
    assert last["/tf"]["transforms"][0]["header"]["frame_id"] == "odom"
    assert last["/tf"]["transforms"][0]["child_frame_id"] == "base_link"
    fixed = {(t["header"]["frame_id"], t["child_frame_id"]) for t in last["/tf_static"]["transforms"]}
    assert fixed == {("map", "odom"), *(("base_link", name) for name in ("front", "left", "back", "right"))}
    place = last["/odom"]["pose"]["pose"]["position"]
    assert place["x"] == pytest.approx(1.0, abs=1e-6)
    assert last["/odom"]["twist"]["twist"]["linear"]["x"] == pytest.approx(1.0, abs=1e-6)
    assert 1.7 <= last["/radar/left/range"]["range"] <= 2.2  # the wall of a room of 4 m, from its middle
    assert last["/radar/left/range"]["header"]["frame_id"] == "left"
    frame = last["/radar/front/frame"]
    assert frame["index"] == FRAMES - 1
    assert last["/radar/front/profile"]["width"] == 198  # the ray model reaches 10 m
    assert last["/radar/front/profile"]["header"]["stamp"] == frame["header"]["stamp"]


def test_the_map_comes_whole_once_and_then_as_what_changed(heard: Any) -> None:
    count, last = heard["count"], heard["last"]
    assert count["/map"] == 2  # the first, and the last at the end
    assert count["/map_updates"] == FRAMES // 5 - 1
    update = last["/map_updates"]
    assert (update["x"], update["width"]) == (3, 17)
    assert update["height"] == 5
    assert last["/map"]["data"]["length"] == 2400
    assert last["/map"]["info"]["resolution"] == pytest.approx(0.1)
    cubes = last["/map/cubes"]["markers"][0]
    assert len(cubes["points"]) == 8 * 12 == len(cubes["colors"])
    assert last["/image"]["encoding"] == "mono8"
    assert last["/image/amplitude"]["encoding"] == "32FC1"


def test_the_clock_goes_evenly_at_the_pace_of_the_stamps(heard: Any) -> None:
    assert heard["count"]["/clock"] > 3 * FRAMES
    stamp = heard["last"]["/clock"]["clock"]
    assert math.isclose(stamp["sec"] + stamp["nanosec"] * 1e-9, 2.0, abs_tol=0.01)


def test_who_comes_late_gets_the_map_the_world_and_the_fixed_transforms(network: Network) -> None:
    speaker = network.ready("speak.py", "ros2:?pace=0&linger_s=300")
    listener = network.start("hear.py", "--all", *(t for t in TOPICS if t.endswith(":latched")))
    got = result_of(listener)
    speaker.kill()
    assert got["last"]["/map"]["data"]["sum"] > 0
    assert len(got["last"]["/tf_static"]["transforms"]) == 5
