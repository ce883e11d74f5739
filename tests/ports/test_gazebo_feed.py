"""What a feed asks of either Gazebo and takes from it, beside a peer that only writes down."""

from __future__ import annotations

from collections import deque

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from conftest import some_frames

pytest.importorskip("zmq")
pytest.importorskip("google.protobuf")

from ullage.ports.gazebo.classic_source import ClassicFeed, ClassicOptions
from ullage.ports.gazebo.messages import classic, gz
from ullage.ports.gazebo.peer import Connected, ProcessLeft, Received, TopicOffered
from ullage.ports.gazebo.transport_source import TransportFeed, TransportOptions
from ullage.ports.intake import Counters
from ullage.ports.pose_events import ModelPose, Notice, OtherModels
from ullage.ports.scanning import Scan, ScanSource
from ullage.specs import Rig

AHEAD = (0.0, 0.0, 0.0, 1.0)
SCAN = {
    "angle_min": -1.0, "angle_max": 1.0, "angle_step": 1.0, "range_min": 0.1, "range_max": 9.0, "count": 2,
    "vertical_count": 2, "ranges": [1.0] * 4, "intensities": [1.0] * 4,
}  # fmt: skip


class Notebook:
    """A peer that gives events and writes down what it is asked for."""

    host, partition, master = "127.0.0.1", "p", ("127.0.0.1", 1)

    def __init__(self, *events):
        self.events, self.counters = deque(events), Counters()
        self.joined, self.offered, self.sent = [], {}, []

    def wait(self, timeout_s):
        return self.events.popleft() if self.events else None

    def subscribe(self, topic, kind=""):
        self.joined.append(topic)

    def advertise(self, topic, kind):
        self.offered[topic] = kind

    def publish(self, topic, message):
        self.sent.append((topic, message))

    def close(self):
        pass


class Transport:
    """Messages of gz-sim."""

    name, root, poses_on, status_on = "Gazebo", "/world/w", "/world/w/pose/info", "/world/w/stats"
    scan_on, found = (
        "/world/w/model/x/link/l/sensor/front/scan",
        TopicOffered("/world/w/pose/info", "gz.msgs.Pose_V", "s"),
    )
    topics = (poses_on, "/world/w/dynamic_pose/info", status_on, "/world/w/scene/info", scan_on)

    @staticmethod
    def feed(peer, *others, rays="", mounts=None):
        mounts = mounts or ({"front": np.eye(4)} if rays else {})
        return TransportFeed(peer, TransportOptions(model="x", rays=rays), "", mounts, frozenset(others))

    @staticmethod
    def head(t_ns):
        return gz().Header(stamp=gz().Time(sec=t_ns // 10**9, nsec=t_ns % 10**9))

    def poses(self, t_ns, **places):
        rows = [
            gz().Pose(name=n, position=gz().Vector3d(x=x), orientation=gz().Quaternion(w=1)) for n, x in places.items()
        ]
        return Received(self.poses_on, gz().Pose_V(header=self.head(t_ns), pose=rows).SerializeToString())

    def status(self, t_ns, paused=False):
        return Received(self.status_on, gz().WorldStatistics(paused=paused).SerializeToString())

    @staticmethod
    def row(message):
        return np.array(message.data, np.float32)

    @staticmethod
    def stamp(message):
        return message.header.stamp.sec, message.header.stamp.nsec

    def scan(self, t_ns, topic=scan_on, **change):
        message = gz().LaserScan(header=self.head(t_ns), **(SCAN | change))
        return Received(topic, message.SerializeToString())


class Classic:
    """Messages of gzserver."""

    name, root, poses_on, status_on = "gzserver", "/gazebo/w", "/gazebo/w/pose/info", "/gazebo/w/world_stats"
    scan_on, found = "/gazebo/w/x/l/front/scan", Connected(("w", "/gazebo"))
    topics = (poses_on, status_on, *(f"/gazebo/w/{name}" for name in ("response", "model/info", "request")), scan_on)

    @staticmethod
    def feed(peer, *others, rays="", **more):
        return ClassicFeed(peer, ClassicOptions(model="x", rays=rays), frozenset(others), **more)

    @staticmethod
    def time(t_ns):
        return classic().Time(sec=t_ns // 10**9, nsec=t_ns % 10**9)

    @staticmethod
    def pose(x, **more):
        at, turn = classic().Vector3d(x=x, y=0.0, z=0.0), classic().Quaternion(x=0.0, y=0.0, z=0.0, w=1.0)
        return classic().Pose(position=at, orientation=turn, **more)

    def poses(self, t_ns, **places):
        rows = [self.pose(x, name=name) for name, x in places.items()]
        return Received(self.poses_on, classic().PosesStamped(time=self.time(t_ns), pose=rows).SerializeToString())

    def status(self, t_ns, paused=False):
        none, now = self.time(0), self.time(t_ns)
        stats = classic().WorldStatistics(sim_time=now, pause_time=none, real_time=none, iterations=1, paused=paused)
        return Received(self.status_on, stats.SerializeToString())

    @staticmethod
    def row(message):
        assert (message.image.height, message.image.width * 4) == (1, message.image.step)
        return np.frombuffer(message.image.data, "<f4")

    @staticmethod
    def stamp(message):
        return message.time.sec, message.time.nsec

    def scan(self, t_ns, topic=scan_on, x=0.0, **change):
        scan = classic().LaserScan(frame="f", world_pose=self.pose(x), **(SCAN | change))
        return Received(topic, classic().LaserScanStamped(time=self.time(t_ns), scan=scan).SerializeToString())


FRAMINGS = [Transport(), Classic()]
both = pytest.mark.parametrize("framing", FRAMINGS, ids=["transport", "classic"])


def taken(feed, peer):
    """What a feed makes of all events that wait, and of what they cause."""
    found = []
    while (one := feed.next(0.0)) is not None or peer.events:
        found += [] if one is None else [one]
    return found


def offered(topic, process="server"):
    return TopicOffered(topic, "gz.msgs.LaserScan" if topic.endswith("/scan") else "gz.msgs.Pose_V", process)


def texts(found):
    return [one.text for one in found if isinstance(one, Notice)]


@both
def test_poses_of_other_models_come_before_that_of_the_model(framing):
    peer = Notebook(framing.found, framing.poses(3_000_000_005, x=1.0, lamp=4.0, box=2.0))
    found = taken(framing.feed(peer, "x", "box"), peer)
    assert len(texts(found)) == 1
    assert found[1:] == [
        OtherModels(3_000_000_005, {"box": ((2.0, 0.0, 0.0), AHEAD)}),
        ModelPose(3_000_000_005, (1.0, 0.0, 0.0), AHEAD),
    ]
    assert framing.poses_on in peer.joined


@both
def test_poses_of_other_models_that_are_none_are_counted(framing):
    peer = Notebook(framing.poses(10**9, box=np.nan, wall=3.0, x=1.0))
    others, own = taken(framing.feed(peer, "x", "box", "wall"), peer)
    assert set(others.poses) == {"wall"}
    assert own.position == (1.0, 0.0, 0.0)
    assert peer.counters.lines() == [f"{framing.poses_on}: dropped 1 bad (box: position is not finite)"]


@both
@given(st.data(), st.binary(max_size=60))
def test_bytes_that_cannot_be_read_are_counted_and_end_nothing(framing, data, raw):
    topic = data.draw(st.sampled_from(framing.topics))
    peer = Notebook(Received(topic, raw), Received(topic, b"\xff\xff"))
    taken(framing.feed(peer, "x", "box"), peer)
    assert peer.counters.dropped("bad", topic=topic) >= 1


@both
def test_a_pause_is_reported_once(framing):
    peer = Notebook(*(framing.status(10**9, paused) for paused in (False, True, True, False)))
    assert texts(taken(framing.feed(peer), peer)) == [f"{framing.name} is paused", f"{framing.name} goes on"]


@both
@pytest.mark.parametrize(
    "change",
    [{"count": 2**31}, {"vertical_count": 3}, {"range_max": np.nan}, {"intensities": [1.0]}, {"ranges": [np.nan] * 4}],
)
def test_scans_that_are_none_are_counted(framing, change):
    peer = Notebook(offered(framing.scan_on), framing.poses(10**9, x=1.0))  # gzserver's scans hold their pose
    peer.events.extend([framing.scan(10**9, **change), framing.scan(10**9)])
    found = taken(framing.feed(peer, rays="front"), peer)
    assert [one.range_m.shape for one in found if isinstance(one, Scan)] == [(2, 2)]
    assert peer.counters.dropped("bad") == 1


@both
def test_rays_outside_the_limits_of_their_scan_met_nothing(framing):
    scan = framing.scan(10**9, ranges=[0.05, 0.1, 9.0, 9.01])
    peer = Notebook(offered(framing.scan_on), framing.poses(10**9, x=1.0), scan)
    (found,) = (one for one in taken(framing.feed(peer, rays="front"), peer) if isinstance(one, Scan))
    np.testing.assert_array_equal(found.range_m, [[np.inf, 0.1], [9.0, np.inf]])


@both
@pytest.mark.parametrize("real", [False, True])
def test_frames_go_back_on_the_topics_of_the_model(framing, real):
    frames, peer = some_frames(3, sensor="left", real=real), Notebook(framing.found, framing.poses(10**9, x=1.0))
    feed = framing.feed(peer)
    taken(feed, peer)
    feed.give({"left": frames}, 5)
    root = "/model/x/radar/left" if framing.name == "Gazebo" else "/gazebo/w/x/radar/left"
    assert {topic for topic, _ in peer.sent} == {f"{root}/{name}" for name in ("frame", "profile", "range", "points")}
    for topic, message in peer.sent:
        assert peer.offered[topic] == f"{'gz' if framing.name == 'Gazebo' else 'gazebo'}.msgs.{type(message).__name__}"
    whole, profile, nearest = (
        [message for topic, message in peer.sent if topic.endswith(name)] for name in ("frame", "profile", "range")
    )
    for i, t_ns in enumerate(frames.t_ns - 5):
        samples = frames.samples[i].view(np.float32)
        np.testing.assert_array_equal(framing.row(whole[i]), samples)
        np.testing.assert_array_equal(framing.row(profile[i]), np.abs(frames.samples[i]))
        assert {framing.stamp(one[i]) for one in (whole, profile, nearest)} == {divmod(t_ns, 10**9)}


def test_a_scan_is_asked_for_only_where_rays_are_wanted():
    scan, others = Transport.scan_on, ["/model/x/link/l/sensor/o/scan", "/model/y/link/l/sensor/front/scan"]
    for rays, want in (("", set()), ("front", {scan})):
        peer = Notebook(*map(offered, [Transport.poses_on, *others, scan + "/points", scan]))
        taken(Transport.feed(peer, rays=rays), peer)
        assert {topic for topic in peer.joined if "scan" in topic} == want
    peer = Notebook(*map(offered, [*others, scan]))
    options = TransportOptions(model="x", rays="front", scan_topic=others[1])
    taken(TransportFeed(peer, options, "", {"front": np.eye(4)}), peer)
    assert peer.joined == [others[1]]


def test_each_ray_sensor_is_cast_from_its_own_place_on_the_model():
    mounts = {"front": np.eye(4), "left": np.eye(4)}
    mounts["left"][1, 3] = 0.5
    other = Transport.scan_on.replace("front", "left")
    stream, scan = FRAMINGS[0].poses, FRAMINGS[0].scan
    peer = Notebook(*map(offered, (Transport.poses_on, Transport.scan_on, other)), scan(10**9))
    peer.events.extend([stream(10**9, x=1.0), scan(11 * 10**8), scan(11 * 10**8, other)])
    found = taken(Transport.feed(peer, rays="front,left", mounts=mounts), peer)
    cast = {one.sensor: (one.t_ns, one.position) for one in found if isinstance(one, Scan)}
    assert cast == {"front": (11 * 10**8, (1.0, 0.0, 0.0)), "left": (11 * 10**8, (1.0, 0.5, 0.0))}
    assert all(one.quat_xyzw == pytest.approx(AHEAD) for one in found if isinstance(one, Scan))
    assert not any(isinstance(one, ModelPose) for one in found)
    assert any("no pose" in line for line in peer.counters.lines())  # of the scan that came before any pose


def test_a_server_that_comes_and_goes_is_reported_once():
    pose = Transport.poses_on
    peer = Notebook(offered(pose, "a"), offered(pose, "b"), *map(ProcessLeft, "acb"), offered(pose, "d"))
    found = texts(taken(Transport.feed(peer), peer))
    assert [("gives" in text, "gone" in text) for text in found] == [(True, False), (False, True), (True, False)]


@pytest.mark.parametrize(("world", "topic", "ours"), [
    ("", "/world/v/pose/info", True), ("w", "/world/v/pose/info", False), ("w", "/world/w/pose/info", True),
    ("", "/odd", False),
])  # fmt: skip
def test_poses_are_taken_of_the_world_that_was_asked_for(world, topic, ours):
    peer = Notebook(offered(topic))
    feed = TransportFeed(peer, TransportOptions(model="x"), world, {})
    assert (feed.next(0.0) is not None) == ours == (topic in peer.joined)
    assert feed.world == ("v" if ours and not world else world)


def test_a_silent_gzserver_is_reported():
    peer = Notebook()
    assert Classic.feed(peer, patience_s=0.0).next(0.1).text == "no gzserver at 127.0.0.1:1"
    peer.events.append(Classic.found)
    feed = Classic.feed(peer, patience_s=0.0)
    assert feed.next(0.1).text == "gzserver runs the world 'w'"
    assert feed.next(0.1).text == "gzserver at 127.0.0.1:1 says nothing"


def answered(ask, kind, message):
    """The server's answer to a request."""
    answer = classic().Response(id=ask.id, request=ask.request, response="success", type=f"gazebo.msgs.{kind}")
    answer.serialized_data = message.SerializePartialToString()
    return Received("/gazebo/w/response", answer.SerializeToString())


def feed_of_model(rays, *links):
    """A feed whose server has told what sensors the model has (links, each with names and types), and its peer."""
    peer = Notebook(Classic.found, FRAMINGS[1].status(0))
    feed = Classic.feed(peer, rays=rays, ask_every_s=0.0)
    taken(feed, peer)
    model = classic().Model(name="x")
    for link, sensors in links:
        added = model.link.add(name=f"x::{link}")
        for name, kind in sensors:
            added.sensor.add(name=name, parent=f"x::{link}", type=kind)
    peer.events.append(answered(peer.sent[-1][1], "Model", model))
    peer.joined.clear()
    return feed, peer


LINKS = (("base", [("front", "ray"), ("camera", "camera"), ("left", "gpu_ray")]), ("arm", [("down", "ray")]))


@pytest.mark.parametrize(
    ("rays", "want", "said"),
    [
        ("left", ["base/left"], []),
        ("left, down,left", ["base/left", "arm/down"], []),
        ("*", ["base/front", "base/left", "arm/down"], []),
        ("f*,d*", ["base/front", "arm/down"], []),
        ("front,camera,rear", ["base/front"], ["no ray sensor 'camera', 'rear' on 'x' (there are front, left, down)"]),
    ],
)
def test_the_named_ray_sensors_of_gzserver_are_joined(rays, want, said):
    feed, peer = feed_of_model(rays, *LINKS)
    assert texts(taken(feed, peer)) == said
    assert peer.joined == [f"/gazebo/w/x/{path}/scan" for path in want]


def test_ray_sensors_of_one_name_are_told_apart_by_their_links():
    feed, peer = feed_of_model("*", ("base", [("ray", "ray")]), ("arm", [("ray", "ray")]))
    for x, path in enumerate(("base", "arm")):
        peer.events.append(FRAMINGS[1].scan(10**9, f"/gazebo/w/x/{path}/ray/scan", x=float(x)))
    assert [(scan.sensor, scan.position[0]) for scan in taken(feed, peer)] == [("base/ray", 0.0), ("arm/ray", 1.0)]


def test_each_ray_sensor_is_a_radar_of_the_rig():
    """Each has its own pose, range, noise and count of frames, though their messages arrive mixed."""
    feed, peer = feed_of_model("front,left", *LINKS)
    for sec in range(1, 6):
        for x, name in enumerate(("front", "left")):
            topic, ranges = f"/gazebo/w/x/base/{name}/scan", [2.0 + 2 * x] * 4
            peer.events.append(FRAMINGS[1].scan(sec * 10**9, topic, x=float(x), ranges=ranges))
    options = ClassicOptions(model="x", rays="front,left", duration_s=3.5, publish=False)
    with ScanSource(lambda: feed, Rig.preset("thesis-4"), options) as live:
        whole = live.frames()
        assert live.sensors == ("front", "left")
    assert {name: frames.sensor for name, frames in whole.items()} == {"front": "front", "left": "left"}
    for x, frames in enumerate(whole.values()):
        assert frames.t_ns.tolist()[:4] == [k * 10**9 for k in range(1, 5)]
        np.testing.assert_array_equal(frames.poses.position[:, 0], x)
        peak = frames.range_m[np.argmax(np.abs(frames.samples).mean(0))]
        assert peak == pytest.approx(2.0 + 2 * x, abs=0.1)
    assert not np.array_equal(whole["front"].samples[0], whole["front"].samples[1])  # noise goes on
    assert whole["front"].spec == Rig.preset("thesis-4").sensors["front"].but(thesis=whole["front"].spec.thesis)


def test_a_source_of_scans_ends_once_it_is_stopped_and_none_is_left():
    feed, peer = feed_of_model("front", *LINKS)
    peer.events.append(FRAMINGS[1].scan(10**9, "/gazebo/w/x/base/front/scan"))
    with ScanSource(lambda: feed, Rig.preset("thesis-4"), ClassicOptions(model="x", rays="front")) as live:
        live.stop()
        assert sum(len(piece["front"]) for piece in live.stream()) == 1


def test_gzserver_is_asked_where_everything_is_and_tells_what_comes_and_goes():
    peer = Notebook(Classic.found, FRAMINGS[1].status(7 * 10**9))
    feed = Classic.feed(peer, "x", "box", "wall")
    taken(feed, peer)
    scene = classic().Scene(name="w")
    for name, x in (("x", 0.0), ("box", 2.0), ("lamp", 4.0)):
        scene.model.append(classic().Model(name=name, pose=Classic.pose(x)))
    peer.events.append(answered(next(ask for _, ask in peer.sent if ask.request == "scene_info"), "Scene", scene))
    for topic, message in (
        ("request", classic().Request(id=1, request="entity_delete", data="box")),
        ("model/info", classic().Model(name="sphere")),
    ):
        peer.events.append(Received(f"/gazebo/w/{topic}", message.SerializeToString()))
    everything, deleted, came = taken(feed, peer)
    assert everything == OtherModels(
        7 * 10**9, {"box": ((2.0, 0.0, 0.0), AHEAD)}, frozenset({"wall"}), frozenset({"lamp"})
    )
    assert deleted.gone == {"box"}
    assert came.new == {"sphere"}
