"""What the intake of Gazebo asks for and takes, beside a peer that only writes down."""

from __future__ import annotations

from collections import deque

import numpy as np
import pytest

pytest.importorskip("zmq")
pytest.importorskip("google.protobuf")

from ullage.ports.gazebo.peer import ProcessLeft, Received, TopicOffered
from ullage.ports.gazebo.source import GazeboOptions, PoseFeed
from ullage.ports.gazebo.wire import gz
from ullage.ports.intake import Counters
from ullage.ports.pose_events import ModelPose, Notice
from ullage.ports.scanning import Scan

POSES, SCAN = "/world/w/dynamic_pose/info", "/model/x3/link/base/sensor/sonar/scan"


class Notebook:
    """A peer that gives events and writes down what it is asked for."""

    def __init__(self, *events):
        self.events, self.asked, self.counters = deque(events), [], Counters()

    def subscribe(self, topic):
        self.asked.append(topic)

    def wait(self, timeout_s):
        return self.events.popleft() if self.events else None

    def close(self):
        pass


def came(topic, process="server"):
    return TopicOffered(topic, "gz.msgs.LaserScan" if topic.endswith("/scan") else "gz.msgs.Pose_V", process)


def stamped(message, t_ns):
    message.header.stamp.sec, message.header.stamp.nsec = divmod(t_ns, 10**9)
    return message


def received(topic, message):
    return Received(topic, f"gz.msgs.{type(message).__name__}", message.SerializeToString())


def pose(t_ns, x):
    message = stamped(gz().Pose_V(), t_ns)
    one = message.pose.add(name="x3")
    one.position.x, one.orientation.w = x, 1.0
    return received(POSES, message)


def scan(t_ns):
    message = stamped(gz().LaserScan(), t_ns)
    message.angle_min, message.angle_max, message.count, message.angle_step = -0.5, 0.5, 3, 0.5
    message.range_min, message.range_max, message.vertical_count = 0.1, 10.0, 1
    message.ranges.extend([2.0, 2.0, 2.0])
    message.intensities.extend([0.0, 0.0, 0.0])
    return received(SCAN, message)


def taken(*events, mount=None, **options):
    """What a feed makes of events, and what it asked its peer for."""
    peer = Notebook(*events)
    feed = PoseFeed(peer, GazeboOptions(model="x3", **options), "", {"sonar": np.eye(4) if mount is None else mount})
    found = []
    while peer.events:
        found.append(feed.next(0.0))
    return [one for one in found if one is not None], peer


@pytest.mark.parametrize("rays", ["", "sonar"])
def test_a_scan_is_asked_for_only_where_rays_are_wanted(rays):
    _, peer = taken(came(POSES), came(SCAN), rays=rays)
    assert POSES in peer.asked
    assert (SCAN in peer.asked) == bool(rays)


def test_of_several_scans_only_that_of_the_named_sensor_is_asked_for():
    others = ["/model/x3/link/base/sensor/other/scan", "/model/y/link/base/sensor/sonar/scan", SCAN + "/points"]
    _, peer = taken(*(came(topic) for topic in [*others, SCAN]), rays="sonar")
    assert peer.asked == [SCAN]
    _, peer = taken(*(came(topic) for topic in [*others, SCAN]), rays="sonar", scan_topic=others[1])
    assert peer.asked == [others[1]]


def test_poses_without_rays_are_sightings_and_with_rays_the_places_of_scans():
    """A scan is cast from where the model was last seen, and its sensor on it."""
    events = [came(POSES), came(SCAN), pose(10**9, 1.5), scan(11 * 10**8)]
    found, _ = taken(*events[:1], events[2])
    (seen,) = (one for one in found if isinstance(one, ModelPose))
    assert (seen.t_ns, seen.position[0]) == (10**9, 1.5)
    mount = np.eye(4)
    mount[0, 3] = 0.25
    found, _ = taken(*events, rays="sonar", mount=mount)
    assert not [one for one in found if isinstance(one, ModelPose)]
    (cast,) = (one for one in found if isinstance(one, Scan))
    assert cast.t_ns == 11 * 10**8
    assert cast.position == pytest.approx((1.75, 0, 0))
    assert cast.quat_xyzw == pytest.approx((0, 0, 0, 1))


def test_each_of_several_ray_sensors_is_cast_from_its_own_place():
    mounts, peer = {name: np.eye(4) for name in ("sonar", "left")}, Notebook()
    mounts["left"][1, 3] = 0.5
    other = SCAN.replace("sonar", "left")
    message = Received(other, "gz.msgs.LaserScan", scan(11 * 10**8).data)
    peer.events.extend([came(POSES), came(SCAN), came(other), pose(10**9, 1.0), scan(11 * 10**8), message])
    feed = PoseFeed(peer, GazeboOptions(model="x3", rays="sonar,left"), "", mounts)
    found = [feed.next(0.0) for _ in range(6)]
    cast = {one.sensor: one.position for one in found if isinstance(one, Scan)}
    assert cast == {"sonar": (1.0, 0.0, 0.0), "left": (1.0, 0.5, 0.0)}


def test_a_scan_before_any_pose_is_counted_and_dropped():
    found, peer = taken(came(SCAN), scan(10**9), rays="sonar")
    assert not found
    assert any("no pose" in line for line in peer.counters.lines())


def test_a_server_that_comes_and_goes_is_reported_once():
    found, _ = taken(
        came(POSES, "a"), came(POSES, "b"), ProcessLeft("a"), ProcessLeft("c"), ProcessLeft("b"), came(POSES, "d")
    )
    texts = [one.text for one in found if isinstance(one, Notice)]
    assert [("gives" in text, "gone" in text) for text in texts] == [(True, False), (False, True), (True, False)]


@pytest.mark.parametrize(("world", "topic", "ours"), [
    ("", "/world/v/pose/info", True), ("w", "/world/v/pose/info", False), ("w", "/world/w/pose/info", True),
    ("", "/odd", False),
])  # fmt: skip
def test_poses_are_taken_of_the_world_that_was_asked_for(world, topic, ours):
    peer = Notebook(came(topic))
    feed = PoseFeed(peer, GazeboOptions(model="x3"), world, {})
    assert (feed.next(0.0) is not None) == ours == (topic in peer.asked)
    assert feed.world == ("v" if ours and not world else world)
