"""Borders of shadow on a wall: the double knife edge, against Kirchhoff's integral over screen and wall in numbers."""

from __future__ import annotations

import numpy as np
import pytest
from radar_worlds import BLACK, sheet
from scipy.special import fresnel

import ullage as ul
from ullage.radar.physical import echoes
from ullage.world.library import WORLDS

RADAR = ul.RadarSpec.preset("x4m05", noise=None, antenna={"kind": "isotropic"})
HERE = ul.Trajectory.stationary((0, 0, 0))
WALL_M = 4.0


WALL = sheet((WALL_M, -6, -6), (0, 12, 0), (0, 0, 12), "wall")


def screen(edge_m, away_m=2.0, turn_deg=0.0):
    """Black, below a straight edge that lies so far above the line to the wall, turned about that line."""
    turn = np.radians(turn_deg)
    along, up = np.array([0, np.cos(turn), np.sin(turn)]), np.array([0, -np.sin(turn), np.cos(turn)])
    return sheet(np.array([away_m, 0, 0]) - 5 * along + (edge_m - 5) * up, 10 * along, 5 * up, "screen", BLACK)


def wall_behind(*before):
    """The wall's echo at its peak over that of the wall alone."""
    bare = echoes(WALL, HERE, RADAR)[0]
    peak = abs(bare).argmax()
    return echoes(ul.Scene.union([WALL, *before]), HERE, RADAR)[0, peak] / bare[peak]


def reference(edges_m, away_m=2.0):
    """What is left of the wall: one way over each edge in turn, and back, summed over the wall.

    Each edge of a screen (m) is followed by what is dark below the first, lit from there to the second, and so on.
    """
    wave = RADAR.wavelength_m
    y = np.linspace(-3, 3, 60001)
    one_way = np.zeros(len(y), complex)
    for k, edge in enumerate(np.atleast_1d(edges_m)):
        v = (edge - y * away_m / WALL_M) * np.sqrt(2 / wave * (1 / away_m + 1 / (WALL_M - away_m)))
        sine, cosine = fresnel(v)
        one_way += (-1) ** k * (1 + 1j) / 2 * ((0.5 - cosine) - 1j * (0.5 - sine))
    weight = np.exp(-2j * np.pi / wave * y * y / WALL_M - (y / 1.6) ** 8)
    return complex((one_way**2 * weight).sum() / weight.sum())


def differs(edge_m, away_m=2.0, turn_deg=0.0):
    """By how much our wall differs from the reference [dB, deg], and what that is [dB]."""
    want = reference(edge_m, away_m)
    found = wall_behind(screen(edge_m, away_m, turn_deg)) / want
    return 20 * np.log10(abs(found)), np.degrees(np.angle(found)), 20 * np.log10(abs(want))


def test_the_reference_is_what_is_known():
    """One half at the border of a screen on the wall, one quarter next to the radar: there and back."""
    assert abs(reference(0.0, WALL_M - 1e-3)) == pytest.approx(0.5, abs=0.02)
    assert abs(reference(0.0, 1e-2)) == pytest.approx(0.25, abs=0.02)
    assert 20 * np.log10(abs(reference(-0.06))) == pytest.approx(-5.6, abs=0.15)
    assert 20 * np.log10(abs(reference(0.12))) == pytest.approx(-19.6, abs=0.15)


@pytest.mark.parametrize("away_m", [1.0, 2.0, 3.0])
@pytest.mark.parametrize("edge_m", [-0.4, -0.12, -0.06, 0.03, 0.06, 0.12, 0.2])
def test_a_wall_behind_a_screens_edge_is_that_of_the_double_knife_edge(edge_m, away_m):
    level, phase, want = differs(edge_m, away_m, turn_deg=10 * away_m)
    assert abs(level) < (1 if want > -20.5 else 3)
    assert abs(phase) < 10 or want < -20.5


@pytest.mark.slow
def test_nothing_jumps_as_a_border_sweeps_over_the_wall():
    """From one centimetre to the next the difference from the reference changes by less than 5 degrees."""
    apart = np.array([differs(edge)[:2] for edge in np.arange(-0.295, 0.13, 0.01)])
    assert abs(apart[:, 0]).max() < 1
    assert abs(np.diff(apart[:, 1])).max() < 5


def strip(low_m, high_m, turn_deg=0.0):
    """Black, between two heights, 2 m away, turned about the line to the wall."""
    turn = np.radians(turn_deg)
    along, up = np.array([0, np.cos(turn), np.sin(turn)]), np.array([0, -np.sin(turn), np.cos(turn)])
    corner = np.array([2.0, 0, 0]) - 3 * along + low_m * up
    return sheet(corner, 6 * along, (high_m - low_m) * up, f"strip {low_m}", BLACK)


@pytest.mark.parametrize("turn_deg", [0, 7, 33])
@pytest.mark.parametrize("width_m", [0.002, 0.01, 0.05, 0.2, 0.4])
def test_a_rod_before_a_wall_leaves_what_kirchhoff_leaves(width_m, turn_deg):
    """Two borders close together: each of the two hides some of what the other has hidden."""
    half = width_m / 2
    want = reference([-9.0, -half, half])
    assert abs(wall_behind(strip(-half, half, turn_deg)) - want) < 0.03


@pytest.mark.parametrize("turn_deg", [0, 7, 33])
@pytest.mark.parametrize("width_m", [0.05, 0.2, 0.4, 0.8])
def test_a_wall_behind_a_slit_is_that_of_kirchhoff(width_m, turn_deg):
    half, slit = width_m / 2, (strip(-3, -width_m / 2, turn_deg), strip(width_m / 2, 3, turn_deg))
    assert abs(wall_behind(*slit) - reference([-half, half])) < 0.03


def test_an_antenna_almost_in_the_plane_of_a_plate_has_an_echo():
    """As on an aircraft that lands: from there some silhouettes lie behind the plate that they would shade."""
    heights_m = 0.25 + np.linspace(-1e-3, 1e-3, 9)  # of the ballast tank's floor, between its stiffeners
    for seat in ((-6.4097, -0.0145), (-6.28, 0.05), (-6.35, 0.07)):
        path = ul.Trajectory(np.arange(9), [(*seat, height) for height in heights_m], np.tile([0, 0, 0, 1.0], (9, 1)))
        assert np.isfinite(echoes(WORLDS["ballast-tank"].scene(), path, RADAR)).all()
