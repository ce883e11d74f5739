"""A scenario that believes the poses its own radars give."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner

import ullage as ul
from ullage.cli import app
from ullage.config import make_scenario
from ullage.data import gathered
from ullage.experiments.radar_poses import LivePoses, RadarPoses
from ullage.experiments.simulated import prepare

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
