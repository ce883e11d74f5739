"""`gazebo:` beside a server on the real library of Gazebo Transport, which says what gz-sim's server says."""

import subprocess
import threading
import time
from pathlib import Path

import numpy as np
import pytest

import ullage as ul
from conftest import compiled

pytest.importorskip("zmq")
pytest.importorskip("google.protobuf")

from ullage.ports.cosimulation import CosimulationSource, resolved
from ullage.ports.gazebo import transport as wire
from ullage.ports.gazebo.messages import gz
from ullage.ports.gazebo.peer import ProcessLeft, Received, TopicOffered
from ullage.ports.gazebo.transport import TransportPeer
from ullage.ports.gazebo.transport_source import TransportFeed, TransportOptions, ask_scene, open_source, sdf_of

SERVER = Path(__file__).with_name("gazebo_server.cpp")


@pytest.fixture(scope="session")
def program(tmp_path_factory):
    """The server, compiled from the few lines beside this file."""
    return compiled(SERVER, tmp_path_factory.mktemp("gazebo"))


class Server:
    def __init__(self, program):
        self.program, self.process = program, None
        self.start()

    def start(self):
        pipe = subprocess.PIPE
        self.process = subprocess.Popen([self.program, "w", "x3"], stdin=pipe, stdout=pipe, text=True)

    def order(self, word):
        self.process.stdin.write(word + "\n")
        self.process.stdin.flush()

    def stop(self):
        self.process.kill()
        return self.process.communicate()[0]


@pytest.fixture
def server(program, partition):
    running = Server(program)
    yield running
    running.stop()


def source(lines=None, **options):
    chosen = {"model": "x3", "fidelity": "thesis", "rig": "single", **options}
    return open_source("", chosen, log=(lines if lines is not None else []).append)


def until(pieces, good, limit_s=90):
    """Follow on until something holds; the last piece that came."""
    end = time.monotonic() + limit_s
    while time.monotonic() < end:
        last = next(pieces)
        if good(last["front"]):
            return last["front"]
    raise TimeoutError


@pytest.mark.slow
def test_the_world_comes_from_the_scene_service_and_the_frames_go_back(server):
    with source() as live:
        assert [thing.name for thing in live.scene.objects] == ["wall"]  # less the model itself
        np.testing.assert_allclose(live.scene.bounds, [[3.9, -3, -1.5], [4.1, 3, 1.5]])
        assert live.scene.objects[0].material.reflection == 0.7
        pieces = live.stream()
        start_ns = next(pieces)["front"].t_ns[0]
        frames = until(pieces, lambda f: f.t_ns[-1] > start_ns + 2e9)
        np.testing.assert_allclose(frames.poses.position[:, 0], np.sin(0.5e-9 * frames.t_ns), atol=1e-3)
        peak = frames.range_m[np.argmax(frames.amplitude[-1])]
        assert peak == pytest.approx(3.9 - frames.poses.position[-1, 0], abs=0.3)
    received = [line.split() for line in server.stop().splitlines()]
    assert len(received) > 2  # of those since it knows the topic
    assert all(2.5 < float(words[1]) < 5.2 for words in received)


def wall_x(frames):
    """Where the wall's near face stood in the last frame [m]: its echo's rise (slanting rays peak later)."""
    amplitude = frames.amplitude[-1]
    return frames.range_m[np.argmax(amplitude > 0.3 * amplitude.max())] + frames.poses.position[-1, 0]


@pytest.mark.slow
def test_another_model_that_moves_is_seen_where_it_is(server):
    lines = []
    with source(lines) as live:
        pieces = live.stream()
        assert wall_x(until(pieces, lambda f: True)) == pytest.approx(3.9, abs=0.1)
        server.order("push")  # and it takes 4 s to come; when the server heard so is not known here
        came = until(pieces, lambda f: wall_x(f) < 2, limit_s=90).t_ns[-1]
        frames = until(pieces, lambda f: f.t_ns[-1] > came + 2e9)
        assert wall_x(frames) == pytest.approx(1.9, abs=0.1)
        assert lines.count("'wall' moves: it is followed") == 1


@pytest.mark.slow
def test_what_happens_to_the_server_is_said_and_survived(server):
    lines = []
    with source(lines) as live:
        pieces = live.stream()
        until(pieces, lambda f: True)
        server.order("pause")
        threading.Timer(3.0, server.order, ["go"]).start()
        until(pieces, lambda f: "Gazebo goes on" in lines)
        assert "Gazebo is paused" in lines
        begun = until(pieces, lambda f: True).t_ns[0]
        until(pieces, lambda f: f.t_ns[-1] > begun + 1e9)
        server.order("reset")
        until(pieces, lambda f: any(text.startswith("time jumped back") for text in lines))
        server.order("delete")  # the stream waits meanwhile
        threading.Timer(3.0, server.order, ["back"]).start()
        until(pieces, lambda f: "the model 'x3' has gone from Gazebo; waiting for it to come back" in lines)
        server.stop()
        threading.Timer(6.0, server.start).start()
        until(pieces, lambda f: any(text.startswith("Gazebo has gone") for text in lines))
    assert lines.count("Gazebo gives poses on /world/w/pose/info") == 2


TOPIC = "/world/w/pose/info"


@pytest.mark.slow
def test_damaged_messages_of_a_real_publisher_are_counted_and_end_nothing(server):
    lines = []
    with source(lines) as live:
        pieces = live.stream()
        until(pieces, lambda f: True)
        server.order("damage")
        until(pieces, lambda f: live.counters.dropped("bad", topic="x3") >= 40)
        until(pieces, lambda f: live.counters.dropped("bad", topic=TOPIC) >= 20 + 40)  # and poses of the wall
        last = until(pieces, lambda f: True).t_ns[-1]
        frames = until(pieces, lambda f: f.t_ns[-1] > last + 1e9)
        np.testing.assert_allclose(frames.poses.position[:, 0], np.sin(0.5e-9 * frames.t_ns), atol=1e-3)
        pieces.close()
    assert any(line.startswith(f"{TOPIC}: dropped ") and "cannot be read" in line for line in lines)
    assert sum(line.startswith("x3: dropped 40 bad (") for line in lines) >= 1


@pytest.mark.slow
def test_a_flood_of_a_real_publisher_loses_nothing_silently(server):
    reported = []
    with TransportPeer() as peer:
        world = ask_scene(peer, "", where="gazebo:")
    options, scene, rig = resolved(TransportOptions(model="x3", fidelity="thesis", rig="single"), "gazebo:", world)

    def join():
        return TransportFeed(TransportPeer(most_waiting=300), options, "", {}, frozenset(scene.models))

    with CosimulationSource(join, scene, rig, options, log=reported.append) as live:
        pieces = live.stream()
        begun = until(pieces, lambda f: True).t_ns[-1]
        server.order("flood")
        time.sleep(3.0)  # whoever takes the frames is busy
        until(pieces, lambda f: f.t_ns[-1] > begun + 31e9)
        lost, received = live.counters.dropped("lost", topic=TOPIC), live.counters.received(TOPIC)
        pieces.close()
    assert received > 1000  # the publisher's own queue has lost the others
    assert lost > 100
    assert any(line.startswith(f"{TOPIC}: dropped ") and " lost (messages come faster" in line for line in reported)


@pytest.mark.slow
def test_frames_of_the_simulators_own_rays(server, tmp_path):
    (tmp_path / "w.sdf").write_text("""<sdf version="1.9" xmlns:ullage="urn:ullage:sdf"><world name="w">
      <model name="x3"><link name="base"><sensor name="front" type="gpu_lidar"><pose>0 0 0.25 0 0 0</pose>
      <ullage:radar/></sensor></link></model></world></sdf>""")
    with source(rays="front", world=str(tmp_path / "w.sdf"), rig="") as live:
        frames = until(live.stream(), lambda f: True)
        first = frames.range_m[np.argmax(frames.amplitude[-1] > 0.1 * frames.amplitude.max())]
        assert frames.unit == "thesis"
        assert frames.spec.thesis.rays_per_side == 9
        assert frames.poses.position[0, 2] == 0.25
        assert first == pytest.approx(3.9 - frames.poses.position[-1, 0], abs=0.2)


def test_a_ray_sensor_whose_place_is_not_known_is_refused():
    with pytest.raises(ul.InputError, match=r"where 'lidar' sits is not known \(allowed: .*front"):
        source(rays="lidar", world="ntnu-room")


def test_one_topic_for_several_ray_sensors_is_refused():
    with pytest.raises(ul.InputError, match=r"one topic for 4 ray sensors \(allowed: scan_topic with one of rays="):
        source(rays="*", rig="thesis-4", world="ntnu-room", scan_topic="/odd")


def test_no_gazebo_is_refused_when_the_world_is_asked_of_it(partition):
    words = r"gazebo:: no Gazebo heard in 0\.3 s \(allowed: world=FILE.sdf"
    with TransportPeer() as peer, pytest.raises(ul.InputError, match=words):
        ask_scene(peer, "", where="gazebo:", patience_s=0.3)


def test_frames_from_anywhere_are_published_with_their_clock(partition):
    frames = ul.simulate(
        ul.scenes.plate(width_m=1, height_m=1, distance_m=2), ul.Trajectory.stationary(n=40, rate_hz=20),
        ul.Rig.preset("single"), fidelity="thesis",
    )  # fmt: skip
    topics = [f"/model/drone/radar/front/{name}" for name in ("frame", "profile", "range", "points")]
    with TransportPeer() as listener, ul.sink("gazebo:?model=drone") as sink:
        for topic in [*topics, "/clock"]:
            listener.subscribe(topic)
        sink.write(frames)
        received = {}
        end = time.monotonic() + 60
        while time.monotonic() < end and len(received) < 5:
            event = listener.wait(0.1)
            if isinstance(event, Received):
                received[event.topic] = event
    assert set(received) == {*topics, "/clock"}
    assert received["/clock"].kind == "gz.msgs.Clock"
    message = gz().Float_V.FromString(received[topics[0]].data)
    about = {entry.key: entry.value[0] for entry in message.header.data}
    k = round((message.header.stamp.sec + message.header.stamp.nsec * 1e-9) * 20)
    np.testing.assert_array_equal(np.array(message.data, np.float32), frames["front"].samples[k])
    assert about["samples"] == "real"
    assert float(about["bin_m"]) == pytest.approx(frames["front"].spec.bin_m)
    assert gz().Double.FromString(received[topics[2]].data).data == pytest.approx(2.0, abs=0.15)
    cloud = gz().PointCloudPacked.FromString(received[topics[3]].data)
    points = np.frombuffer(cloud.data, "<f4").reshape(cloud.width, 4)
    np.testing.assert_allclose(points[:, 0], frames["front"].range_m, rtol=1e-6)


def test_a_scene_becomes_the_sdf_that_it_stands_for(tmp_path):
    message = gz().Scene(name="w")
    model = message.model.add(name='a "b" & c')
    model.pose.position.x = 1.5
    link = model.link.add(name="l")
    shapes = {1: ("cylinder", {"radius": 0.5, "length": 2.0}), 2: ("sphere", {"radius": 0.25})}
    for kind, (name, values) in shapes.items():
        visual = link.visual.add(name=name)
        visual.geometry.type = kind
        for key, value in values.items():
            setattr(getattr(visual.geometry, name), key, value)
    link.visual.add(name="axis").geometry.type = 13
    (tmp_path / "s.sdf").write_text(sdf_of(message))
    scene = ul.load_scene(tmp_path / "s.sdf")
    assert [thing.name for thing in scene.objects] == ['a "b" & c']
    np.testing.assert_allclose(scene.bounds, [[1, -0.5, -1], [2, 0.5, 1]], atol=0.01)


def test_a_peer_that_falls_silent_is_held_for_gone(partition):
    process, node = wire.new_uuid(), wire.new_uuid()
    with TransportPeer(silence_s=0.5) as listener, wire.discovery_socket(wire.MESSAGE_PORT, "127.0.0.1") as speaker:
        offer = gz().Publisher(
            topic=wire.full_topic("/clock", listener.partition), address="tcp://127.0.0.1:9", process_uuid=process,
            node_uuid=node, scope=wire.EVERYWHERE, msg_pub=gz().MessagePublisher(msg_type="gz.msgs.Clock"),
        )  # fmt: skip

        def met(kind):  # others may be about on the same network
            end = time.monotonic() + 60
            while time.monotonic() < end:
                event = listener.wait(0.1)
                if isinstance(event, kind) and event.process == process:
                    return True
            return False

        speaker.sendto(wire.datagram(wire.ADVERTISE, process, pub=offer), (wire.GROUP, wire.MESSAGE_PORT))
        assert met(TopicOffered)
        assert met(ProcessLeft)
