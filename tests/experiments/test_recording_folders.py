"""Folders with a radar recording and a track: mapped where they fit each other, refused where they do not."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

import ullage as ul
from tests.command import ended
from tests.ports.vehicle_logs import dataflash, dataflash_of_imu

SPEC = ul.RadarSpec.preset("x4m05", antenna={"kind": "isotropic"}, noise=None, bins=110)
POINTS = np.array([(2.5, 0.6, 1.0), (3.4, 1.3, 1.0), (1.8, 1.5, 1.0), (2.9, -0.4, 1.0), (4.0, 0.2, 1.0)])
CLOCK_S, RANGE_M = 1.5, 0.3


def flown(seed: int, *, seconds: float = 10.0) -> ul.Trajectory:
    """Standing, an uneven and slightly winding run, standing again."""
    t = np.arange(0, seconds, 0.01)
    rng = np.random.default_rng(seed)
    pace = 0.22 + 0.05 * np.sin(1.7 * t + 6 * rng.random()) + 0.05 * np.sin(3.1 * t + 6 * rng.random())
    start = 2.0 + rng.random()
    y = np.cumsum(np.where((t > start) & (t < seconds - 3), pace, 0.0)) * 0.01
    position = np.stack([0.03 * np.sin(5 * y), y, 1 + 0 * t], axis=1)
    return ul.Trajectory(np.rint(t * 1e9).astype(np.int64), position, np.tile([0.0, 0, 0, 1], (len(t), 1)))


def received(
    track: ul.Trajectory, *, slow: float = 1.0, noise: float = 0.05, points: np.ndarray = POINTS
) -> dict[str, np.ndarray]:
    """What a radar receives that starts CLOCK_S after the track, reads RANGE_M too far, and whose clock may be slow."""
    t_s = np.arange(0, 7, 0.025)
    at = track.at(np.rint((CLOCK_S + t_s) * 1e9).astype(np.int64)).position
    away = np.linalg.norm(at[:, None] - points, axis=2)[:, :, None]
    pulse = np.exp(-0.5 * ((SPEC.range_m - away) * 2 / 299_792_458 / SPEC.pulse_sigma_s) ** 2)
    samples = (pulse * np.exp(-4j * np.pi / SPEC.wavelength_m * away)).sum(1)
    rng = np.random.default_rng(3)
    samples += noise * (rng.normal(size=samples.shape) + 1j * rng.normal(size=samples.shape))
    return {"samples": samples, "times_s": t_s * slow, "ranges_m": SPEC.range_m + RANGE_M,
            "center_hz": np.array(SPEC.center_hz), "bandwidth_hz": np.array(SPEC.bandwidth_hz)}  # fmt: skip


def write(folder: Path, arrays: dict[str, np.ndarray], track: ul.Trajectory) -> Path:
    np.savez(folder / "radar.npz", **arrays)
    rows = (f"{t * 1e-9},{x},{y},{z}" for t, (x, y, z) in zip(track.t_ns, track.position, strict=True))
    (folder / "track.csv").write_text("t_s,x_m,y_m,z_m\n" + "\n".join(rows))
    return folder


def run(folder: Path, *options: str) -> int | str | None:
    """The exit code of `ullage run` on a folder."""
    return ended(("run", str(folder), *options), folder)


def calibrated(folder: Path) -> ul.data.Calibration:
    frames = ul.open(folder).frames()
    assert isinstance(frames, ul.Frames)
    found = ul.calibrate(frames).calibration
    assert found is not None
    return found


@pytest.mark.slow
def test_the_track_of_another_flight_ends_with_exit_1_and_no_map(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    write(tmp_path, received(flown(1)), flown(2))
    assert run(tmp_path) == 1
    said = capsys.readouterr().err.strip().splitlines()
    assert len(said) == 1
    assert said[0].startswith("ullage: radar: ")
    assert "do not follow the track" in said[0] or "no clock offset is certain" in said[0]
    assert not list(tmp_path.rglob("map.*"))
    assert not (tmp_path / "runs" / "latest").exists()


@pytest.mark.slow
def test_surveyed_reflectors_settle_the_offsets_of_a_run(tmp_path: Path) -> None:
    write(tmp_path, received(flown(1)), flown(1))
    (tmp_path / "reflectors.csv").write_text("name,x_m,y_m,z_m\ncorner,2.5,0.6,1\n,1.8,1.5,1\n")
    assert run(tmp_path, "--do", "image,map", "-o", "map.reach_m=4") == 0
    folder = tmp_path / "runs" / "latest"
    said = (folder / "verdict.txt").read_text()
    assert "The surveyed reflectors settled the offsets" in said
    assert "(2.50, 0.60, 1.00) m is on the map" in said
    assert "(1.80, 1.50, 1.00) m is on the map" in said
    metrics = json.loads((folder / "metrics.json").read_text())
    assert metrics["occupied_to_path"]["value"] > 0.3
    clock, range_m = said.split("Clock offset ")[1].split(" +- ")[0], said.split("range offset ")[1].split(" +- ")[0]
    assert float(clock) == pytest.approx(CLOCK_S, abs=0.03)
    assert float(range_m) == pytest.approx(-RANGE_M, abs=0.03)


@pytest.mark.slow
def test_a_map_without_an_image_shows_scatterers_at_the_height_of_the_survey(tmp_path: Path) -> None:
    """The track is straight, so a scatterer's height is assumed; a wrong one would move it by 0.3 m."""
    write(tmp_path, received(flown(1), points=POINTS - [0, 0, 1.2]), flown(1))
    (tmp_path / "reflectors.csv").write_text("name,x_m,y_m,z_m\ncorner,2.5,0.6,-0.2\n,1.8,1.5,-0.2\n")
    assert run(tmp_path, "--do", "map", "-o", "map.reach_m=4") == 0
    said = (tmp_path / "runs" / "latest" / "verdict.txt").read_text()
    assert "(2.50, 0.60, -0.20) m is on the map" in said
    assert "(1.80, 1.50, -0.20) m is on the map" in said


@pytest.mark.slow
def test_reflectors_that_the_radar_does_not_see_end_with_exit_1(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    write(tmp_path, received(flown(1)), flown(1))
    (tmp_path / "reflectors.csv").write_text("x_m,y_m,z_m\n-80,-90,1\n")
    assert run(tmp_path) == 1
    assert "no surveyed reflector stays coherent along the track" in capsys.readouterr().err


@pytest.mark.slow
def test_dropped_frames_and_packets_do_not_move_the_offsets(tmp_path: Path) -> None:
    arrays = received(flown(1))
    rng = np.random.default_rng(7)
    kept = rng.random(len(arrays["times_s"])) > 0.1
    arrays["samples"][rng.random(len(kept)) < 0.05, 60:] = 0
    write(tmp_path, arrays | {name: arrays[name][kept] for name in ("samples", "times_s")}, flown(1))
    found = calibrated(tmp_path)
    assert found.t_offset_s == pytest.approx(CLOCK_S, abs=0.03)
    assert found.range_offset_m == pytest.approx(-RANGE_M, abs=3 * found.range_sigma_m)
    assert found.range_sigma_m < 0.1


@pytest.mark.slow
def test_a_radar_clock_that_is_a_thousandth_slow_is_still_calibrated(tmp_path: Path) -> None:
    """The offset then holds for the middle of the flight, 3.5 ms from that of its start."""
    found = calibrated(write(tmp_path, received(flown(1), slow=0.999), flown(1)))
    assert found.t_offset_s == pytest.approx(CLOCK_S, abs=0.03)
    assert found.range_offset_m == pytest.approx(-RANGE_M, abs=3 * found.range_sigma_m)
    assert found.range_sigma_m < 0.1


@pytest.mark.slow
def test_the_log_of_an_autopilot_is_track_and_inertial_unit_of_poses_by_radar(tmp_path: Path) -> None:
    """The radar's own clock is 1.5 s behind; the unit counts by that of the log, so the poses are right."""
    pytest.importorskip("pymavlink")
    write(tmp_path, received(flown(1)), flown(1))
    (tmp_path / "track.csv").unlink()
    unit = ul.simulate_imu(flown(1), still_s=0.0, seed=11)
    (tmp_path / "track.bin").write_bytes(dataflash(flown(1)) + dataflash_of_imu(unit))
    assert run(tmp_path, "--poses", "radar", "--do", "detect") == 0
    folder = tmp_path / "runs" / "latest"
    said = (folder / "verdict.txt").read_text()
    assert "inertial unit recorded in track.bin" in said
    assert json.loads((folder / "metrics.json").read_text())["pose_rms"]["value"] < 0.15
    kept, front = ul.read_imu(folder), ul.open(folder).frames()
    assert isinstance(front, ul.Frames)
    assert kept.t_ns[0] < front.t_ns[0] - 1_000_000_000
    np.testing.assert_allclose(kept.specific_force, unit[np.isin(unit.t_ns, kept.t_ns)].specific_force, atol=1e-5)


def test_a_track_and_a_radar_of_other_times_are_refused(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    arrays = received(flown(1, seconds=10))
    for name in ("samples", "times_s"):
        arrays[name] = arrays[name][:40]
    still = flown(1)[:5]
    write(tmp_path, arrays, still)
    assert run(tmp_path) == 2
    assert "the track spans 0.00 m" in capsys.readouterr().err
    (tmp_path / "radar.npz").write_bytes(b"")
    assert run(tmp_path) == 2
    assert "cannot be read" in capsys.readouterr().err
