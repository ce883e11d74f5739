"""A flat plate against published near-field values and a dense integral of the same law."""

import numpy as np
import pytest

import ullage as ul
from studies.validation import oracles
from ullage.radar.physical import path_gain_cw

ISO = ul.RadarSpec.preset("x4m05", antenna={"kind": "isotropic"}, noise=None)
HERE = ul.Trajectory.stationary()


def db(value):
    return 20 * np.log10(abs(value))


def dense(size_m, yaw_deg=0.0):
    return oracles.dense_plate(size_m, 3.0, ISO.center_hz, yaw_deg)


@pytest.mark.parametrize(
    ("size", "published"), [(0.10, -81.1), (0.25, -65.7), (0.5, -61.4), (1.0, -67.0), (2.0, -66.7)]
)
def test_plate_facing(size, published):
    ours = path_gain_cw(ul.scenes.plate(size, size, 3.0), HERE, ISO, edges=False)[0]
    truth = dense(size)
    assert db(truth) == pytest.approx(published, abs=0.06)
    assert db(ours) == pytest.approx(db(truth), abs=0.15)
    assert abs(np.angle(ours / truth, deg=True)) < 2


@pytest.mark.parametrize(("tilt", "published"), [(2, -63.5), (5, -70.1), (10, -80.4), (20, -87.5), (45, -101)])
def test_plate_tilted(tilt, published):
    ours = path_gain_cw(ul.scenes.plate(0.5, 0.5, 3.0, yaw_deg=tilt), HERE, ISO, edges=False)[0]
    assert db(ours) == pytest.approx(db(dense(0.5, tilt)), abs=0.25)
    assert db(ours) == pytest.approx(published, abs=1.0)
