"""A flat plate against published near-field values and a dense integral of the same law."""

import numpy as np
import pytest

import ullage as ul
from ullage.geometry import C0
from ullage.radar.physical import path_gain_cw

ISO = ul.RadarSpec.preset("x4m05", antenna={"kind": "isotropic"}, noise=None)
HERE = ul.Trajectory.stationary()


def db(value):
    return 20 * np.log10(abs(value))


def dense(size_m, yaw_deg=0.0, distance_m=3.0):
    """The near-field Kirchhoff integral of a conducting square at 7.29 GHz, sampled at 2 mm."""
    n = round(size_m / 0.002)
    side = (np.arange(n) + 0.5) / n * size_m - size_m / 2
    across, up = np.meshgrid(side, side)
    yaw = np.radians(yaw_deg)
    point = np.stack([distance_m - across * np.sin(yaw), across * np.cos(yaw), up], -1)
    r = np.linalg.norm(point, axis=-1)
    cosine = abs(point @ [np.cos(yaw), np.sin(yaw), 0]) / r
    k = 2 * np.pi * ISO.center_hz / C0
    return -1j / (4 * np.pi) * np.sum(cosine / r**2 * np.exp(-2j * k * r)) * (size_m / n) ** 2


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
