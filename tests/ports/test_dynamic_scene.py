"""The other models of a running world: they are seen where they are told to be, whatever happens to them."""

import contextlib
import itertools
import threading

import numpy as np
import pytest
from scripted import Script

import ullage as ul
from ullage.ports.cosimulation import CosimulationOptions, CosimulationSource
from ullage.ports.pose_events import TURNED_RAD, DynamicScene, ModelPose, OtherModels

AHEAD = (0.0, 0.0, 0.0, 1.0)
RADAR = ul.RadarSpec.preset("x4m05", fps=10, antenna={"kind": "isotropic"}, noise=None)
WORLD = """<sdf version="1.6"><world name="w">
<model name="plate"><static>true</static><pose>3 0 0 0 0 0</pose><link name="plate"><collision name="c">
  <geometry><box><size>0.02 0.6 0.6</size></box></geometry></collision></link></model>
<model name="wall"><static>true</static><pose>7 0 0 0 0 0</pose><link name="l"><collision name="c">
  <geometry><box><size>0.1 0.6 0.6</size></box></geometry></collision></link></model></world></sdf>"""
FRONT = 0.01  # of the plate before its middle [m]


@pytest.fixture
def world(tmp_path):
    (tmp_path / "w.sdf").write_text(WORLD)
    return ul.load_scene(tmp_path / "w.sdf")


def followed(world, events, *, said=None, chunk=64, fidelity="physical"):
    options = CosimulationOptions(fidelity=fidelity, model="x")
    log = (said if said is not None else []).append
    source = CosimulationSource(lambda: Script(events), world, ul.Rig(sensors={"front": RADAR}), options, log=log)
    pieces = []
    with contextlib.suppress(KeyboardInterrupt):
        pieces.extend(piece["front"] for piece in source.stream(chunk))
    return pieces


def ranges(pieces):
    """Range of the strongest echo of each frame [m]."""
    return np.concatenate([f.range_m[np.argmax(f.amplitude, axis=1)] for f in pieces])


def hovering(end_s, plate, rate_hz=50.0, **more):
    """The radars hover in the origin; `plate` gives the plate's place from the time [s], or None where it is gone."""
    out = []
    for t in np.arange(round(end_s * rate_hz) + 1) / rate_hz:
        x = plate(t)
        poses = {"wall": ((7.0, 0.0, 0.0), AHEAD)} | ({} if x is None else {"plate": ((x, 0.0, 0.0), AHEAD)})
        gone = frozenset({"plate"} if x is None else ())
        out += [OtherModels(round(t * 1e9), poses, gone, **more), ModelPose(round(t * 1e9), (0.0, 0.0, 0.0), AHEAD)]
    return out


@pytest.mark.parametrize("fidelity", ["physical", "thesis"])
def test_the_echo_follows_a_plate_that_moves(world, fidelity):
    said = []
    pieces = followed(world, hovering(2.0, lambda t: 3 - 0.5 * t), said=said, fidelity=fidelity)
    times = np.concatenate([f.t_ns for f in pieces]) * 1e-9
    assert len(times) == 21
    np.testing.assert_allclose(ranges(pieces), 3 - 0.5 * times - FRONT, atol=RADAR.bin_m)
    assert said == ["'plate' moves: it is followed"]


@pytest.mark.parametrize("fidelity", ["physical", "thesis"])
def test_frames_are_those_of_a_world_that_has_the_plate_there(world, fidelity):
    """At each moment what comes is what a still world with the plate there would give."""
    pieces = followed(world, hovering(1.0, lambda t: 3 - 0.5 * t), fidelity=fidelity)
    samples = np.concatenate([f.samples for f in pieces])
    shift = np.zeros((len(world.vertices), 3))
    mine = np.unique(world.faces[world.face_object == world.object("plate")])
    for k in (3, 10):
        shift[mine, 0] = -0.05 * k
        still = ul.Scene(world.vertices + shift, world.faces, world.face_object, world.objects)
        path = ul.Trajectory.stationary(n=k + 1, rate_hz=10)
        want = ul.simulate(still, path, ul.Rig(sensors={"front": RADAR}), fidelity=fidelity)["front"].samples[k]
        np.testing.assert_allclose(samples[k], want, atol=2e-3 * np.abs(want).max())


def test_bunches_change_no_bit(world):
    events = hovering(1.0, lambda t: 3 - 0.5 * max(t - 0.33, 0))
    torn = [e for event in events for e in (event, None)]
    one, other = followed(world, events), followed(world, torn, chunk=3)
    a, b = (np.concatenate([f.samples for f in pieces]) for pieces in (one, other))
    assert a.tobytes() == b.tobytes()
    assert len(other) > len(one)


def test_a_model_that_goes_is_gone_and_comes_back_where_it_comes_back(world):
    said = []
    pieces = followed(world, hovering(3.0, lambda t: 3 if t < 0.9 else None if t < 1.9 else 2), said=said)
    found = ranges(pieces)
    np.testing.assert_allclose(found[:9], 3 - FRONT, atol=RADAR.bin_m)
    np.testing.assert_allclose(found[10:19], 7 - 0.05, atol=RADAR.bin_m)
    np.testing.assert_allclose(found[20:], 2 - FRONT, atol=RADAR.bin_m)
    assert said == [
        "'plate' has gone from the world",
        "'plate' is back in the world",
        "'plate' is not where the world has it: it is followed",
    ]


def test_after_a_reset_it_is_where_it_is_told_to_be(world):
    said = []
    run = hovering(1.0, lambda t: 3 - 0.5 * t)
    pieces = followed(world, [*run, *run], said=said)
    found = ranges(pieces)
    assert said == ["'plate' moves: it is followed", "time jumped back 1 s (x): a new track begins, the map goes on"]
    assert len(found) == 22
    np.testing.assert_allclose(found[11:], found[:11], atol=1e-12)


def test_a_model_that_the_world_did_not_have_is_said_once_and_not_seen(world):
    said = []
    pieces = followed(world, hovering(1.0, lambda t: 3.0, new=frozenset({"ball"})), said=said)
    assert said == ["'ball' is new: what the world did not have at the start is not seen"]
    np.testing.assert_allclose(ranges(pieces), 3 - FRONT, atol=RADAR.bin_m)


def test_what_trembles_at_its_place_stays_a_part_of_the_still_world(world):
    around = DynamicScene(world)
    assert not around.changed_by(OtherModels(0, {"plate": ((3.0005, 0, 0), AHEAD), "lamp": ((9, 9, 9), AHEAD)}))
    turned = (0, 0, float(np.sin(TURNED_RAD)), float(np.cos(TURNED_RAD)))
    assert around.changed_by(OtherModels(0, {"plate": ((3.0, 0, 0), turned)}))
    assert around.scene is world


class Speaking(threading.Thread):
    """A server of Gazebo Transport whose plate comes nearer by half a metre a second, until it is told to end."""

    def __init__(self):
        super().__init__(daemon=True)
        self.over = threading.Event()

    def run(self):
        from ullage.ports.gazebo.messages import gz
        from ullage.ports.gazebo.transport import TransportPeer

        with TransportPeer() as server:
            server.advertise("/world/w/pose/info", "gz.msgs.Pose_V")
            server.advertise("/world/w/scene/info", "gz.msgs.Scene")
            for step in itertools.count():
                message = gz().Pose_V()
                message.header.stamp.sec, message.header.stamp.nsec = divmod(step * 20_000_000, 10**9)
                link = ("plate", 0.0)  # of the same name as its model, relative to it
                for name, x in (("x", 0.0), ("plate", 6 - 0.01 * (step % 500)), ("wall", 7.0), link):
                    message.pose.add(name=name).position.x = x
                server.publish("/world/w/pose/info", message)
                if step % 50 == 0:
                    news = gz().Scene()
                    news.model.add(name="ball")
                    server.publish("/world/w/scene/info", news)
                if self.over.wait(0.01):
                    return


def test_a_peer_of_gazebo_transport_tells_where_the_plate_is(partition, tmp_path):
    from ullage.ports.gazebo.transport_source import open_source

    (tmp_path / "w.sdf").write_text(WORLD)
    said = []
    options = {"model": "x", "world": str(tmp_path / "w.sdf"), "rig": "single", "fidelity": "thesis", "duration_s": 1.5}
    server = Speaking()
    with open_source("", options, log=said.append) as live:
        server.start()
        frames = live.frames()
    server.over.set()
    server.join()
    found = frames.range_m[np.argmax(frames.amplitude, axis=1)]
    want = 6 - 0.5 * (1e-9 * frames.t_ns % 10) - FRONT
    np.testing.assert_allclose(found, want, atol=3 * frames.spec.bin_m)
    assert "'plate' is not where the world has it: it is followed" in said
    assert "'ball' is new: what the world did not have at the start is not seen" in said
