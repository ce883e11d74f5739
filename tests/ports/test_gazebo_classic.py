"""Gazebo Classic: how messages lie on the wire, a peer beside a small server, and the real gzserver in its chroot."""

import socket
import threading
import time

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from ullage.errors import InputError

pytest.importorskip("google.protobuf")

from ullage.ports.gazebo_classic.peer import ClassicPeer, Connected, Disconnected, Received, Unresponsive
from ullage.ports.gazebo_classic.source import ClassicFeed, ClassicOptions
from ullage.ports.gazebo_classic.wire import Stream, framed, gz, master_of, packet
from ullage.ports.intake import Counters
from ullage.ports.pose_events import ModelPose, OtherModels
from ullage.ports.scanning import ScanSource
from ullage.specs import Rig


@given(st.lists(st.binary(max_size=40), max_size=6), st.integers(1, 30))
def test_messages_come_out_whole_however_they_are_cut(messages, step):
    raw = b"".join(framed(data) for data in messages)
    stream, out = Stream(), []
    for start in range(0, len(raw), step):
        out += stream.take(raw[start : start + step])
    assert out == messages


def test_the_length_is_eight_hexadecimal_digits():
    assert framed(b"x" * 300)[:8] == b"0000012C"


@pytest.mark.parametrize("raw", [b"GET / HTTP/1.1", b"-0000001x", b"FFFFFFFFx"])
def test_what_is_no_length_is_refused(raw):
    with pytest.raises(ValueError):  # noqa: PT011
        Stream().take(raw)


@pytest.mark.parametrize(
    ("text", "want"),
    [
        ("", ("127.0.0.1", 11345)),
        ("box:1234", ("box", 1234)),
        ("http://10.0.0.1:11346", ("10.0.0.1", 11346)),
        ("box", ("box", 11345)),
    ],
)
def test_addresses_of_a_master(text, want, monkeypatch):
    monkeypatch.delenv("GAZEBO_MASTER_URI", raising=False)
    assert master_of(text) == want


def test_an_address_that_is_none_is_refused():
    with pytest.raises(InputError, match="'box:door' is not an address"):
        master_of("box:door")


class Server:
    """A master that knows one world, and itself publishes the clock on the same port."""

    def __init__(self, port=0, deaf=0, mute=False, offers=None):
        self.deaf, self.mute = deaf, mute  # how many of the first to come are never read, and whether told anything
        self.offers = offers  # port of the clock; none: the same
        self.door = socket.create_server(("127.0.0.1", port))
        self.port = self.door.getsockname()[1]
        self.received, self.lines = [], []
        threading.Thread(target=self._serve, daemon=True).start()

    def _serve(self):
        try:
            while True:
                sock, _ = self.door.accept()
                self.lines.append(sock)
                threading.Thread(target=self._talk, args=(sock,), daemon=True).start()
        except OSError:
            return

    def _talk(self, sock):
        deaf = len(self.lines) <= self.deaf
        if deaf and self.mute:
            return
        try:
            sock.sendall(packet("version_init", gz().GzString(data="gazebo 11.1.0")))
            sock.sendall(packet("topic_namepaces_init", gz().GzString_V(data=["w", "/gazebo"])))
            sock.sendall(packet("publishers_init", gz().Publishers()))
        except OSError:  # the test is over
            return
        if deaf:
            return
        stream = Stream()
        while raw := sock.recv(65536):
            for data in stream.take(raw):
                message = gz().Packet.FromString(data)
                self.received.append(message)
                if message.type == "request" and gz().Request.FromString(message.serialized_data).request.endswith(
                    "spaces"
                ):
                    sock.sendall(packet("get_topic_namespaces_response", gz().GzString_V(data=["w"])))
                if message.type == "subscribe":
                    want = gz().Subscribe.FromString(message.serialized_data)
                    offer = gz().Publish(
                        topic=want.topic, msg_type=want.msg_type, host="127.0.0.1", port=self.offers or self.port
                    )
                    sock.sendall(packet("publisher_subscribe", offer))

    def close(self):
        self.door.shutdown(socket.SHUT_RDWR)  # wakes the thread that accepts
        for sock in [self.door, *self.lines]:
            sock.close()


def until(peer, kind, limit_s=60.0):
    end = time.monotonic() + limit_s
    while time.monotonic() < end:
        event = peer.wait(0.1)
        if isinstance(event, kind):
            return event
    raise TimeoutError(kind.__name__)


def test_a_peer_joins_publishers_and_serves_readers():
    server = Server()
    with ClassicPeer(("127.0.0.1", server.port)) as peer:
        assert until(peer, Connected).worlds == ("w", "/gazebo")
        peer.advertise("/gazebo/w/x/range", "gazebo.msgs.GzString")
        with socket.create_connection(("127.0.0.1", peer.port)) as reader:
            want = gz().Subscribe(topic="/gazebo/w/x/range", host="127.0.0.1", port=1, msg_type="gazebo.msgs.GzString")
            reader.sendall(packet("sub", want))
            reader.settimeout(0.05)
            stream, got = Stream(), []
            for _ in range(100):
                peer.publish("/gazebo/w/x/range", gz().GzString(data="3.25"))
                try:
                    got += stream.take(reader.recv(4096))
                except TimeoutError:
                    continue
                if got:
                    break
            assert gz().GzString.FromString(got[0]).data == "3.25"
    end = time.monotonic() + 60  # its thread may not have read yet
    while "advertise" not in {packet.type for packet in list(server.received)} and time.monotonic() < end:
        time.sleep(0.02)
    assert "advertise" in {packet.type for packet in server.received}
    server.close()


def test_a_server_that_went_is_found_again_and_told_anew():
    server = Server()
    with ClassicPeer(("127.0.0.1", server.port)) as peer:
        until(peer, Connected)
        peer.subscribe("/gazebo/w/world_stats", "gazebo.msgs.WorldStatistics")
        peer.advertise("/gazebo/w/x", "gazebo.msgs.GzString")
        time.sleep(0.2)
        port = server.port
        for sock in server.lines:
            sock.shutdown(socket.SHUT_RDWR)
        server.close()
        until(peer, Disconnected)
        for _ in range(20):
            try:
                server = Server(port)
                break
            except OSError:
                time.sleep(0.2)
        until(peer, Connected)
        end = time.monotonic() + 60
        while time.monotonic() < end and not {"subscribe", "advertise"} <= {p.type for p in server.received}:
            time.sleep(0.05)
        assert {"subscribe", "advertise"} <= {p.type for p in server.received}
        server.close()


@pytest.mark.parametrize("mute", [False, True])
def test_a_master_that_accepts_and_never_reads_is_joined_anew(mute):
    server = Server(deaf=2, mute=mute)
    with ClassicPeer(("127.0.0.1", server.port), ask_s=0.1, answer_s=0.4) as peer:
        peer.subscribe("/gazebo/w/world_stats", "gazebo.msgs.WorldStatistics")
        peer.advertise("/gazebo/w/x", "gazebo.msgs.GzString")
        until(peer, Unresponsive)
        until(peer, Unresponsive)
        until(peer, Connected)
        end = time.monotonic() + 60
        while time.monotonic() < end and not {"subscribe", "advertise"} <= {p.type for p in server.received}:
            time.sleep(0.05)
        assert {"subscribe", "advertise"} <= {p.type for p in server.received}
        time.sleep(1.0)
        assert len(server.lines) == 4  # two that were never read, one that is, and one to the publisher
    server.close()


def test_a_publisher_that_cannot_be_joined_at_once_is_tried_again():
    with socket.socket() as publisher:
        publisher.bind(("127.0.0.1", 0))  # nobody listens there yet: joining it is refused
        publisher.settimeout(60)
        server = Server(offers=publisher.getsockname()[1])
        with ClassicPeer(("127.0.0.1", server.port), ask_s=0.1) as peer:
            peer.subscribe("/gazebo/w/world_stats", "gazebo.msgs.WorldStatistics")
            end = time.monotonic() + 60
            while time.monotonic() < end and not asked_twice_since_offered(server):
                time.sleep(0.05)
            publisher.listen()
            joined, _ = publisher.accept()
            with joined:
                joined.settimeout(60)
                stream, got = Stream(), []
                while not got:
                    got += stream.take(joined.recv(4096))
            assert gz().Packet.FromString(got[0]).type == "sub"
        server.close()


def asked_twice_since_offered(server):
    """Whether the peer has tried again: it does so each time it asks the master."""
    kinds = [message.type for message in list(server.received)]
    return "subscribe" in kinds and kinds[kinds.index("subscribe") :].count("request") >= 2


def test_somebody_who_speaks_nonsense_is_let_go():
    with ClassicPeer(("127.0.0.1", 1)) as peer, socket.create_connection(("127.0.0.1", peer.port)) as line:
        line.sendall(b"GET / HTTP/1.1\r\n\r\n")
        line.settimeout(60)
        assert line.recv(10) == b""
        assert not isinstance(peer.wait(0.0), Received)


def test_an_interface_that_is_not_ours_is_refused():
    with pytest.raises(InputError, match=r"host 192\.0\.2\.77.*allowed: an address of this machine"):
        ClassicPeer(("127.0.0.1", 11345), "192.0.2.77")


def test_no_server_is_said():
    feed = ClassicFeed(ClassicPeer(("127.0.0.1", 1)), ClassicOptions(model="x"), patience_s=0.0)
    assert feed.next(0.1).text == "no gzserver at 127.0.0.1:1"
    feed.close()


class Told:
    """In a peer's place: gives events, keeps what is asked."""

    master = ("127.0.0.1", 1)

    def __init__(self):
        self.events, self.asked, self.joined, self.counters = [], [], [], Counters()

    def receive(self, topic, message):
        self.events.append(Received(f"/gazebo/w/{topic}", message.SerializeToString()))

    def wait(self, timeout_s):
        return self.events.pop(0) if self.events else None

    def publish(self, topic, message):
        self.asked.append(message)

    def subscribe(self, topic, kind):
        self.joined.append(topic)

    def advertise(self, topic, kind):
        pass

    def close(self):
        pass


def posed(x, **more):
    at, turn = gz().Vector3d(x=x, y=0.0, z=0.0), gz().Quaternion(x=0.0, y=0.0, z=0.0, w=1.0)
    return gz().Pose(position=at, orientation=turn, **more)


def test_a_feed_tells_of_other_models_before_the_model_itself():
    peer = Told()
    feed = ClassicFeed(peer, ClassicOptions(model="x"), frozenset({"x", "box", "wall"}))
    peer.events.append(Connected(("w",)))
    assert "runs the world 'w'" in feed.next(0.1).text
    message = gz().PosesStamped(time=gz().Time(sec=3, nsec=5))
    for name, x in (("x", 1.0), ("x::link", 9.0), ("box", 2.0), ("lamp", 4.0)):
        message.pose.append(posed(x, name=name))
    peer.receive("pose/info", message)
    assert feed.next(0.1) == OtherModels(3_000_000_005, {"box": ((2.0, 0.0, 0.0), (0.0, 0.0, 0.0, 1.0))})
    assert feed.next(0.1) == ModelPose(3_000_000_005, (1.0, 0.0, 0.0), (0.0, 0.0, 0.0, 1.0))


TOPICS = ("pose/info", "world_stats", "response", "model/info", "request", "x/l/front/scan")


@given(st.sampled_from(TOPICS), st.binary(max_size=60))
def test_bytes_that_cannot_be_read_are_counted_and_end_nothing(topic, data):
    peer = Told()
    feed = ClassicFeed(peer, ClassicOptions(model="x"), frozenset({"x", "box"}))
    peer.events += [Received(f"/gazebo/w/{topic}", data), Received(f"/gazebo/w/{topic}", b"\xff\xff")]
    while feed.next(0.0) is not None:
        pass
    assert not peer.events
    assert peer.counters.dropped("bad", topic=f"/gazebo/w/{topic}") >= 1


def test_poses_of_other_models_that_are_none_are_counted():
    peer = Told()
    feed = ClassicFeed(peer, ClassicOptions(model="x"), frozenset({"x", "box", "wall"}))
    poses = [posed(np.nan, name="box"), posed(3.0, name="wall"), posed(1.0, name="x")]
    peer.receive("pose/info", gz().PosesStamped(time=gz().Time(sec=1, nsec=0), pose=poses))
    assert set(feed.next(0.0).poses) == {"wall"}
    assert feed.next(0.0).position == (1.0, 0.0, 0.0)
    assert peer.counters.lines() == ["/gazebo/w/pose/info: dropped 1 bad (box: position is not finite)"]


SCAN = {
    "frame": "f", "angle_min": -1.0, "angle_max": 1.0, "angle_step": 1.0, "range_min": 0.1, "range_max": 9.0,
    "count": 2, "vertical_count": 2, "ranges": [1.0] * 4, "intensities": [1.0] * 4,
}  # fmt: skip


def scanned(sec, *, x=0.0, **fields):
    return gz().LaserScanStamped(time=gz().Time(sec=sec, nsec=0), scan=gz().LaserScan(world_pose=posed(x), **fields))


def model_with(*links, asked):
    """The server's answer about the model: links with sensors, each a name and a type."""
    model = gz().Model(name="x")
    for link, sensors in links:
        added = model.link.add(name=f"x::{link}")
        for name, kind in sensors:
            added.sensor.add(name=name, parent=f"x::{link}", type=kind)
    data = model.SerializePartialToString()
    return gz().Response(
        id=asked.id, request="entity_info", response="success", type="gazebo.msgs.Model", serialized_data=data
    )


def feed_of_model(rays, *links):
    """A feed whose server has told what sensors the model has, and its peer."""
    peer = Told()
    feed = ClassicFeed(peer, ClassicOptions(model="x", rays=rays), ask_every_s=0.0)
    peer.events.append(Connected(("w",)))
    feed.next(0.1)
    none = gz().Time(sec=0, nsec=0)
    stats = gz().WorldStatistics(sim_time=none, pause_time=none, real_time=none, iterations=1, paused=False)
    peer.receive("world_stats", stats)
    feed.next(0.0)
    peer.receive("response", model_with(*links, asked=peer.asked[-1]))
    peer.joined.clear()
    return feed, peer


LINKS = (("base", [("front", "ray"), ("camera", "camera"), ("left", "gpu_ray")]), ("arm", [("down", "ray")]))


@pytest.mark.parametrize(
    ("rays", "want"),
    [
        ("left", ["base/left"]),
        ("left, down,left", ["base/left", "arm/down"]),
        ("*", ["base/front", "base/left", "arm/down"]),
        ("f*,d*", ["base/front", "arm/down"]),
    ],
)
def test_the_named_ray_sensors_are_joined(rays, want):
    feed, peer = feed_of_model(rays, *LINKS)
    assert feed.next(0.0) is None
    assert peer.joined == [f"/gazebo/w/x/{path}/scan" for path in want]


def test_a_ray_sensor_that_is_not_there_is_named_and_the_others_joined():
    feed, peer = feed_of_model("front,camera,rear", *LINKS)
    assert feed.next(0.0).text == "no ray sensor 'camera', 'rear' on 'x' (there are front, left, down)"
    assert peer.joined == ["/gazebo/w/x/base/front/scan"]


def test_ray_sensors_of_one_name_are_told_apart_by_their_links():
    feed, peer = feed_of_model("*", ("base", [("ray", "ray")]), ("arm", [("ray", "ray")]))
    assert feed.next(0.0) is None
    for x, path in enumerate(("base", "arm")):
        peer.receive(f"x/{path}/ray/scan", scanned(1, x=float(x), **SCAN))
    found = [feed.next(0.0) for _ in range(2)]
    assert [(scan.sensor, scan.position[0]) for scan in found] == [("base/ray", 0.0), ("arm/ray", 1.0)]


def test_each_ray_sensor_is_a_radar_of_the_rig():
    """Each has its own pose, range, noise and count of frames, though their messages arrive mixed."""
    feed, peer = feed_of_model("front,left", *LINKS)
    for sec in range(1, 6):
        for x, name in enumerate(("front", "left")):
            ranges = {"ranges": [2.0 + 2 * x] * 4}
            peer.receive(f"x/base/{name}/scan", scanned(sec, x=float(x), **(SCAN | ranges)))
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


@pytest.mark.parametrize(
    "change",
    [{"count": 2**31}, {"vertical_count": 3}, {"range_max": np.nan}, {"intensities": [1.0]}, {"ranges": [np.nan] * 4}],
)
def test_scans_that_are_none_are_counted(change):
    peer = Told()
    feed = ClassicFeed(peer, ClassicOptions(model="x", rays="front"))
    for scan in (SCAN | change, SCAN):
        peer.receive("x/l/front/scan", scanned(1, **scan))
    assert feed.next(0.0).range_m.shape == (2, 2)
    assert peer.counters.dropped("bad") == 1


def test_a_feed_asks_where_everything_is_and_hears_what_comes_and_goes():
    peer = Told()
    feed = ClassicFeed(peer, ClassicOptions(model="x"), frozenset({"x", "box", "wall"}))
    peer.events.append(Connected(("w",)))
    feed.next(0.1)
    none = gz().Time(sec=0, nsec=0)
    stats = gz().WorldStatistics(
        sim_time=gz().Time(sec=7, nsec=0), pause_time=none, real_time=none, iterations=1, paused=False
    )
    peer.receive("world_stats", stats)
    assert feed.next(0.0) is None
    asked = next(ask for ask in peer.asked if ask.request == "scene_info")
    scene = gz().Scene(name="w")
    for name, x in (("x", 0.0), ("box", 2.0), ("lamp", 4.0)):
        scene.model.append(gz().Model(name=name, pose=posed(x)))
    answer = gz().Response(id=asked.id, request="scene_info", response="success", type="gazebo.msgs.Scene")
    answer.serialized_data = scene.SerializePartialToString()
    peer.receive("response", answer)
    found = feed.next(0.1)
    assert found == OtherModels(
        7 * 10**9, {"box": ((2.0, 0.0, 0.0), (0.0, 0.0, 0.0, 1.0))}, frozenset({"wall"}), frozenset({"lamp"})
    )
    peer.receive("request", gz().Request(id=1, request="entity_delete", data="box"))
    assert feed.next(0.1).gone == {"box"}
    peer.receive("model/info", gz().Model(name="sphere"))
    assert feed.next(0.1).new == {"sphere"}
