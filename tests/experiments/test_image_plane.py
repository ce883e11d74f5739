"""Which plane a run images, what is said when targets lie elsewhere, and how frames are numbered."""

from __future__ import annotations

import warnings

import numpy as np
import pytest

import ullage as ul
from ullage.config import ImageSpec, make_scenario
from ullage.experiments.imaging import image_plane, plane_findings
from ullage.experiments.run import SampledFrames

BOX = np.array([[-2.0, -2.0, 0.0], [2.0, 2.0, 2.0]])
SPEC = ul.RadarSpec.preset("x4m05", antenna={"kind": "isotropic"}, noise=None)


def past_points(points: list[tuple[float, float, float]], rise_m: float) -> ul.Frames:
    """Frames of a flight along y that climbs and sinks, past points."""
    path = ul.Trajectory.line((0, -1, 0), (0, 1, 0), 0.2, 17)
    position = path.position.copy()
    position[:, 2] += rise_m * np.sin(np.linspace(0, 2 * np.pi, len(path)))
    path = ul.Trajectory(path.t_ns, position, path.quat_xyzw)
    samples = np.zeros((len(path), SPEC.bins), np.complex64)
    for point in points:
        away = np.linalg.norm(position - point, axis=1)[:, None]
        pulse = np.exp(-(((SPEC.range_m - away) / (2 * SPEC.pulse_sigma_s * 3e8 / 2)) ** 2))
        samples += (pulse * np.exp(-4j * np.pi * away / SPEC.wavelength_m)).astype(np.complex64)
    return ul.Frames(samples, SPEC.range_m, path.t_ns, SPEC, poses=path)


def test_the_plane_is_the_set_one_else_the_surveyed_else_the_flights() -> None:
    marks = np.array([[1.0, 1.0, 0.1]])
    set_at = image_plane(ImageSpec(z_m=0.7), BOX, flight_m=1.5, marks=marks)
    surveyed = image_plane(ImageSpec(), BOX, flight_m=1.5, marks=marks)
    flown = image_plane(ImageSpec(), BOX, flight_m=1.5)
    assert [p.grid.origin_m[2] for p in (set_at, surveyed, flown)] == [0.7, 0.1, 1.5]
    assert "surveyed reflectors" in surveyed.text
    assert "z = 1.50 m (the flight's height)" in flown.text
    high_and_low = np.array([[1.0, 1.0, 0.1], [1.0, 0.0, 1.9]])
    assert image_plane(ImageSpec(), BOX, flight_m=1.5, marks=high_and_low).grid.origin_m[2] == 1.5


def test_a_volume_has_the_heights_asked_for() -> None:
    plane = image_plane(ImageSpec(volume=(0.2, 1.2), step_m=0.1), BOX, flight_m=1.5, margin_m=1.0)
    assert plane.grid.shape == (10, 60, 60)
    assert plane.grid.z_m[0] == pytest.approx(0.25)
    assert "volume z = 0.20 .. 1.20 m" in plane.text


@pytest.mark.parametrize(
    ("option", "words"),
    [
        ("image.volume=[2, 0]", "rising heights"),
        ("image.z_m=.inf", "finite|less than"),
        ("image={z_m: 1, volume: [0, 1]}", "both set"),
    ],
)
def test_impossible_planes_are_refused_in_one_line(option: str, words: str) -> None:
    with pytest.raises(ul.InputError, match=words) as refusal:
        make_scenario({"name": "a"}, options=[option])
    assert "\n" not in str(refusal.value)


def test_targets_off_the_plane_are_warned_of() -> None:
    frames = past_points([(1.5, -0.4, -0.8), (1.5, 0.5, -0.8)], rise_m=0.3)
    off = ul.focus(frames, ul.Grid((0.5, -1.5, 0.0), 0.02, (150, 90)))
    with pytest.warns(ul.UllageWarning, match=r"focuses .* dB better at z = -0.8 m, the image plane at 0.00 m"):
        assert plane_findings(off, {"radar": frames}) == ""
    right = ul.focus(frames, ul.Grid((0.5, -1.5, -0.8), 0.02, (150, 90)))
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        assert plane_findings(right, {"radar": frames}) == ""


def test_a_straight_track_says_that_it_cannot_tell_heights() -> None:
    frames = past_points([(1.5, -0.4, -0.8), (1.5, 0.5, -0.8)], rise_m=0.0)
    image = ul.focus(frames, ul.Grid((0.5, -1.5, 0.0), 0.02, (150, 90)))
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        assert "heights not resolved" in plane_findings(image, {"radar": frames})


def test_a_survey_off_the_plane_is_warned_of() -> None:
    frames = past_points([(1.5, 0.0, -0.8)], rise_m=0.0)
    image = ul.focus(frames, ul.Grid((0.5, -1.5, 0.0), 0.02, (150, 90)))
    with pytest.warns(ul.UllageWarning, match=r"at z = -0.80 m, the image plane at 0.00 m.*image.z_m=-0.80"):
        said = plane_findings(image, {"radar": frames}, marks=np.array([[1.5, 0.0, -0.8]]))
    assert "heights not resolved" in said
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        assert plane_findings(image, {"radar": frames}, marks=np.array([[1.5, 0.0, 0.1]])) == said


def test_kept_frames_know_their_number_in_the_recording() -> None:
    path = ul.Trajectory.stationary(n=1511)
    t_ns = path.t_ns
    frames = ul.Frames(np.zeros((1511, SPEC.bins), np.complex64), SPEC.range_m, t_ns, SPEC, poses=path, sensor="front")
    sampled = SampledFrames()
    for part in frames.chunks(100):
        sampled.update({"front": part})
    kept = sampled.frames()["front"]
    assert len(kept) < 400
    for index in (0, 57, len(kept) // 2, len(kept) - 1):
        assert t_ns[sampled.number("front", index)] == kept.t_ns[index]
