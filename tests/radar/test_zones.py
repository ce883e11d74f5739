"""Borders of shadow across the Fresnel zone of a double bounce, against the same wave where the shadow is cut away."""

import numpy as np
import pytest
from radar_worlds import BLACK, sheet
from scipy.special import fresnel

import ullage as ul
from ullage.kernels import zones as kernel
from ullage.radar import zones
from ullage.radar.physical import echoes
from ullage.world import scenes

RADAR = ul.RadarSpec.preset("x4m05", noise=None, antenna={"kind": "isotropic"})
HERE = ul.Trajectory.stationary((0, 0, 0))


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


@pytest.mark.filterwarnings("ignore:invalid value")
def test_a_zone_that_a_border_crosses_comes_before_stronger_ones_in_the_open(monkeypatch, whole):
    """Two paths are judged by their zones: that to the fold behind its screen, not both to the bracket before it."""
    shaded, bracket = fold(2.0, 0.1), scenes.dihedral(0.4, 3.0)
    peak = abs(whole).argmax()
    both, alone, free = (double(s)[peak] for s in (ul.Scene.union([shaded, bracket]), shaded, bracket))
    assert abs(free) < 0.01 * abs(alone)
    monkeypatch.setattr(zones, "BEST", 2)
    assert abs(double(bracket)).max() > 1.2 * abs(whole).max()
    assert double(ul.Scene.union([shaded, bracket]))[peak] == pytest.approx(both, abs=0.1 * float(abs(alone)))


def directions(rays):
    """Unit vectors (rays, 2) evenly around."""
    angles = 2 * np.pi * (np.arange(rays) + 0.5) / rays
    return np.stack([np.cos(angles), np.sin(angles)], 1)


def drawn(corners, turn, last):
    """Phases (rays) at which rays from the origin leave a polygon (n, 3)."""
    edges = np.ascontiguousarray(np.stack([corners, np.roll(corners, -1, 0)], 1))
    out = np.empty((1, len(turn)))
    kernel.outline(np.zeros((1, 3)), np.eye(3)[None, :2].copy(), np.zeros(1, np.int64),
                   np.array([0, len(corners)], np.int32), edges, turn, last, out)  # fmt: skip
    return out


SQUARE = np.array([[1, 1, 0], [-1, 1, 0], [-1, -1, 0], [1, -1, 0]], float)


def test_the_outline_lies_where_its_edges_are():
    angle = np.linspace(0, 2 * np.pi, 8, endpoint=False)
    turn = np.stack([np.cos(angle), np.sin(angle)], 1)
    away = np.sqrt(drawn(SQUARE + np.array([0.25, 0, 0]), turn, 99.0))
    half = 2**0.5
    assert away[0] == pytest.approx([1.25, half, 1, 0.75 * half, 0.75, 0.75 * half, 1, half])


def test_a_zone_all_free_adds_up_to_the_closed_form():
    """Over the whole plane the fading weight integrates to its end less its start, the same along each ray."""
    ends, out = drawn(100 * SQUARE, directions(zones.RAYS), zones.LAST), np.empty(1, complex)
    assert (ends == zones.LAST).all()
    kernel.whole(ends, zones.LAST, out)
    phase = np.linspace(0, zones.LAST, 20001)
    dense = np.trapezoid(np.exp(-1j * phase) * (1 - phase / zones.LAST), phase)
    assert out[0] / zones.RAYS == pytest.approx(dense, abs=1e-6)


@pytest.mark.parametrize("v", [-1.4, -0.5, 0.02, 0.3, 0.8, 1.4])
def test_behind_a_straight_border_is_what_fresnels_integral_gives(v):
    """A half plane free beyond v root(pi / 2) of a phase of 1 rad from the mirror point [BornWolf1999]."""
    edge = v * np.sqrt(np.pi / 2)
    rays, cells, last = zones.RAYS, zones.CELLS, zones.LAST
    turn, ends = directions(rays * zones.FINE), np.full((1, rays * zones.FINE), last)
    border = np.where(turn[:: zones.FINE, 0] * edge > 0, (edge / turn[:: zones.FINE, 0]) ** 2, np.inf)
    borders = np.broadcast_to(last * np.arange(cells) / cells, (1, rays, cells)).copy()
    within = last * (np.arange(cells) + 0.5) / cells
    free = np.where((turn[:: zones.FINE, :1] > 0) == (edge > 0), (within > border[:, None]) == (edge > 0), edge < 0)
    free = np.ascontiguousarray(free[None])
    for r, c in np.argwhere(free[0, :, 1:] != free[0, :, :-1]):
        borders[0, r, c + 1] = border[r]
    out = np.empty(1, complex)
    kernel.parts(free, borders, ends, last, np.empty((rays, cells)), np.empty(rays, np.int64), out)
    sine, cosine = fresnel(v)
    want = (1 + 1j) / 2 * ((0.5 - cosine) - 1j * (0.5 - sine))
    assert out[0] == pytest.approx(want, abs=0.09)
