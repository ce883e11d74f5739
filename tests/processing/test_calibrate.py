from pathlib import Path

import numpy as np
import pytest
from ideal_points import frames_of_points

import ullage as ul
from ullage.geometry import rpy_quat

RAIL = Path(__file__).parents[3] / "shared/data/pulson440/rail_a"
SPEC = ul.RadarSpec.preset("x4m05", antenna={"kind": "isotropic"}, noise=None)


def uneven_track(n=3000, rate_hz=200.0):
    """Standing, an uneven run along y, standing again."""
    t = np.arange(n) / rate_hz
    speed = np.where((t > 4) & (t < 11), 0.2 + 0.1 * np.sin(1.7 * t), 0.0)
    y = np.cumsum(speed) / rate_hz
    position = np.stack([0.01 * np.sin(y * 3), y, np.full(n, 1.0)], axis=1)
    return ul.Trajectory(np.rint(t * 1e9).astype(np.int64), position, np.tile(rpy_quat(0, 0, 0), (n, 1)))


def test_planted_offsets_are_found_without_knowing_the_targets():
    track = uneven_track()
    when = np.rint((2.5 + np.arange(190) / 20.0) * 1e9).astype(np.int64)
    clean = frames_of_points([(2.5, 0.6, 1.0), (3.4, 1.3, 1.0), (1.8, 1.5, 1.0)], track.at(when), spec=SPEC, noise=0.05)
    raw = ul.Frames(clean.samples, clean.range_m + 0.3, when - when[0], SPEC, track=track)
    found = ul.calibrate(raw)
    record = found.calibration
    assert record is not None
    assert record.t_offset_s == pytest.approx(2.5, abs=0.02)
    assert record.range_offset_m == pytest.approx(-0.3, abs=0.04)
    assert 0 < record.t_sigma_s < 0.1
    assert 0 < record.range_sigma_m < 0.1
    assert record.gain_db > 0
    assert np.array_equal(found.believed.t_ns, found.t_ns)
    image = ul.focus(found, ul.Grid((2.2, 0.3, 1.0), 0.02, (30, 30)))
    assert np.linalg.norm(image.peak_m - (2.5, 0.6, 1.0)) < 0.05


def test_a_standing_sensor_cannot_be_calibrated():
    path = ul.Trajectory.stationary(n=20)
    frames = frames_of_points([(2.0, 0, 0)], path, spec=SPEC)
    with pytest.raises(ul.InputError, match=r"the track spans 0.00 m"):
        ul.calibrate(frames)


@pytest.mark.slow
@pytest.mark.skipif(not RAIL.exists(), reason="the real rail recording is not here")
def test_the_real_rail_calibrates_itself():
    with pytest.warns(ul.UllageWarning):
        found = ul.calibrate(ul.open(str(RAIL)).frames())
    record, fitted = found.calibration, np.load(RAIL / "decoded.npz")
    assert record is not None
    assert record.t_offset_s == pytest.approx(float(fitted["t_offset_s"]), abs=0.06)
    assert abs(record.range_offset_m + float(fitted["range_offset_m"])) < 2.5 * record.range_sigma_m
    x, up, south = fitted["reflectors_m"][0]
    truth = np.array([x, -south, up])
    image = ul.focus(found, ul.Grid.covering([truth - 0.5, truth + 0.5], 0.01, z_m=float(truth[2])))
    assert abs(image.peak_m - truth)[1] < 0.03
    assert np.linalg.norm(image.peak_m - truth) < 0.09  # see docs/imaging.md: the range offset is known to 3 cm only
