"""One estimate of nine quantities: planted values lie within its sigmas, and what echoes leave open keeps its prior."""

from __future__ import annotations

import numpy as np
import pytest
from ideal_points import bearing, frames_of_points

import ullage as ul
from ullage.antenna import gain
from ullage.experiments.calibration_flight import offset_rows
from ullage.geometry import rpy_quat

SPEC = ul.RadarSpec.preset(
    "pulson440", output="baseband", decimation=6, bins=100, noise=None, range_zero_m=0.05,
    antenna={"kind": "cosine", "azimuth_deg": 60, "elevation_deg": 60},
    mount=ul.MountSpec(position_sigma_m=0.05, angle_sigma_deg=10),
)  # fmt: skip
POINTS = [(2.5, 0.6, 1.3), (3.4, 1.3, 0.7), (1.8, 1.5, 1.0), (2.9, -0.4, 1.6), (3.6, 2.2, 1.2), (2.2, 2.4, 0.4)]
ARM_M, PITCH_DEG, YAW_DEG = (0.03, -0.02, 0.01), 5.0, -5.0
CLOCK, ARM, BORESIGHT = 0, slice(3, 6), slice(6, 8)
TRUTH = np.array([0.01, 0, -0.05, *ARM_M, np.radians(PITCH_DEG), np.radians(YAW_DEG), 0])


def recorded(*, straight: bool) -> ul.Frames:
    """Frames of an antenna that is not where its mount says, 0.01 s late and 0.05 m too far."""
    t = np.arange(1200) / 100.0
    moved = np.clip(t - 1, 0, 10)
    swing = 0.4 * (not straight)
    y = np.where((moved < 5) | straight, 0.35 * moved, 0.35 * (10 - moved)) + 0.1 * np.sin(1.7 * moved)
    aside = np.stack([0.15 * np.sin(1.3 * moved), 0 * y, 0.3 * np.sin(0.8 * moved)], axis=1) * (not straight)
    quat = rpy_quat(*(swing * size * np.sin(f * moved) for size, f in ((1, 2.1), (1, 1.5), (2, 0.9))))
    track = ul.Trajectory(np.rint(t * 1e9).astype(np.int64), aside + np.stack([0 * y, y, 1 + 0 * y], axis=1), quat)
    when = np.rint((0.3 + np.arange(570) / 50.0) * 1e9).astype(np.int64)
    true = ul.MountSpec(position_m=ARM_M, pitch_deg=PITCH_DEG, yaw_deg=YAW_DEG)
    flown = track.at(when).mounted(true.body_from_sensor())

    def level(path: ul.Trajectory, points: list) -> np.ndarray:
        ahead = bearing(path, points)
        away = np.linalg.norm(np.asarray(points)[None] - path.position[:, None], axis=2)
        pattern = gain(SPEC.antenna, ahead.reshape(-1, 3)) / gain(SPEC.antenna, [[1.0, 0, 0]])
        return pattern.reshape(away.shape) ** 2 * (3 / away) ** 2

    clean = frames_of_points(POINTS, flown, spec=SPEC, noise=0.02, gain=level)
    return ul.Frames(clean.samples, clean.range_m + 0.05, when - 10_000_000, SPEC, track=track, unit="normalised")


@pytest.mark.slow
def test_a_flight_that_turns_shows_where_the_antenna_is_and_points() -> None:
    found = ul.calibrate(recorded(straight=False), guess=(0.0, 0.02), t_span_s=0.3).calibration
    value, sigma, known = np.array(found.estimates).T
    off = (value - TRUTH) / sigma
    assert (np.abs(off) < 3).all(), off
    assert (sigma[ARM] < 0.1 * known[ARM]).all()
    assert (sigma[BORESIGHT] < np.radians(3)).all()
    np.testing.assert_allclose(np.sqrt(np.diag(found.covariance)), sigma)
    assert not any("lever arm" in name and "not separated" in words for name, _, words in offset_rows(found))


@pytest.mark.slow
def test_a_straight_rail_leaves_the_lever_arm_open_and_the_clock_to_it() -> None:
    frames = recorded(straight=True)
    found = ul.calibrate(frames, guess=(0.0, 0.02), t_span_s=0.3).calibration
    value, sigma, known = np.array(found.estimates).T
    np.testing.assert_allclose(sigma[ARM], known[ARM], rtol=0.02)
    open_ones = [name for name, _, words in offset_rows(found) if "not separated" in words]
    assert {f"joint: lever arm {axis}" for axis in "xyz"} <= set(open_ones)
    assert abs(value[CLOCK] - TRUTH[CLOCK]) < 3 * sigma[CLOCK]
    wide, narrow = (
        ul.calibrate(frames, guess=(0.0, 0.2), t_span_s=0.3, reflectors=POINTS, lever_arm_sigma_m=arm).calibration
        for arm in (0.05, 0.0)
    )  # at surveyed places an antenna farther along the track looks like a later clock
    assert wide.t_sigma_s > 0.05
    assert narrow.t_sigma_s < 0.01
    assert abs(wide.t_offset_s - 0.01) < 3 * wide.t_sigma_s
    assert abs(narrow.t_offset_s - 0.01) > 3 * narrow.t_sigma_s  # the lie of a lever arm taken as known
