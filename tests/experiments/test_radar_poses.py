"""A scenario that believes the poses its own radars give."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from typer.testing import CliRunner

import ullage as ul
from ullage.cli import app
from ullage.config import make_scenario, read_scenario
from ullage.data import gathered
from ullage.experiments.radar_poses import SMOOTH_HZ, LivePoses, RadarPoses, smoothed
from ullage.experiments.runner import execute
from ullage.experiments.simulated import prepare
from ullage.experiments.source_resolution import make_run, record
from ullage.ports import schema as ros
from ullage.ports.encode import imu_message
from ullage.ports.protocol import Passed
from ullage.ports.replay import McapSource

DATA = Path(__file__).parents[3] / "shared" / "data" / "pulson440"

SHORT = {"name": "short", "world": {"name": "ntnu-room"},
         "flight": {"poses": "radar", "waypoints": [[-2.8, -1.9, 1.1], [-2.2, -1.9, 1.1]]}}  # fmt: skip


def test_processors_believe_what_the_radars_show_and_not_the_truth() -> None:
    ready = prepare(make_scenario(SHORT))
    with pytest.warns(ul.UllageWarning, match="simulated from the true flight.*often lost"):
        front = gathered(ready.stream())["front"]
    truth = ready.flown.mounted(front.spec.mount.body_from_sensor()).at(front.t_ns)
    error = np.linalg.norm(front.believed.position - truth.position, axis=1)
    assert 1e-4 < np.sqrt((error**2).mean()) < 0.2


def test_a_guarded_flight_by_them_says_how_far_they_were_off() -> None:
    ready = prepare(make_scenario(SHORT, options=["flight.guard.on=true", "sensing.rate_hz=10"]))
    assert ready.odometry is not None
    front = gathered(ready.stream())["front"]
    lines, found = ready.odometry.report()
    truth = ready.flown.mounted(front.spec.mount.body_from_sensor())
    error = np.linalg.norm(front.believed.position - truth.position, axis=1)
    assert len(front) == len(ready.flown)
    assert 1e-4 < np.sqrt((error**2).mean()) < 0.1
    assert {one.name: one.value for one in found}["pose_rms"] < 0.1
    assert "simulated from the true flight" in lines[0]


def scores(poses: RadarPoses, frames: ul.Frames) -> tuple[list[str], dict[str, float]]:
    """Sentences and numbers of a finished run on one radar's frames, with the frames that it kept."""
    with pytest.warns(ul.UllageWarning, match="simulated from the recorded track"):
        kept = gathered(poses.placed(iter([{frames.sensor: frames}])))[frames.sensor]
    lines, found = poses.report()
    return lines, {one.name: one.value for one in found} | {"kept": len(kept)}


@pytest.mark.parametrize(
    ("name", "offsets", "rms_m", "end_m"),
    [("rail_a", (4.476, -0.434), 0.8, 1.9), ("flight_a", (6.530, -0.317), 0.65, 1.7)],
)
@pytest.mark.filterwarnings("ignore::ullage.errors.UllageWarning")
def test_a_recording_is_placed_by_its_radar_until_the_poses_are_said_to_be_lost(
    name: str, offsets: tuple[float, float], rms_m: float, end_m: float
) -> None:
    """With the offsets that `ullage run` finds; the radar is alone, so the inertial unit is nearly alone."""
    if not (DATA / name).exists():
        pytest.skip("the real recordings are not here")
    raw = ul.open(DATA / name).frames()
    assert isinstance(raw, ul.Frames)
    assert raw.track is not None
    t_ns = raw.t_ns + round(offsets[0] * 1e9)
    frames = replace(raw, t_ns=t_ns, range_m=raw.range_m + offsets[1], poses=None)
    poses = RadarPoses(raw.track, seed=7, source="recorded track", captured=True)
    lines, found = scores(poses, frames)
    assert 0.01 < found["pose_rms"] < rms_m
    assert found["pose_end"] < end_m
    assert found["pose_sigmas"] < 3.0
    assert 10 < found["poses_lost"] < 45
    assert found["kept"] == pytest.approx(len(frames) * (1 - found["poses_lost"] / 100))
    assert any(line.startswith("The poses are lost from 11.") for line in lines)


def test_noise_of_motion_capture_is_not_taken_for_motion() -> None:
    """0.3 mm of it at 200 Hz are 8 m/s2; one radar and one echo leave the inertial unit nearly alone."""
    spec, rng = ul.RadarSpec.preset("x4m05", noise=None, bins=110), np.random.default_rng(1)
    t_s = np.arange(0, 10, 0.005)
    way = np.where(t_s > 2, 0.5 * (t_s - 2 - np.sin(0.8 * (t_s - 2)) / 0.8), 0.0)
    place = np.stack([0 * way, way, 1 + 0.1 * np.sin(way)], axis=1)
    noisy = place + rng.normal(size=place.shape) * 3e-4
    track = ul.Trajectory((t_s * 1e9).astype(np.int64), noisy, np.tile([0.0, 0, 0, 1], (len(t_s), 1)))
    at = track.t_ns[20::8]
    away = np.linalg.norm(place[20::8] - [2.5, 0.6, 1.0], axis=1)[:, None]
    pulse = np.exp(-0.5 * ((spec.range_m - away) * 2 / 299_792_458 / spec.pulse_sigma_s) ** 2)
    samples = pulse * np.exp(-4j * np.pi / spec.wavelength_m * away) + 0.01 * rng.normal(size=(len(at), 110, 2)) @ [
        1,
        1j,
    ]
    frames = ul.Frames(samples.astype(np.complex64), spec.range_m, at, spec)
    _, found = scores(RadarPoses(track, seed=3, source="recorded track", captured=True), frames)
    assert 0.002 < found["pose_rms"] < 0.5
    assert found["pose_sigmas"] < 3.5
    assert found["pose_rms_of_path"] == pytest.approx(100 * found["pose_rms"] / way[-1], rel=0.05)


def test_readings_of_a_flight_do_not_change_where_they_are_made_step_by_step() -> None:
    """In closed loop the true path comes pose by pose."""
    flown = ul.fly(ul.Waypoints([(0, 0, 1), (1, 0, 1), (1, 1, 1)], speed_m_s=0.5), rate_hz=10)
    live, given = LivePoses(5), list[ul.Imu]()
    live.read = lambda imu: given.append(imu) or imu  # type: ignore[method-assign, func-returns-value]
    for k in range(len(flown)):
        live(flown[k : k + 1], {})
    whole = ul.simulate_imu(flown, seed=5)
    t_ns = np.concatenate([one.t_ns for one in given])
    force = np.concatenate([one.specific_force for one in given])
    assert np.array_equal(t_ns, whole.t_ns)
    assert np.allclose(force[whole.t_ns > 0], whole.specific_force[whole.t_ns > 0], atol=1e-6)


def test_live_frames_are_not_placed_by_odometry(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    place = "mavlink:udpin://127.0.0.1:14599?world=ntnu-room&rig=thesis-4"
    done = CliRunner().invoke(app, ["run", place, "--poses", "radar"])
    assert isinstance(done.exception, ul.InputError)
    assert "live frames keep their poses" in str(done.exception)
    assert not (tmp_path / "runs").exists()


@pytest.mark.parametrize("how", [("--poses", "radar"), ("-o", "flight.poses=radar")])
def test_a_recording_without_a_track_gives_no_poses_by_radar_and_one_line(
    how: tuple[str, str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    spec, t_s = ul.RadarSpec.preset("x4m05", bins=60), np.arange(0, 2, 0.1)
    np.savez(tmp_path / "radar.npz", samples=np.ones((20, 60), np.complex64), times_s=t_s, ranges_m=spec.range_m,
             center_hz=np.array(spec.center_hz), bandwidth_hz=np.array(spec.bandwidth_hz))  # fmt: skip
    monkeypatch.chdir(tmp_path)
    done = CliRunner().invoke(app, ["run", str(tmp_path / "radar.npz"), *how])
    assert isinstance(done.exception, ul.InputError)
    assert "a recording without a track" in str(done.exception)
    assert len(str(done.exception).splitlines()) == 1
    assert not (tmp_path / "runs").exists()


@pytest.fixture(scope="module")
def recording(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A flight of four radars from 10 s on, without an inertial unit."""
    path = tmp_path_factory.mktemp("flight") / "flight.mcap"
    frames = gathered(prepare(make_scenario(SHORT, options=["flight.poses=navigation"])).stream())
    for name, part in frames.items():
        t_ns = part.t_ns + 10_000_000_000
        frames[name] = replace(part, t_ns=t_ns, poses=replace(part.believed, t_ns=t_ns), truth=None)
    with ul.sink(path) as sink:
        sink.write(frames)
    return path


def unit_of(recording: Path, *, seed: int = 7) -> ul.Imu:
    """Readings along the poses of a recording, as a run simulates them."""
    front = ul.open(recording).frames("front")
    body = front.believed.mounted(np.linalg.inv(front.spec.mount.body_from_sensor()))
    return ul.simulate_imu(smoothed(body, SMOOTH_HZ), seed=seed)


def bag(path: Path, *units: ul.Imu) -> Path:
    """A bag with a topic for each inertial unit."""
    with ul.sink(path) as sink:
        write_units(sink, units)
    return path


def write_units(sink: Any, units: Iterable[ul.Imu]) -> None:
    for number, one in enumerate(units):
        for t_ns, turn, force in zip(one.t_ns.tolist(), one.angular_velocity, one.specific_force, strict=True):
            data = imu_message(t_ns, None, turn, force, frame_id="base_link")
            sink.write(Passed(t_ns, f"imu{number}", ros.IMU, data))


def carried_out(target: Path, out: Path, *options: str) -> tuple[ul.Trajectory, str]:
    """Poses of the front radar in the recording of a run, and the sentences of its report."""
    options = ("flight.poses=radar", *options)
    job = make_run(str(target), tasks=("detect",), options=options, out=out, force=True)
    report = execute(job, sinks=[record(job)], draw=False)
    return ul.open(report.folder).frames("front").believed, " ".join(report.findings)


@pytest.mark.filterwarnings("ignore::ullage.errors.UllageWarning")
def test_readings_that_were_recorded_count_and_give_what_the_same_simulated_ones_give(
    recording: Path, tmp_path: Path
) -> None:
    simulated, by_simulated = carried_out(recording, tmp_path)
    file = bag(tmp_path / "imu.mcap", unit_of(recording))
    found, by_recorded = carried_out(recording, tmp_path, f"flight.imu_file={file}")
    assert np.abs(found.position - simulated.position).max() < 1e-6
    assert "inertial unit and an altimeter simulated" in by_simulated
    assert "inertial unit recorded in imu.mcap" in by_recorded
    assert "a BMI088" in by_recorded
    sheet = f"flight.imu_file={file}", "flight.imu.accel_noise_ug=1000"
    doubted, by_sheet = carried_out(recording, tmp_path, *sheet)
    assert 1e-6 < np.abs(doubted.position - simulated.position).max() < 0.1
    assert "offsets from flight.imu." in by_sheet
    other = bag(tmp_path / "other.mcap", unit_of(recording, seed=1))
    another, _ = carried_out(recording, tmp_path, f"flight.imu_file={other}")
    assert 1e-6 < np.abs(another.position - simulated.position).max() < 0.1


@pytest.mark.filterwarnings("ignore::ullage.errors.UllageWarning")
def test_a_run_keeps_the_readings_that_its_recording_has(recording: Path, tmp_path: Path) -> None:
    unit = unit_of(recording)
    file = bag(tmp_path / "imu.mcap", unit)
    options = "flight.poses=navigation", f"flight.imu_file={file}"
    carried_out(recording, tmp_path, *options)
    (folder,) = tmp_path.glob("flight-*")
    again = ul.read_imu(folder)
    assert np.array_equal(again.t_ns, unit.t_ns)
    assert np.array_equal(again.specific_force, unit.specific_force)
    message = next(data for _, _, data in McapSource(folder / "frames.mcap").messages(ros.IMU))
    assert ros.from_bytes(ros.IMU, message).orientation_covariance[0] == -1  # as sensor_msgs/Imu says of no attitude
    _, sentences = carried_out(folder, tmp_path / "again")
    assert "inertial unit recorded in frames.mcap" in sentences
    known = read_scenario(tmp_path / "again" / "latest" / "scenario.yaml")
    assert known.flight.imu_file == str(folder / "frames.mcap")
    _, sentences = carried_out(folder, tmp_path / "again", "flight.imu_file=simulated")
    assert "inertial unit and an altimeter simulated" in sentences


@pytest.mark.filterwarnings("ignore::ullage.errors.UllageWarning")
def test_readings_in_flight_before_the_first_frame_are_not_taken_for_rest(recording: Path, tmp_path: Path) -> None:
    """From a fast moment on, those before it change nothing."""
    later = {name: part[part.t_ns > 11_000_000_000] for name, part in ul.open(recording).frames().items()}
    with ul.sink(tmp_path / "later.mcap") as sink:
        sink.write(later)
    assert np.linalg.norm(later["front"].believed.rates[0][0]) > 0.2
    unit, poses = unit_of(recording), []
    for since_ns in (0, later["front"].t_ns[0] - 5_000_000):
        file = bag(tmp_path / f"imu{since_ns}.mcap", unit[unit.t_ns > since_ns])
        poses.append(carried_out(tmp_path / "later.mcap", tmp_path, f"flight.imu_file={file}")[0])
    assert len(poses[0]) > 20
    assert np.array_equal(poses[0].position, poses[1].position)


def test_a_recording_that_begins_at_rest_shows_the_offsets_of_its_unit_first(tmp_path: Path) -> None:
    """Frames and readings begin together, 3 s before the flight."""
    t_s = np.arange(0, 6, 1 / 17)
    far = 0.3 * np.where(t_s > 3, t_s - 3 - np.sin(2 * (t_s - 3)) / 2, 0.0)
    place = np.stack([far - 2, 0.5 * far - 1.5, 0 * far + 1.1], axis=1)
    flown = ul.Trajectory((t_s * 1e9).astype(np.int64) + 10**10, place, np.tile([0.0, 0, 0, 1], (len(t_s), 1)))
    frames = ul.simulate(ul.scenes.room(size_m=(8, 6, 3)), flown, ul.Rig.preset("thesis-4"), seed=1)
    with ul.sink(tmp_path / "flight.mcap") as sink:
        sink.write(frames)
        write_units(sink, [ul.simulate_imu(flown, still_s=0.0, seed=3)])
    with pytest.warns(ul.UllageWarning, match=r"frames of the first 2\.000 s, a rest.*are left out"):
        found, sentences = carried_out(tmp_path / "flight.mcap", tmp_path)
    assert found.t_ns[0] == flown.t_ns[34]
    assert np.abs(found.position - frames["front"].believed.at(found.t_ns).position).max() < 0.1
    assert "lost from" not in sentences


def test_frames_outside_the_readings_are_left_out_with_a_warning(recording: Path, tmp_path: Path) -> None:
    unit, front = unit_of(recording), ul.open(recording).frames("front")
    file = bag(tmp_path / "imu.mcap", unit[unit.t_ns > front.t_ns[10] - 5_000_000])
    with pytest.warns(ul.UllageWarning, match=r"imu\.mcap: 44 of 168 frames lie outside its readings"):
        found, _ = carried_out(recording, tmp_path, f"flight.imu_file={file}")
    assert found.t_ns[0] == front.t_ns[10]


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (lambda one: ul.Imu(one.t_ns + 10**11, one.angular_velocity, one.specific_force),
         r"readings of the inertial unit from 108\.\d+ to 112\.\d+ s \(allowed: the frames' time, 10\.000 to 12"),
        (lambda one: one[(one.t_ns < 11 * 10**9) | (one.t_ns > 11.2 * 10**9)],
         r"no readings for 0\.210 s from 10\.995 s on \(allowed: 0\.059 s, the time from one frame to the next"),
        (lambda one: ul.Imu(one.t_ns, one.angular_velocity, one.specific_force / 9.81),
         r"a specific force of 1.01 m/s2 in the median \(allowed: m/s2 with gravity"),
        (lambda one: one[:1], r"1 readings of an inertial unit in it \(allowed: two or more"),
    ],
)  # fmt: skip
def test_readings_that_do_not_fit_the_frames_are_refused_in_one_line(
    recording: Path, tmp_path: Path, change: Callable[[ul.Imu], ul.Imu], words: str
) -> None:
    file = bag(tmp_path / "imu.mcap", change(unit_of(recording)))
    refuse(tmp_path, [str(recording), "--poses", "radar", "-o", f"flight.imu_file={file}"], f"^{file}: {words}")


def refuse(out: Path, arguments: list[str], words: str) -> None:
    """Check that `ullage run` ends with code 2 and one line, and leaves no run."""
    done = CliRunner().invoke(app, ["run", *arguments, "--out", str(out / "runs")])
    assert isinstance(done.exception, ul.InputError)
    assert done.exception.exit_code == 2
    assert re.search(words, str(done.exception))
    assert len(str(done.exception).splitlines()) == 1
    assert not (out / "runs").exists()


def test_a_file_without_the_inertial_unit_that_is_asked_for_is_refused(recording: Path, tmp_path: Path) -> None:
    named = "--poses", "radar", "-o"
    refuse(tmp_path, [str(recording), *named, f"flight.imu_file={recording}"], "0 topics hold an inertial unit")
    with pytest.raises(ul.InputError, match=r"flight\.imu_file: a simulated flight reads no a\.ulg"):
        prepare(make_scenario(SHORT, options=["flight.imu_file=a.ulg"]))


@pytest.mark.filterwarnings("ignore::ullage.errors.UllageWarning")
def test_of_two_units_in_a_recording_a_run_wants_one_named(recording: Path, tmp_path: Path) -> None:
    two = [unit_of(recording), unit_of(recording, seed=1)]
    with ul.sink(tmp_path / "flight.mcap") as sink:
        sink.write(ul.open(recording).frames())
        write_units(sink, two)
    target = str(tmp_path / "flight.mcap")
    refuse(tmp_path, [target, "--poses", "radar"], r"2 topics hold an inertial unit: say topic=.*/imu0, /imu1")
    _, sentences = carried_out(Path(target), tmp_path, "flight.imu_topic=/imu1")
    assert "recorded in flight.mcap" in sentences
    with pytest.warns(ul.UllageWarning, match="2 topics hold.*; the run leaves the inertial unit out"):
        carried_out(Path(target), tmp_path, "flight.poses=navigation")
