"""Borders of shadow across the Fresnel zone of a double bounce, against the same wave where the shadow is cut away."""

from dataclasses import replace

import numpy as np
import pytest

import ullage as ul
from ullage.radar import zones
from ullage.radar.physical import echoes
from ullage.world import scenes
from ullage.world.materials import Material

RADAR = ul.RadarSpec.preset("x4m05", noise=None, antenna={"kind": "isotropic"})
HERE = ul.Trajectory.stationary((0, 0, 0))
BLACK = Material(name="black", a=1.0)
"""Opaque, and reflects nothing."""


def sheet(corner, u, v, name, material=None):
    corner, u, v = (np.array(x, float) for x in (corner, u, v))
    flat = replace(
        scenes.plate(1, 1, 1, name=name), vertices=np.array([corner, corner + u, corner + u + v, corner + v])
    )
    return (
        flat if material is None else replace(flat, objects=tuple(replace(o, material=material) for o in flat.objects))
    )


def fold(height, screen_above=None):
    """A floor that meets a wall 5 m ahead and 1 m below; a black screen close before the wall leaves its foot free."""
    parts = [sheet((1, -3, -1), (4, 0, 0), (0, 6, 0), "floor"), sheet((5, -3, -1), (0, 6, 0), (0, 0, height), "wall")]
    if screen_above is not None:
        parts.append(sheet((4.97, -3, -1 + screen_above), (0, 6, 0), (0, 0, 2.5), "screen", BLACK))
    return ul.Scene.union(parts)


@pytest.mark.filterwarnings("ignore:invalid value")
def double(scene):
    """The echoes of two bounces alone."""
    return (echoes(scene, HERE, RADAR, max_bounces=2) - echoes(scene, HERE, RADAR, max_bounces=1))[0]


@pytest.fixture(scope="module")
def whole():
    return double(fold(2.0))


@pytest.mark.filterwarnings("ignore:invalid value")
@pytest.mark.parametrize("height", [0.03, 0.06, 0.1, 0.15, 0.2, 0.6])
def test_a_fold_of_which_only_the_foot_is_seen_echoes_as_one_with_a_low_wall(whole, height):
    """Amplitude and phase; by one point it would count in full, off by up to the whole echo."""
    peak = abs(whole).argmax()
    low, shaded = double(fold(height))[peak] / whole[peak], double(fold(2.0, height + 0.006))[peak] / whole[peak]
    assert abs(shaded - low) < 0.25
    if height < 0.15:
        assert abs(np.angle(low)) > 0.6  # a strip at the foot lags by an eighth of a turn
        assert abs(shaded) == pytest.approx(abs(low), abs=0.12)


def test_in_the_open_nothing_changes(monkeypatch):
    room = ul.scenes.room((6, 4, 3), material="concrete")
    path = ul.Trajectory.line((0.1, 0.2, 0.1), (0.5, 0.3, 0.2), 0.5, 4)
    ours = echoes(room, path, RADAR, max_bounces=3)
    monkeypatch.setattr(zones, "BEST", 0)
    assert ours == pytest.approx(echoes(room, path, RADAR, max_bounces=3), abs=1e-12)


def test_the_outline_lies_where_its_edges_are():
    square = np.array([[1, 1], [-1, 1], [-1, -1], [1, -1]], float)
    corners = np.array([[x + 0.25, y, 0] for x, y in square])
    edges = np.stack([corners, np.roll(corners, -1, 0)], 1)[None]
    angle = np.linspace(0, 2 * np.pi, 8, endpoint=False)
    away = zones._outline(np.zeros((1, 3)), np.eye(3)[None, :2], edges, np.stack([np.cos(angle), np.sin(angle)], 1))
    half = 2**0.5
    assert away[0] == pytest.approx([1.25, half, 1, 0.75 * half, 0.75, 0.75 * half, 1, half])


def test_a_zone_all_free_adds_up_to_the_closed_form():
    """Over the whole plane the fading weight integrates to its end less its start, the same along each ray."""
    far = 100 * np.array([[[1, 1, 0], [-1, 1, 0]], [[-1, 1, 0], [-1, -1, 0]], [[-1, -1, 0], [1, -1, 0]],
                          [[1, -1, 0], [1, 1, 0]]], float)  # fmt: skip
    middle, axes = np.zeros((1, 3)), np.eye(3)[None, :2]
    zone = zones.Zone(middle, axes, np.minimum(zones._outline(middle, axes, far[None], zones._TURN) ** 2, zones.LAST))
    phase = np.linspace(0, zones.LAST, 20001)
    dense = np.trapezoid(np.exp(-1j * phase) * (1 - phase / zones.LAST), phase)
    assert zone.weights.sum() / zones.RAYS == pytest.approx(dense, abs=1e-6)
    assert np.linalg.norm(zone.points, axis=-1).max() ** 2 < zones.LAST
