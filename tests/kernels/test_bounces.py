"""Laws of reflected paths: coefficients between the table's angles, mirrored fields, Fresnel zones, outlines."""

from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from ullage.kernels import bounces

seeds = st.integers(0, 2**31)


def unit(rng):
    vector = rng.normal(size=3)
    return vector / np.linalg.norm(vector)


def mirrors(normals, table):
    """Faces with these normals, of which face p has the coefficients of row p of the table (s, 1, 2, c)."""
    count = len(normals)
    return bounces.Mirrors(normals, np.zeros(count), np.arange(count), np.ones((count, 2)), table, 0.04)


def scratch():
    return bounces.ReflectScratch(np.empty((2, 3)), np.empty(3, complex))


def reflected(paths, chains, ends_on, normals, table, fields):
    """The factor of each path, with coefficients (s, 1, 2, c) of which face p has row p."""
    count, factor = len(paths), np.ones(len(paths), complex)
    frames = np.stack([np.eye(3), np.eye(3)])
    bounces.reflect(
        paths, chains, ends_on, mirrors(normals, table), bounces.Orientations(frames, fields), factor,
        bounces.Orientations(np.empty((count, 2, 3, 3)), np.empty((count, 2, 3))), scratch(),
    )  # fmt: skip
    return factor


def plain(path, faces, normals, coefficients, fields):
    """The same by vectors: across the plane of incidence TE, in it TM, then the wave's field mirrored."""
    steps = [np.diff(path, axis=0)[k] for k in range(4)]
    steps = [step / np.linalg.norm(step) for step in steps if np.linalg.norm(step) > 0]
    across = fields[0] - fields[0] @ steps[0] * steps[0]
    field = across / np.linalg.norm(across) + 0j
    for step, face in zip(steps, faces, strict=False):
        n = normals[face]
        te, tm = coefficients(face, abs(n @ step))
        s = np.cross(step, n) / np.linalg.norm(np.cross(step, n))
        field = te * (s @ field) * s + tm * (field - (s @ field) * s)
        field = field - 2 * (n @ field) * n
    taken = fields[1] - fields[1] @ steps[-1] * steps[-1]
    return field @ taken / np.linalg.norm(taken)


@given(seed=seeds, double=st.booleans())
def test_reflections_take_each_polarisation_by_its_coefficient(seed, double):
    """Coefficients that are straight over the cosine are met exactly, whatever the spacing of the table."""
    rng = np.random.default_rng(seed)
    path = np.cumsum(rng.normal(size=(5, 3)), axis=0)
    if not double:
        path[1] = path[0]
    normals, fields = np.stack([unit(rng) for _ in range(3)]), np.stack([unit(rng), unit(rng)])
    at_zero, slope = rng.normal(size=(2, 3, 2)) + 1j * rng.normal(size=(2, 3, 2))
    table = (at_zero[..., None] + slope[..., None] * np.linspace(0, 1, rng.integers(2, 9)))[:, None]
    chains = np.array([[0, 1 if double else -1]])
    got = reflected(path[None], chains, np.array([2]), normals, table, fields)
    faces = [0, 1, 2] if double else [0, 2]
    want = plain(path, faces, normals, lambda face, cosine: at_zero[face] + slope[face] * cosine, fields)
    assert got[0] == pytest.approx(want, rel=1e-9, abs=1e-12)


def test_between_two_angles_a_coefficient_is_the_straight_line_between_them():
    """Also where the table bends: its own values at its own angles, their mean half-way."""
    table, c = np.zeros((1, 1, 2, 5), complex), np.array([0.1, 0.9, 0.2, 0.7, 0.3])
    table[:] = c
    fields = np.array([[0, 1.0, 0], [0, 1.0, 0]])
    for cosine, want in [(0.25, 0.9), (0.5, 0.2), (0.75, 0.7), (0.375, 0.55), (0.625, 0.45), (0.95, 0.3 + 0.2 * 0.4)]:
        n, tail = np.array([[0, 0, 1.0]]), np.array([np.sqrt(1 - cosine**2), 0, cosine])
        down = np.array([tail[0], 0, -cosine])
        path = np.array([[0, 0, 0], [0, 0, 0], down, down + tail, down + tail + down])[None]
        got = reflected(path, np.array([[0, -1]]), np.array([0]), n, table, fields)
        assert got[0] == pytest.approx(want**2, rel=1e-9)


@given(seed=seeds)
def test_a_mirror_larger_than_the_zone_reflects_all_and_a_small_one_its_area(seed):
    """The zone is sqrt(lambda d1 d2 / (d1 + d2)) across, over the cosine along the plane of incidence."""
    rng = np.random.default_rng(seed)
    path = np.cumsum(rng.normal(size=(5, 3)), axis=0)
    path[1] = path[0]
    n, wavelength = unit(rng)[None], float(rng.uniform(0.01, 0.1))
    d1, d2 = np.linalg.norm(path[2] - path[0]), np.linalg.norm(path[3] - path[2])
    zone = np.sqrt(wavelength * d1 * d2 / (d1 + d2))
    root = np.sqrt(abs(n[0] @ (path[3] - path[2])) / d2)

    def covered(widths):
        out = np.ones(1)
        bounces.cover(path[None], np.array([[0, -1]]), n, np.array([widths], float), wavelength, np.empty(3), out)
        return out[0]

    small, large = rng.uniform(0.05, 0.9, 2) * zone / root, 1.01 * zone / root
    assert covered((large, large)) == 1
    assert covered((small[0], large)) == pytest.approx(small[0] * root / zone)
    assert covered(small) == pytest.approx(small.prod() * root**2 / zone**2)


@given(seed=seeds)
def test_the_path_over_images_is_the_straight_line_unfolded(seed):
    """Image method between two walls: the corners lie on them, and the path is as long as that from the image."""
    rng = np.random.default_rng(seed)
    origins = rng.uniform(0.2, 2.0, (2, 3))
    normals, offsets = np.array([[1.0, 0, 0], [-1.0, 0, 0]]), np.array([0.0, -3.0])  # at x = 0 and at x = 3
    lit = rng.uniform(0.2, 2.0, 3)
    first = origins[0] * [-1, 1, 1]
    last = [6, 0, 0] + first * [-1, 1, 1]
    images = [first, last, last * [-1, 1, 1]]  # over the wall at 0, then that at 3, then that at 0 again
    chains = np.array([[0, 1, 0], [0, 1, -1], [0, -1, -1]])
    out = np.empty((3, 6, 3))
    bounces.legs(bounces.ImagePaths(np.stack([images] * 3), chains), normals, offsets, origins, np.arange(3),
                 np.stack([lit] * 3), out)  # fmt: skip
    assert out[:, [0, 4, 5]] == pytest.approx(np.stack([np.stack([origins[0], lit, origins[1]])] * 3))
    assert out[0, 1:4, 0] == pytest.approx([0, 3, 0])
    assert out[1, 2:4, 0] == pytest.approx([0, 3])
    assert out[2, 3, 0] == pytest.approx(0)
    for path, image, empty in zip(out, images[::-1], range(3), strict=True):
        assert path[1 : 1 + empty] == pytest.approx(np.stack([origins[0]] * empty) if empty else np.zeros((0, 3)))
        length = np.linalg.norm(np.diff(path[:5], axis=0), axis=1).sum()
        assert length == pytest.approx(np.linalg.norm(lit - image))


@given(seed=seeds)
def test_the_middle_of_an_outline_is_that_of_its_length(seed):
    rng = np.random.default_rng(seed)
    first = np.r_[0, np.cumsum(rng.integers(3, 7, 4))]
    edges, out = rng.normal(size=(first[-1], 2, 3)), np.empty((4, 3))
    bounces.middles(first, edges, out)
    size = np.linalg.norm(edges[:, 1] - edges[:, 0], axis=1)
    want = [np.average(edges[a:b].mean(1), axis=0, weights=size[a:b]) for a, b in pairwise(first)]
    assert out == pytest.approx(np.array(want))


def test_a_corner_that_clipping_leaves_twice_does_not_move_the_middle():
    corners = np.array([[0, 0, 0], [2, 0, 0], [2, 1, 0], [0, 1, 0]], float)
    twice = corners[[0, 1, 1, 1, 2, 3]]
    out = np.empty((2, 3))
    edges = np.concatenate([np.stack([part, np.roll(part, -1, 0)], 1) for part in (corners, twice)])
    bounces.middles(np.array([0, 4, 10]), edges, out)
    assert out[1] == pytest.approx(out[0])
    assert out[0] == pytest.approx([1, 0.5, 0])
