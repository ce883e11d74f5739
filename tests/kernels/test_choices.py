"""Loops that choose faces and lay impulses, against the same in a few lines of numpy."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from ullage.kernels import beams, impulses, outlines
from ullage.kernels.facets import PulseGrid

C0 = 299_792_458.0


@pytest.mark.parametrize("count", [1, 3, 32, 200])
def test_the_largest_are_those_above_the_next_one_and_fade_in(count):
    look = np.random.default_rng(count).random(100) ** 3
    look[[4, 9, 17]] = look.max(), look.max(), 0.0  # alike
    which, weights = np.empty(100, np.int64), np.empty(100)
    made = beams.largest(look, 0.1, np.empty(count + 1), which, weights)
    least = np.sort(look)[::-1][count] if count < 100 else 0.0
    assert list(which[:made]) == list(np.flatnonzero(look > least))
    expected = np.where(look > least, np.minimum((look / max(least, 1e-12) - 1) / 0.1, 1), 0)
    assert weights == pytest.approx(expected)


def test_backs_are_hidden_from_outside_and_only_from_there():
    rng = np.random.default_rng(1)
    normals, middles = rng.normal(size=(40, 3)), rng.normal(size=(40, 3))
    outward = np.concatenate([normals, -(normals * middles).sum(1)[:, None]], 1)
    axes, halves = Rotation.random(40, random_state=2).as_matrix(), rng.uniform(0.2, 1.0, (40, 3))
    origins, opaque, out = np.array([[0.2, 0.1, 0.0], [0.3, -0.4, 0.1]]), rng.random(40) > 0.2, np.empty(40, np.bool_)
    held = np.empty((40, 2), np.bool_)
    outlines.held_by(middles, axes, halves, origins, 1e-3, held)
    outlines.hidden(outward, np.arange(40, dtype=np.int32), held, origins, opaque, out)
    behind = [outward[:, :3] @ o + outward[:, 3] < 0 for o in origins]
    inside = [(abs(np.einsum("nki,ni->nk", axes, o - middles)) <= halves + 1e-3).all(1) for o in origins]
    expected = opaque & behind[0] & behind[1] & ~inside[0] & ~inside[1]
    assert list(out) == list(expected)
    assert any(expected)
    assert any(opaque & behind[0] & behind[1] & ~expected)


def test_faces_that_mirror_a_radar_beyond_the_gate_are_followed_farther():
    normals, offsets = np.tile([1.0, 0, 0], (4, 1)), np.array([5.0, 15, 15, 40])
    spheres = np.array([[5.0, 0, 0, 1], [15, 0, 0, 1], [15, 8, 0, 1], [40, 0, 0, 1]])
    out = np.empty(4)
    outlines.limits(normals, offsets, spheres, np.zeros(3), 10.0, 30.0, out)
    assert list(out) == [10, 30, 10, 10]


def test_impulses_are_splines_at_their_delays_and_land_again_where_frames_fold():
    omega, t0, dt, fold = 2 * np.pi * 7.29e9, -2e-9, 3e-11, 40e-9
    delays, values = np.array([10.013e-9, 41e-9, 55e-9]), np.array([1.0, 2j, 0.5 - 1j])
    grids, echo = np.zeros((3, 2000), complex), np.empty(3, complex)
    impulses.impulses(delays, values, PulseGrid(omega, t0, dt, fold), (0.25, 0.75), grids, echo)
    places = t0 + dt * np.arange(2000)
    for delay, value, told in zip(delays, values, echo, strict=True):
        landed = delay - np.floor((delay - t0) / fold) * fold
        assert told == pytest.approx(value * np.exp(-1j * omega * landed), abs=1e-8)
        for at in np.arange(landed, places[-1], fold):
            near = abs(places - at) < 4 * dt
            assert grids[0, near].sum() == pytest.approx(0.25 * value * np.exp(-1j * omega * at), abs=1e-8)
            assert (grids[1, near] * (places[near] - at)).sum() == pytest.approx(0, abs=1e-8)
            assert grids[1, near] == pytest.approx(3 * grids[0, near])
    assert not grids[2].any()
