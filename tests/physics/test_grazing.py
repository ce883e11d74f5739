"""Faces by their rims against Kirchhoff's integral over their area, for antennas almost in the faces' planes."""

import numpy as np
import pytest

import ullage as ul
from ullage.geometry import C0
from ullage.kernels import outlines as kernel
from ullage.kernels.edges import CutLimits, FaceOutlines
from ullage.kernels.facets import LitFaces, Transmission
from ullage.radar import planar
from ullage.radar.context import AntennaPair, antenna_pair, radar_context, radar_frame

RADAR = ul.RadarSpec.preset("x4m05", antenna={"kind": "isotropic"}, noise=None).but(
    bins=2000, range_start_m=0.0, prf_div=255
)
WAVE = 2 * np.pi * RADAR.center_hz / C0
READY = radar_context(ul.scenes.plate(width_m=1, height_m=1, distance_m=3, material="pec"), RADAR, edges=False)


def by_rim(size, one, other):
    """Path gain of a rectangle (2) in the plane z = 0 from one place (3) to another, of a conductor."""
    corners = np.array([[-1, -1, 0], [1, -1, 0], [1, 1, 0], [-1, 1, 0]]) * np.array([*size, 0]) / 2
    normal, offset, first, limit = np.array([[0, 0, 1.0]]), np.zeros(1), np.array([0, 4], np.int32), np.array([50.0])
    sphere, pair = np.array([[0, 0, 0, np.hypot(*size) / 2]]), np.stack([one, other])[None]
    face, still = np.array([0]), antenna_pair(RADAR, one, np.eye(3))
    faces = FaceOutlines(sphere, normal, offset, first, corners, np.roll(corners, -1, 0))
    rim = planar.cut_outlines(face, faces, pair, still.aside, CutLimits(limit, 1e9, READY.pulse.omega, False))
    points = np.empty((1, 9))
    count = kernel.crossings(face, rim.windings, normal, offset, pair, limit, points)
    frame = radar_frame(READY, AntennaPair(pair[0], still.frames, still.fields))
    lit = LitFaces(normal, np.zeros(1, np.int32), frame.radar, READY.reflection)
    many = len(rim.owner) + len(rim.holders) + count
    between = Transmission(np.ones(many, complex), np.zeros(many))
    planar.accumulate_outline(frame, rim, points[:count], face[:count], between, lit)
    return frame.grids.sum()


def by_area(size, one, other, step=0.0025):
    """The same by the sum over points of Kirchhoff's integrand [BornWolf1999]."""
    count = np.ceil(np.array(size) / step).astype(int)
    x, y = (s * ((np.arange(n) + 0.5) / n - 0.5) for s, n in zip(size, count, strict=True))
    spots = np.stack(np.meshgrid(x, y, [0.0], indexing="ij"), -1)
    r, s = np.linalg.norm(spots - one, axis=-1), np.linalg.norm(spots - other, axis=-1)
    slopes = one[2] / r * (1j * WAVE + 1 / r) + other[2] / s * (1j * WAVE + 1 / s)
    return -(slopes * np.exp(-1j * WAVE * (r + s)) / (r * s)).sum() * np.prod(size) / count.prod() / (8 * np.pi * WAVE)


def worst_db(cases):
    """Largest difference of both, over the wave that a mirror would return there [dB]."""
    worst = 0.0
    for size, one, other in cases:
        mirror = 1 / (2 * WAVE * np.linalg.norm(one * [1, 1, -1] - other))
        worst = max(worst, abs(by_rim(size, one, other) - by_area(size, one, other)) / mirror)
    return 20 * np.log10(worst)


def beside(rng, size, gap):
    """A random place at a height over the plane, not close to the face."""
    while True:
        place = np.array([*rng.uniform(-1, 1, 2), gap])
        if gap > 0.06 or (abs(place[:2]) > np.array(size) / 2 + 0.06).any():
            return place


@pytest.mark.parametrize("both", [False, True])
def test_one_antenna_or_both_almost_in_the_plane(both):
    rng = np.random.default_rng(11)
    cases = []
    for gap in 10.0 ** np.arange(-9, 0):
        for _ in range(6):
            size = rng.uniform(0.15, 0.5, 2)
            other = gap * 10 ** rng.uniform(-1, 1) if both else rng.uniform(0.06, 1)
            cases.append((size, beside(rng, size, gap), beside(rng, size, other)))
    assert worst_db(cases) < -35


@pytest.mark.parametrize("aside", [0.0, 1e-6, 1e-4, 1e-3, -1e-3, 1e-2])
def test_a_path_that_runs_along_an_edge(aside):
    """The edge turns about the axis within a hair's breadth, while its path changes far more slowly."""
    size, edge = np.array([0.25, 0.43]), 0.125 + aside
    cases = [(size, np.array([edge, -0.33, low]), np.array([edge, 0.47, high]))
             for low, high in ((0.047, 0.17), (0.2, 0.3), (0.02, 0.02), (0.003, 0.1))]  # fmt: skip
    assert worst_db(cases) < -35


def test_over_the_face_a_mirror_stands_at_any_height():
    size = np.array([0.4, 0.4])
    gaps = 10.0 ** np.arange(-8, 0)
    far = np.array([0.6, 0.1, 0.5])
    level = [abs(by_rim(size, np.array([0.0, 0.0, gap]), far)) for gap in gaps]
    assert 20 * np.log10(max(level[:5]) / min(level[:5])) < 0.1
