"""What cleaning takes out, and what it must leave."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from ideal_points import frames_of_points

import ullage as ul
from ullage.geometry import rpy_quat
from ullage.processing import clean

SPEC = ul.RadarSpec.preset("x4m05", antenna={"kind": "isotropic"}, noise=None)
LEAK = 50.0


def passing(count: int = 60) -> ul.Frames:
    """A point passed by, with a direct path far stronger than it."""
    path = ul.Trajectory.line((0, -1.5, 1.0), (0, 1.5, 1.0), 1.0, 20)
    frames = frames_of_points([(2.5, 0.0, 1.0)], path, spec=SPEC)[:count]
    leak = LEAK * np.exp(-(((frames.range_m - 0.2) / 0.08) ** 2)) * np.exp(0.7j)
    return replace(frames, samples=(frames.samples + leak).astype(np.complex64))


def energy(frames: ul.Frames, low: float, high: float) -> float:
    part = (frames.range_m >= low) & (frames.range_m < high)
    return float(np.sum(np.abs(frames.samples[:, part].astype(complex)) ** 2))


@pytest.mark.parametrize("how", [{"method": "mean"}, {"method": "exponential"}, {"method": "svd"}])
def test_background_goes_and_what_moves_stays(how):
    frames = passing()
    kept = clean.remove_background(frames, **how)
    assert energy(kept, 0, 0.45) < 1e-3 * energy(frames, 0, 0.45)
    nearest = 30, int(np.argmin(abs(frames.range_m - 2.5)))
    assert abs(kept.samples[nearest]) == pytest.approx(abs(frames.samples[nearest]), rel=0.25)


def test_a_standing_sensor_has_nothing_but_background():
    still = frames_of_points([(2.0, 0, 0)], ul.Trajectory.stationary(n=20), spec=SPEC)
    for method in ("mean", "exponential", "svd"):
        assert energy(clean.remove_background(still, method=method), 0, 9) < 1e-8 * energy(still, 0, 9)


def test_exponential_average_looks_back_only():
    frames = passing()
    whole, half = (clean.remove_background(f, method="exponential") for f in (frames, frames[:25]))
    np.testing.assert_array_equal(whole.samples[:25], half.samples)


def test_direct_path_is_zero_up_to_its_end_and_untouched_beyond():
    frames = passing()
    kept = clean.remove_direct_path(frames, until_m=0.5)
    assert energy(kept, 0, 0.5) == 0
    far = frames.range_m >= 0.5
    np.testing.assert_array_equal(kept.samples[:, far], frames.samples[:, far])


def test_floor_is_pressed_down_at_the_height_and_nowhere_else():
    path = ul.Trajectory.line((0, 0, 1.2), (0, 1, 1.2), 0.5, 10)
    frames = frames_of_points([(0, 0.5, 0.0), (4.0, 0.5, 1.2)], path, spec=SPEC)
    kept = clean.suppress_floor(frames, depth_db=30)
    row, down, ahead = 5, np.argmin(abs(frames.range_m - 1.2)), np.argmin(abs(frames.range_m - 4.0))
    drop = 20 * np.log10(abs(kept.samples[row, down]) / abs(frames.samples[row, down]))
    assert drop == pytest.approx(-30, abs=1)
    assert abs(kept.samples[row, ahead]) == pytest.approx(abs(frames.samples[row, ahead]), rel=1e-3)


def received_over(scene: ul.Scene, path: ul.Trajectory, fidelity: str) -> ul.Frames:
    return ul.simulate(scene, path, ul.RadarSpec.preset("x4m05", noise=None), fidelity=fidelity)


@pytest.mark.parametrize("roll_deg", [0.0, 4.0])
def test_rays_off_the_floor_go_at_every_range_and_a_plate_stays(roll_deg):
    flown = ul.Trajectory.line((0, -1, 1.1), (0, 1, 1.1), 0.5, 10)
    tilted = rpy_quat(np.full(len(flown), np.radians(roll_deg)), 0.03 * np.ones(len(flown)), np.zeros(len(flown)))
    path = replace(flown, quat_xyzw=tilted)
    ground = ul.scenes.floor((30.0, 30.0), 0.0)
    plate = ul.scenes.plate(width_m=0.5, height_m=0.5, distance_m=3.0)
    plate = replace(plate, vertices=plate.vertices + np.array([0, 0, 1.1]))
    both = received_over(ul.Scene.union([plate, ground]), path, "thesis")
    bare, alone = (received_over(thing, path, "thesis") for thing in (ground, plate))
    assert energy(clean.suppress_floor(bare), 2.0, 10.0) < 10 ** (-25 / 10) * energy(bare, 2.0, 10.0)
    kept = clean.suppress_floor(both)
    at_plate = abs(both.range_m - 3.0) < 0.06
    ratio = kept.samples[:, at_plate].max(1) / alone.samples[:, at_plate].max(1)
    assert 0.7 < np.median(ratio) < 1.3
    beside = (both.range_m > 3.6) & (both.range_m < 5.5)  # farther the plate's shadow lies on the floor
    assert kept.samples[:, beside].mean() < 0.3 * both.samples[:, beside].mean()


def test_a_rough_floor_goes_beyond_its_foot_too():
    path = ul.Trajectory.line((0, -1, 1.1), (0, 1, 1.1), 0.5, 10)
    frames = frames_of_points([(4.0, 0.0, 1.1)], path, spec=SPEC)
    trace = clean.floor_trace(frames)
    rng = np.random.default_rng(3)
    speckle = trace * (rng.standard_normal(trace.shape) + 1j * rng.standard_normal(trace.shape)) / np.sqrt(2)
    level = 0.1 * abs(frames.samples).max() / trace.max()
    rough = replace(frames, samples=(frames.samples + level * speckle).astype(np.complex64))
    kept = clean.suppress_floor(rough)
    assert energy(kept, 1.5, 3.0) < 0.2 * energy(rough, 1.5, 3.0)
    peak = int(np.argmin(abs(frames.range_m - 4.0)))
    assert abs(kept.samples[10, peak]) == pytest.approx(abs(frames.samples[10, peak]), rel=0.1)
    assert frames.range_m[np.argmax(trace[0])] == pytest.approx(1.15, abs=0.2)


def test_smoothing_is_the_mean_of_neighbours():
    frames = passing()
    bare = replace(frames, samples=np.abs(frames.samples))
    out = clean.smooth(bare, bins=5)
    np.testing.assert_allclose(out.samples[:, 40], bare.samples[:, 38:43].mean(1), rtol=1e-4, atol=1e-5)


@pytest.mark.parametrize(("call", "words"), [
    (lambda f: clean.remove_background(f, method="median"), "no method 'median'.*mean, exponential, svd"),
    (lambda f: clean.remove_background(f, method="exponential", time_constant_s=0), "time_constant_s is 0"),
    (lambda f: clean.remove_background(f, method="svd", rank=0), "rank is 0"),
    (lambda f: clean.suppress_floor(f, floor_m=2.0), "1.00 m under the floor"),
    (lambda f: clean.smooth(f, bins=4), "bins is 4.*odd"),
])  # fmt: skip
def test_bad_numbers_are_refused(call, words):
    with pytest.raises(ul.InputError, match=words):
        call(passing())
