"""A track whose scale or axes are wrong is refused or named; a right one passes."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from ideal_points import frames_of_points

import ullage as ul
from ullage.errors import CalibrationError
from ullage.geometry import rpy_quat
from ullage.processing.point_focus import Point
from ullage.processing.track_check import track_axes, track_scale

SPEC = ul.RadarSpec.preset("pulson440", output="baseband", decimation=6, bins=100, noise=None, range_zero_m=0.05)
POINTS = [(2.5, 0.6, 1.3), (3.4, 1.3, 0.7), (1.8, 1.5, 1.0), (2.9, -0.4, 1.6), (3.6, 2.2, 1.2), (2.2, 2.4, 0.4)]


def flown() -> ul.Trajectory:
    """A run along y that bends and rises, 8 s at 100 Hz, at rest at both ends."""
    t = np.arange(800) / 100.0
    moved = np.clip(t - 1, 0, 6)
    y = 0.35 * moved + 0.1 * np.sin(1.7 * moved)
    position = np.stack([0.15 * np.sin(1.3 * moved), y, 1 + 0.3 * np.sin(0.8 * moved)], axis=1)
    return ul.Trajectory(np.rint(t * 1e9).astype(np.int64), position, np.tile(rpy_quat(0, 0, 0), (800, 1)))


@pytest.fixture(scope="module")
def recorded() -> ul.Frames:
    """Frames whose clock is 0.01 s late and whose range reads 0.05 m long, with their track."""
    track = flown()
    when = np.rint((0.3 + np.arange(370) / 50.0) * 1e9).astype(np.int64)
    clean = frames_of_points(POINTS, track.at(when), spec=SPEC, noise=0.05)
    return ul.Frames(clean.samples, clean.range_m + 0.05, when - 10_000_000, SPEC, track=track, unit="normalised")


def of_scale(frames: ul.Frames, factor: float) -> ul.Frames:
    """The frames with a track of another size."""
    track = frames.track
    return replace(frames, track=ul.Trajectory(track.t_ns, factor * track.position, track.quat_xyzw))


@pytest.mark.slow
def test_a_right_track_passes_with_its_scale(recorded: ul.Frames) -> None:
    found = ul.calibrate(recorded, guess=(0.01, 0.05), t_span_s=0.3).calibration
    assert abs(found.scale - 1) < 3 * found.scale_sigma
    assert found.scale_sigma < 0.05
    assert "scale" not in found.message
    assert "no mount= was set" in found.message


@pytest.mark.slow
@pytest.mark.parametrize("factor", [0.9, 1.1])
def test_a_track_of_another_scale_is_refused(recorded: ul.Frames, factor: float) -> None:
    with pytest.raises(CalibrationError, match=r"the echoes fit a track .* times as large .*allowed: positions in met"):
        ul.calibrate(of_scale(recorded, factor), guess=(0.01, 0.05), t_span_s=0.3)


@pytest.mark.parametrize("factor", [0.9, 1.0, 1.08])
def test_the_scale_of_a_track_is_measured(recorded: ul.Frames, factor: float) -> None:
    found = track_scale(
        of_scale(recorded, factor), of_scale(recorded, factor).track, 0.01, np.array([-0.05]), np.zeros(1)
    )
    assert abs(found.scale - 1 / factor) < 3 * found.sigma
    assert (found.off > 8) == (factor != 1)


@pytest.mark.parametrize(
    ("factor", "words"), [(1.0, ""), (1.05, "do not decide the scale of the track along its length")]
)
def test_a_scale_of_one_axis_alone_is_said(recorded: ul.Frames, factor: float, words: str) -> None:
    track = ul.Trajectory(recorded.track.t_ns, recorded.track.position * [1, factor, 1], recorded.track.quat_xyzw)
    found = track_scale(replace(recorded, track=track), track, 0.01, np.array([-0.05]), np.zeros(1))
    assert abs(found.scale - 1) < 0.01  # no scale of all axes fits better
    assert found.words.endswith(words)
    assert bool(found.words) == bool(words)


def test_a_straight_track_without_range_zero_does_not_tell_its_scale() -> None:
    """Points at one distance: another range offset makes up for every scale."""
    t = np.arange(400) / 50.0
    position = np.stack([0 * t, 0.3 * t, 1 + 0 * t], axis=1)
    path = ul.Trajectory(np.rint(t * 1e9).astype(np.int64), position, np.tile(rpy_quat(0, 0, 0), (400, 1)))
    frames = frames_of_points([(2.5, y, 1.0) for y in (0.4, 1.2, 2.0)], path, spec=SPEC, noise=0.05)
    ranges = 0.06 * np.arange(-10, 11)
    free, known = (track_scale(frames, path, 0.0, ranges, prior) for prior in (0 * ranges, -0.5 * (ranges / 0.02) ** 2))
    assert "do not decide the scale of the track" in free.words
    assert not known.words


def seen_from(directions: np.ndarray, spec: ul.RadarSpec):
    """Axes as judged from points 4 m away in these directions from a track that bends."""
    path = flown().position
    points = [Point(path.mean(0) + 4 * row, np.ones(len(path)), 100.0) for row in directions]
    return track_axes(path, np.tile(np.eye(3), (len(path), 1, 1)), points, np.ones(len(path)), spec)


def ahead(count: int = 12) -> np.ndarray:
    """Directions about the x axis."""
    away = np.random.default_rng(3).normal(0, 0.25, (count, 2))
    rays = np.column_stack([np.ones(count), away])
    return rays / np.linalg.norm(rays, axis=1)[:, None]


def test_directions_of_echoes_show_a_mirrored_track() -> None:
    spec = SPEC.but(
        antenna=ul.AntennaSpec(kind="cosine", azimuth_deg=60, elevation_deg=60), mount=ul.MountSpec(angle_sigma_deg=5)
    )
    right = seen_from(ahead(), spec)
    assert "cannot tell this track from one mirrored in y" in right  # a symmetric beam cannot tell left from right
    assert "mirrored in x" not in right
    with pytest.warns(ul.UllageWarning, match="the track may be mirrored in x"):
        mirrored = seen_from(ahead() * [-1, 1, 1], spec)
    assert "the track may be mirrored in x" in mirrored


def test_without_a_mount_the_axes_are_said_to_be_unchecked() -> None:
    assert "no mount= was set" in seen_from(ahead() * [-1, 1, 1], SPEC.but(mount=ul.MountSpec()))
