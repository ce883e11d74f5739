"""What the drone believes differs from the truth by as much as asked, and by nothing else."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import ullage as ul

PATH = ul.Trajectory.line((0, 0, 1), (300, 0, 1), 0.5, 10)


def _yaw_error(believed):
    turn = Rotation.from_quat(believed.quat_xyzw) * Rotation.from_quat(PATH[::20].quat_xyzw).inv()
    return turn.as_rotvec()


def test_no_errors_asked_for_gives_the_same_poses():
    believed = ul.navigate(PATH)
    assert np.array_equal(believed.position, PATH.position)
    assert np.array_equal(believed.quat_xyzw, PATH.quat_xyzw)
    assert np.array_equal(believed.t_ns, PATH.t_ns)


def test_white_noise_has_its_size_no_mean_and_no_memory():
    error = ul.navigate(PATH, noise_m=0.02, seed=3).position - PATH.position
    n = len(error)
    np.testing.assert_allclose(error.std(0), 0.02, rtol=4 / np.sqrt(2 * n))
    assert np.abs(error.mean(0)).max() < 4 * 0.02 / np.sqrt(n)
    correlation = (error[1:] * error[:-1]).mean(0) / error.var(0)
    assert np.abs(correlation).max() < 4 / np.sqrt(n)
    assert np.abs(np.corrcoef(error.T) - np.eye(3)).max() < 4 / np.sqrt(n)


def test_drift_is_smooth_and_has_its_size_and_pace():
    sizes, overlap = [], []
    for seed in range(12):
        believed = ul.navigate(PATH, drift_m=0.2, drift_time_s=15.0, seed=seed)
        error = believed.position - PATH.position
        sizes.append((error**2).mean(0))
        overlap.append((error[150:] * error[:-150]).mean(0))
        assert np.abs(np.diff(error, axis=0)).max() < 0.2 / 15 * 0.1 * 5
        slope = np.gradient(error, 0.1, axis=0)
        np.testing.assert_allclose((believed.rates[0] - PATH.rates[0])[1:-1], slope[1:-1], atol=1e-5)
    assert np.sqrt(np.mean(sizes)) == pytest.approx(0.2, rel=0.1)
    assert np.mean(overlap) / np.mean(sizes) == pytest.approx(np.exp(-0.5), abs=0.1)


def test_yaw_error_turns_about_the_vertical_half_constant_half_slow():
    errors = [_yaw_error(ul.navigate(PATH[::20], yaw_deg=3.0, seed=seed)) for seed in range(60)]
    yaw = np.degrees(np.array([e[:, 2] for e in errors]))
    assert np.abs(np.array(errors)[:, :, :2]).max() < 1e-9
    assert np.sqrt((yaw**2).mean()) == pytest.approx(3.0, rel=0.2)
    assert yaw.mean(1).std() == pytest.approx(3.0 / np.sqrt(2), rel=0.3)
    assert np.mean(yaw.std(1)) == pytest.approx(3.0 / np.sqrt(2), rel=0.3)


def test_the_seed_decides_and_cutting_changes_no_bit():
    asked = {"noise_m": 0.01, "drift_m": 0.1, "yaw_deg": 2.0}
    whole = ul.navigate(PATH, seed=9, **asked)
    part = ul.navigate(PATH[1000:1400], seed=9, **asked)
    assert np.array_equal(whole.position[1000:1400], part.position)
    assert np.array_equal(whole.quat_xyzw[1000:1400], part.quat_xyzw)
    assert not np.allclose(ul.navigate(PATH, seed=10, **asked).position, whole.position, atol=1e-3)


@pytest.mark.parametrize("name", ["noise_m", "drift_m", "yaw_deg", "drift_time_s"])
@pytest.mark.parametrize("value", [-1.0, np.nan, np.inf])
def test_bad_sizes_are_refused(name, value):
    with pytest.raises(ul.InputError, match=name):
        ul.navigate(PATH, **{name: value})
