"""Radars on somebody else's model: frames depend on poses and their times alone, whatever happens meanwhile."""

import contextlib
import math
from dataclasses import replace

import numpy as np
import pytest
from scripted import Script

import ullage as ul
from ullage.ports import schema as ros
from ullage.ports.cosimulation import CosimulationOptions, CosimulationSource, resolved, rig_of, world_of
from ullage.ports.diagnostics import RadarStatus
from ullage.ports.gazebo.topics import GazeboSink, nearest
from ullage.ports.intake import Counters
from ullage.ports.live import options_of
from ullage.ports.pose_events import ModelPose, Notice

RIG = ul.Rig(sensors={"front": ul.RadarSpec.preset("x4m05", fps=10), "left": ul.RadarSpec.preset("x4m05", fps=20)})
WALL = ul.scenes.plate(width_m=2, height_m=2, distance_m=3.0)


def line(start_s=0.0, end_s=2.0, rate_hz=50.0, speed=0.5):
    times = np.arange(round(start_s * rate_hz), round(end_s * rate_hz) + 1) / rate_hz
    return [ModelPose(round(t * 1e9), (speed * t, 0.0, 0.0), (0.0, 0.0, 0.0, 1.0)) for t in times]


def followed(events, *, said=None, chunk=64, newest_ns=0, **options):
    script = Script(events, newest_ns)
    chosen = CosimulationOptions(fidelity="thesis", model="x", **options)
    source = CosimulationSource(lambda: script, WALL, RIG, chosen, log=(said if said is not None else []).append)
    pieces = []
    with contextlib.suppress(KeyboardInterrupt):
        pieces.extend(source.stream(chunk))
    assert script.closed
    return pieces, script


def whole(pieces, name):
    return [part[name] for part in pieces if name in part]


def test_frames_are_those_of_a_simulation_along_the_same_path():
    pieces, _ = followed(line())
    for name, spec in RIG.sensors.items():
        times = np.concatenate([f.t_ns for f in whole(pieces, name)])
        np.testing.assert_array_equal(times, np.arange(2 * spec.fps + 1) * round(1e9 / spec.fps))
        path = ul.Trajectory(
            times, np.stack([0.5e-9 * times, 0 * times, 0 * times], 1), np.tile([0, 0, 0, 1.0], (len(times), 1))
        )
        want = ul.simulate(WALL, path, ul.Rig(sensors={name: spec}), fidelity="thesis")[name]
        got = np.concatenate([f.samples for f in whole(pieces, name)])
        np.testing.assert_allclose(got, want.samples, atol=1e-6)


def test_time_that_jumps_back_begins_anew_and_still_rises():
    said = []
    pieces, script = followed([*line(), *line()], said=said)
    assert said == ["time jumped back 2 s (x): a new track begins, the map goes on"]
    times = np.concatenate([f.t_ns for f in whole(pieces, "front")])
    assert np.all(np.diff(times) > 0)
    samples = np.concatenate([f.samples for f in whole(pieces, "front")])
    assert len(samples) == 42
    np.testing.assert_array_equal(samples[:21], samples[21:])  # the same world from its start gives the same
    back = [f.t_ns - offset for chunk, offset in script.given for f in [chunk["front"]]]
    assert sorted(set(np.concatenate(back))) == sorted(set(times[:21]))  # published by the simulator's own clock


def muddled(events):
    return [e for k, s in enumerate(events) for e in ([s, s, events[k - 1]] if k else [s])]


def far_off(events):
    events.insert(50, ModelPose(6000 * 10**9, (0, 0, 0), (0, 0, 0, 1)))
    events.insert(20, ModelPose(1000 * 10**9, (0, 0, 0), (0, 0, 0, 1)))
    return events


def with_bad(position, quat):
    def made(events):
        for k in (0, 30, 60):
            events.insert(k, ModelPose(events[k].t_ns + 1, position, quat))
        return events

    return made


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (muddled, "x: dropped 100 late"),
        (far_off, "x: dropped 2 bad (a single stamp -4000.38 s away; a single stamp +999"),
        (
            lambda events: [*events, ModelPose(6000 * 10**9, (0, 0, 0), (0, 0, 0, 1))],
            "x: dropped 1 bad (a single stamp",
        ),
        (with_bad((np.nan, 0, 0), (0, 0, 0, 1)), "x: dropped 3 bad (position is not finite)"),
        (with_bad((0, 0, 0), (0, 0, np.inf, 1)), "x: dropped 3 bad (quaternion is not finite)"),
        (with_bad((0, 0, 0), (0, 0, 0, 2)), "x: dropped 3 bad (quaternion is not of unit length)"),
    ],
)
def test_poses_that_are_late_twice_far_off_or_none_are_counted_and_change_no_bit(change, words):
    said = []
    clean, pieces = followed(line(5000, 5002))[0], followed(change(line(5000, 5002)), said=said)[0]
    assert said[-1].startswith(words)
    for name in RIG.sensors:
        a, b = (np.concatenate([f.samples for f in whole(p, name)]) for p in (clean, pieces))
        assert a.tobytes() == b.tobytes()


def shifted(events, by_s):
    return [ModelPose(e.t_ns + round(by_s * 1e9), e.position, e.quat_xyzw) for e in events]


@pytest.mark.parametrize("step_s", [3600.0, -3600.0])
def test_a_step_of_an_hour_begins_a_track_and_computes_nothing_between(step_s):
    """A live simulated radar must not compute the whole hour, nor lose what came after it."""
    said = []
    pieces, script = followed([*line(5000, 5002), *shifted(line(5002, 5004), step_s)], said=said)
    times = np.concatenate([f.t_ns for f in whole(pieces, "left")])
    assert len(times) == 2 * 41
    assert np.all(np.diff(times) > 0)
    assert len(said) == 1
    assert said[0].startswith(f"time jumped {'ahead' if step_s > 0 else 'back'} 3.6e+03 s (x)")
    poses = np.concatenate([f.poses.position[:, 0] for f in whole(pieces, "left")])
    np.testing.assert_allclose(poses, 0.5 * np.r_[np.linspace(5000, 5002, 41), np.linspace(5002, 5004, 41)])
    own = np.concatenate([f.t_ns - offset for chunk, offset in script.given for f in [chunk["left"]]])
    assert own[-1] == round((5004 + step_s) * 1e9)  # published by the simulator's own clock


def test_the_asked_duration_counts_the_tracks_alone():
    pieces, _ = followed([*line(5, 6), *shifted(line(6, 9), 3600)], duration_s=2.0, chunk=4)
    times = np.concatenate([f.t_ns for f in whole(pieces, "left")])
    assert 3607.0e9 <= times[-1] < 3607.5e9


def test_notes_are_said_but_not_over_and_over():
    said = []
    followed([Notice("gone"), Notice("gone"), Notice("back"), *line()], said=said)
    assert said == ["gone", "back"]


def test_falling_behind_is_said():
    said = []
    followed(line(), said=said, newest_ns=9_000_000_000)
    assert len(said) == 1
    assert said[0].startswith("cannot keep up: 8")


def test_nothing_is_published_when_not_asked():
    assert not followed(line(), publish=False)[1].given
    assert followed(line())[1].given


def test_nearest_is_the_first_detection():
    frames = ul.simulate(WALL, ul.Trajectory.stationary(n=3), RIG.sensors["front"], fidelity="thesis")
    np.testing.assert_allclose(nearest(frames), 3.0, atol=0.1)
    empty = ul.simulate(ul.Scene.empty(), ul.Trajectory.stationary(n=3), RIG.sensors["front"], fidelity="thesis")
    assert np.isinf(nearest(empty)).all()


WORLD = """<sdf version="1.6" xmlns:ullage="urn:ullage:sdf"><world name="w"><model name="{}"><link name="l">
  <collision name="c"><geometry><box><size>1 1 1</size></box></geometry></collision>
  <ullage:radar name="down"/></link></model></world></sdf>"""


def test_the_model_that_declares_radars_is_found_and_left_out_of_the_world(tmp_path):
    (tmp_path / "w.sdf").write_text(WORLD.format("drone"))
    options, scene, rig = resolved(CosimulationOptions(world=str(tmp_path / "w.sdf")), "here")
    assert options.model == "drone"
    assert not scene.objects
    assert list(rig.sensors) == ["down"]


def test_radars_come_from_the_world_a_preset_or_a_file(tmp_path):
    (tmp_path / "w.sdf").write_text(WORLD.format("drone"))
    scene = world_of(str(tmp_path / "w.sdf"), where="")
    assert list(rig_of("", scene, "drone", where="").sensors) == ["down"]
    assert rig_of("", scene, "other", where="") == ul.Rig.preset("thesis-4")
    assert rig_of("single", scene, "drone", where="") == ul.Rig.preset("single")
    assert list(rig_of(str(tmp_path / "w.sdf"), ul.Scene.empty(), "drone", where="").sensors) == ["down"]


@pytest.mark.parametrize(
    ("values", "words"),
    [
        ({"wrold": "x"}, r"here: no option 'wrold' \(allowed: lag, rig, .*model, world,"),
        ({"rate_hz": "fast"}, "rate_hz is 'fast'"),
        ({}, r"here: no world \(allowed: world=NAME"),
        ({"world": "ntnu-room"}, r"here: no model \(allowed: model=NAME"),
        ({"world": "atlantis", "model": "x"}, r"here: no world 'atlantis' \(allowed: a world file, or .*cargo-hold"),
        (
            {"world": "ntnu-room", "model": "x", "rig": "five"},
            r"here: no rig 'five' \(allowed: thesis-4, thesis-4-down, thesis-ring, single, or an SDF",
        ),
    ],
)
def test_bad_options_are_refused_in_one_line(values, words):
    with pytest.raises(ul.InputError, match=words):
        resolved(options_of(CosimulationOptions, values, "here"), "here")


class Topics:
    peer = contextlib.ExitStack()  # can be closed

    def __init__(self):
        self.kept = []

    def write(self, frames):
        self.kept.append((frames.sensor, int(frames.t_ns[0])))


def test_a_sink_is_given_frames_in_order_of_time():
    path = ul.Trajectory.stationary(n=3, rate_hz=10)
    both = ul.simulate(WALL, path, RIG, fidelity="thesis")
    topics = Topics()
    with GazeboSink(topics, 0) as sink:
        sink.write(both)
        sink.write(WALL)
    assert [t for _, t in topics.kept] == sorted(2 * [0, 100_000_000, 200_000_000])
    assert {name for name, _ in topics.kept} == {"front", "left"}


def status_of(message):
    message = ros.from_bytes(message.kind, message.data).status[0]
    return message, {pair.key: pair.value for pair in message.values}


def test_diagnostics_count_the_frames_that_were_simulated_and_the_poses_that_were_dropped():
    script = Script([*line(), ModelPose(2_100_000_000, (math.nan, 0, 0), (0, 0, 0, 1))], 0)
    source = CosimulationSource(
        lambda: script, WALL, RIG, CosimulationOptions(fidelity="thesis", model="x"), log=[].append
    )
    found = []
    source.passing.to(found.append)
    with contextlib.suppress(KeyboardInterrupt):
        list(source.stream(8))
    assert {(one.topic, one.kind) for one in found} == {("/diagnostics", "diagnostic_msgs/msg/DiagnosticArray")}
    message, values = status_of(found[0])  # a second later there would be a next one
    assert message.name == "radars"
    assert int(values["frames simulated"]) == int(values["front: frames simulated"]) + int(
        values["left: frames simulated"]
    )
    assert values["late frames"] == "0"


def test_late_frames_drops_and_contacts_make_the_status_a_warning_once():
    wall_s = iter(range(100))
    status, counters = RadarStatus("radars", late_s=1.0, now=lambda: next(wall_s)), Counters()
    piece = followed(line())[0][0]
    status.add(piece, 0.1)
    message, values = status_of(status.message(0, counters))
    assert (message.level, message.message, values["late frames"]) == (0, "simulating", "0")
    status.add(piece, 1.5)
    counters.drop("pose", "bad", "not finite")
    message, values = status_of(status.message(1, counters, contacts=2))
    assert (message.level, message.message) == (1, "late frames, dropped messages, contacts")
    frames = sum(map(len, piece.values()))
    assert (int(values["frames simulated"]), int(values["late frames"])) == (2 * frames, frames)
    assert (values["dropped"], values["contacts"], values["pose: bad"]) == ("1", "2", "1")
    assert values["most behind [s]"] == "1.500"
    assert status_of(status.message(2, counters, contacts=2))[0].level == 0  # nothing new


def test_a_deaf_radar_makes_the_status_an_error():
    wall_s = iter(range(100))
    status, piece = RadarStatus("radars", late_s=1.0, now=lambda: next(wall_s)), followed(line())[0][0]
    name, part = next(iter(piece.items()))
    whole = replace(part, samples=np.zeros((40, len(part.range_m))), t_ns=part.t_ns[0] + 58_000_000 * np.arange(40),
                    poses=None, truth=None)  # fmt: skip
    status.add({**piece, name: whole}, 0.0)
    message, values = status_of(status.message(0, Counters()))
    assert (message.level, message.message.split(", ")[0]) == (2, f"{name} without a signal")
    assert values["faults so far"].startswith(f"{name}: without a signal from 0.0 s")


def test_the_status_comes_once_a_second():
    wall_s = iter([0.0, 0.0, 0.5, 1.1])
    status = RadarStatus("radars", late_s=1.0, now=lambda: next(wall_s))
    assert [status.message(k, Counters()) is not None for k in range(3)] == [True, False, True]


def test_live_radars_take_as_many_bounces_as_a_scenario():
    assert CosimulationOptions(max_bounces=6, model="x").max_bounces == 6
    with pytest.raises(ul.InputError, match=r"max_bounces.*7"):
        options_of(CosimulationOptions, {"max_bounces": "7", "model": "x"}, where="gazebo")
