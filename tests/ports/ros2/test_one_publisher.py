"""The stream that others receive: in order and in time, and the same as what a recording holds."""

from __future__ import annotations

import hashlib
from pathlib import Path
from typing import Any

import pytest
from mcap.reader import make_reader

from .network import Network, result_of

pytestmark = pytest.mark.ros2
RADARS = ("front", "left", "back", "right")
TOPICS = {
    **{f"/radar/{name}/frame": "ullage_msgs/msg/RadarFrame" for name in RADARS},
    **{f"/radar/{name}/profile": "sensor_msgs/msg/PointCloud2" for name in RADARS},
    **{f"/radar/{name}/range": "sensor_msgs/msg/Range" for name in RADARS},
    **{f"/radar/{name}/detections": "sensor_msgs/msg/PointCloud2" for name in RADARS},
    **{f"/radar/{name}/settings": "ullage_msgs/msg/RadarSettings:latched" for name in RADARS},
    "/tf": "tf2_msgs/msg/TFMessage", "/tf_static": "tf2_msgs/msg/TFMessage:latched",
    "/odom": "nav_msgs/msg/Odometry", "/truth/odom": "nav_msgs/msg/Odometry", "/path": "nav_msgs/msg/Path:latched",
    "/map": "nav_msgs/msg/OccupancyGrid:latched", "/map_updates": "map_msgs/msg/OccupancyGridUpdate",
    "/map/cells": "ullage_msgs/msg/CellMap:latched", "/world": "visualization_msgs/msg/MarkerArray:latched",
    "/map/plane": "visualization_msgs/msg/MarkerArray:latched",
    "/image": "sensor_msgs/msg/Image:latched", "/image/amplitude": "sensor_msgs/msg/Image:latched",
    "/clock": "rosgraph_msgs/msg/Clock",
}  # fmt: skip


@pytest.fixture(scope="module")
def flight(network: Network, tmp_path_factory: pytest.TempPathFactory) -> tuple[Any, Any, Path]:
    """What two foreign nodes received of one flight, and its recording."""
    folder = tmp_path_factory.mktemp("flight") / "run"
    keeper = network.ready("keep.py", *(f"{topic}={kind}" for topic, kind in TOPICS.items()))
    timer = network.ready("timing.py", *RADARS)
    flown = network.start("fly.py", "9", "ros2:?listeners=2&reliable=true&linger_s=1", folder)
    out, err = flown.communicate(timeout=180)
    assert flown.returncode == 0, out + err
    return result_of(keeper, stop=True), result_of(timer, stop=True), folder


def test_live_topics_and_recordings_are_the_same(flight: tuple[Any, Any, Path]) -> None:
    received, _, folder = flight
    recorded: dict[str, list[str]] = {}
    kinds = {}
    with (folder / "frames.mcap").open("rb") as file:
        for schema, channel, message in make_reader(file).iter_messages(log_time_order=False):
            assert schema is not None
            kinds[channel.topic] = schema.name
            filled = message.data + bytes(-len(message.data) % 4)  # as the network fills it
            recorded.setdefault(channel.topic, []).append(hashlib.sha1(filled).hexdigest())
    assert kinds == {topic: kind.removesuffix(":latched") for topic, kind in TOPICS.items()}
    assert set(received) == set(recorded)
    for topic, messages in recorded.items():
        heard = received[topic]  # a topic whose subscription comes late on a busy machine lacks its first messages
        assert heard == messages[len(messages) - len(heard) :], topic
        assert len(heard) > 0.9 * len(messages), topic


def test_the_stream_keeps_time_and_the_clock_never_falls(flight: tuple[Any, Any, Path]) -> None:
    _, timing, _ = flight
    assert timing["clock"]["falls"] == 0
    for name in ("clock", "tf", *RADARS):
        assert timing[name]["falls"] == 0
        assert 0.5 < timing[name]["slope"] < 1.05, name  # 1.00 where nothing else runs
    for name in RADARS:
        assert timing[name]["count"] > 100  # received without acknowledgement
        assert timing[name]["hz"] == pytest.approx(17.0, rel=0.1)
