"""Checks of the method of moments itself: against Mie's series, a grid solver, and the laws that every echo obeys."""

import sys
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from studies.validation.oracles import mie_width
from ullage.geometry import C0

sys.path.insert(0, str(Path(__file__).parent))
import moments
from full_wave import db, golden

F_HZ = 7.29e9
WAVE_M = C0 / F_HZ
UP = [[0.0, 0.0, 1.0]]
DIPOLE_DB = 10 * np.log10(1.5**2)  # both ends


@pytest.fixture(scope="module")
def plate():
    return moments.Moments(moments.plate(2 * WAVE_M, WAVE_M / 6), F_HZ)


@pytest.mark.parametrize(("ka", "level", "bound"), [(1.0, 3, 0.1), (3.0, 4, 0.4)])
def test_sphere(ka, level, bound):
    radius, far = ka * WAVE_M / (2 * np.pi), 100.0
    body = moments.Moments(moments.ball(radius, level), F_HZ)
    width = mie_width(radius, F_HZ)
    truth = WAVE_M * np.sqrt(width) / (4 * np.pi) ** 1.5 / far**2
    echo = body.path_gain([[far, 0, 0], [0.6 * far, 0.8 * far, 0]], UP * 2)
    assert abs(db(echo) - db(truth)).max() < bound


def test_plate_facing_is_near_physical_optics(plate):
    """The rims add 0.4 dB at two wavelengths, as they do on the grid of `test_fullwave.py`."""
    far, k = 1.0, 2 * np.pi / WAVE_M
    side = ((np.arange(200) + 0.5) / 200 - 0.5) * 2 * WAVE_M
    r = np.sqrt(far**2 + side[:, None] ** 2 + side**2)
    optics = -1j / (4 * np.pi) * np.sum(far / r**3 * np.exp(-2j * k * r)) * (WAVE_M / 100) ** 2
    echo = plate.path_gain([[far, 0, 0]], UP)[0]
    assert abs(db(echo / optics)) < 0.5
    assert abs(np.angle(echo / optics, deg=True)) < 5


def test_places_may_change(plate):
    one, two = [0.5, 0.3, 0.2], [0.6, -0.4, 0.1]
    field, other = np.array([0.6, 0.0, 0.8]), np.array([0.0, 0.8, -0.6])
    there, back = plate.bistatic(one, field, two, other), plate.bistatic(two, other, one, field)
    assert abs(there - back) < 1e-3 * abs(there)  # the matrix is symmetric but for its quadrature


def test_turning_body_and_dipole_changes_nothing():
    plate = moments.Moments(moments.plate(WAVE_M, WAVE_M / 6), F_HZ)
    turn = Rotation.random(random_state=4).as_matrix()
    place, field = np.array([[0.7, 0.4, 0.5]]), np.array([[0.0, 0.8, -0.64]]) / np.hypot(0.8, 0.64)
    turned = moments.Moments(plate.corners @ turn.T, F_HZ)
    assert turned.path_gain(place @ turn.T, field @ turn.T) == pytest.approx(plate.path_gain(place, field), rel=1e-9)


def test_finer_triangles_change_little(plate):
    finer = moments.Moments(moments.plate(2 * WAVE_M, WAVE_M / 8), F_HZ)
    angle = np.radians([0, 20, 40, 60])
    place = np.stack([np.cos(angle), 0.9 * np.sin(angle), 0.4 * np.sin(angle)], 1)
    echo, fine = (body.path_gain(place, UP * 4) for body in (plate, finer))
    assert abs(echo - fine).max() < 0.01 * abs(fine).max()
    assert abs(db(echo) - db(fine)).max() < 0.5


@pytest.mark.slow
@pytest.mark.parametrize("pol", ["soft", "hard"])
def test_plate_on_a_grid(pol):
    """Two full-wave solvers, 125 mm at 0.3 m: the grid's own error is about half a decibel."""
    g = golden("plate")
    body = moments.Moments(moments.plate(float(g["edge_m"]), WAVE_M / 8), F_HZ)
    held = np.flatnonzero((g["pol"] == pol) & (g["tilt_deg"] < 40))
    t = np.radians(g["tilt_deg"][held])
    place = g["distance_m"][held][:, None] * np.stack([np.cos(t), np.sin(t), 0 * t], 1)
    across = np.stack([-np.sin(t), np.cos(t), 0 * t], 1) if pol == "hard" else UP * len(t)
    echo = body.path_gain(place, across)
    (middle,) = np.flatnonzero(abs(g["frequency_hz"] - F_HZ) < 1e6)
    assert abs(db(echo) + DIPOLE_DB - db(g["path_gain"][held, middle])).max() < 0.5
