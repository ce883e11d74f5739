"""Laws that a rig's frames obey by either fidelity: where radars look, when frames are taken, what their noise is."""

import numpy as np
import pytest
from scipy.stats import kurtosis

import ullage as ul


def quiet_rig() -> ul.Rig:
    spec = ul.RadarSpec.preset("x4m05", noise=None)
    return ul.Rig.preset("thesis-4", radar=spec.but(thesis=spec.thesis.but(noise_sigma=0.0)))


def plate(distance_m: float = 3.0) -> ul.Scene:
    return ul.scenes.plate(width_m=0.6, height_m=0.6, distance_m=distance_m)


def peak(name: str, azimuth_deg: float, fidelity: str) -> float:
    """The strongest echo of a plate that stands in a direction from the body."""
    body = ul.Trajectory.stationary(yaw_deg=-azimuth_deg)
    return float(np.abs(ul.simulate(plate(), body, quiet_rig(), fidelity=fidelity, seed=1)[name].samples).max())


@pytest.mark.parametrize("fidelity", ["physical", "thesis"])
@pytest.mark.parametrize(("name", "boresight_deg"), [("front", 0), ("left", 90), ("back", 180), ("right", 270)])
def test_each_radar_of_the_rig_hears_both_sides_of_its_boresight_alike(name, boresight_deg, fidelity):
    left, right = (peak(name, boresight_deg + side, fidelity) for side in (25, -25))
    assert left > 0
    assert 20 * abs(np.log10(left / right)) < 0.3  # a mount turned by 5 deg makes over 1 dB of it


@pytest.mark.parametrize("fidelity", ["physical", "thesis"])
def test_a_frame_is_taken_at_its_own_pose(fidelity):
    path = ul.Trajectory.line((0, 0, 0), (1.5, 0, 0), speed_m_s=1.0, rate_hz=10)  # 0.1 m a frame towards the plate
    front = ul.simulate(plate(5.0), path, quiet_rig(), fidelity=fidelity, seed=1)["front"]
    strongest = front.range_m[np.abs(front.samples).argmax(1)]
    off = strongest - (5.0 - front.believed.position[:, 0])
    assert np.abs(off - np.median(off)).max() < 0.06  # one bin; a frame late is 0.1 m
    assert abs(np.median(off)) < 0.05


@pytest.mark.parametrize("fidelity", ["physical", "thesis"])
def test_noise_is_gaussian_and_new_in_every_frame_and_radar(fidelity):
    spec = ul.RadarSpec.preset("x4m05", noise={"leakage": False})  # a moving average would make any noise Gaussian
    rig = ul.Rig.preset("thesis-4", radar=spec.but(thesis=spec.thesis.but(smoothing_bins=1)))
    path = ul.Trajectory.stationary(n=60)
    found = ul.simulate(plate(500.0), path, rig, fidelity=fidelity, seed=3)
    raw = {name: _real(part.samples) for name, part in found.items()}
    for values in raw.values():
        assert np.std(values) > 0
        once = values[1:] - values[:-1]  # takes away what stays the same in every frame
        assert np.std(once) == pytest.approx(np.sqrt(2) * np.std(values - values.mean(0)), rel=0.05)
        assert abs(kurtosis(once, axis=None)) < 0.25  # 0 of a Gaussian; -0.6 of differences of uniform noise
    assert abs(np.corrcoef(raw["front"].ravel(), raw["left"].ravel())[0, 1]) < 0.05


def _real(samples: np.ndarray) -> np.ndarray:
    samples = np.asarray(samples)
    return samples.real.astype(float) if np.iscomplexobj(samples) else samples.astype(float)
