"""Which triangles are one plane."""

from __future__ import annotations

import numpy as np
import pytest

import ullage as ul
from ullage.radar import physical
from ullage.radar.prepared import prepare
from ullage.world.scene import Scene


@pytest.mark.parametrize("height_m", [3.0, 10.0])
def test_long_narrow_strips_of_a_round_wall_are_no_plane(height_m):
    """Each lies off its neighbour's plane by less than files round; all of them together go round."""
    here, spec = ul.Trajectory.stationary((0, 0, 0), n=1), ul.RadarSpec.preset("x4m05")

    def wall(edge_m: float) -> np.ndarray:
        found = physical.echoes(ul.scenes.cylinder(3.0, height_m, 4.0, edge_m=edge_m, material="pec"), here, spec)
        return np.asarray(abs(found[0]))

    assert wall(0.012).max() == pytest.approx(wall(0.04).max(), rel=0.01)


def test_corners_that_a_file_rounded_leave_a_plane_whole():
    rng = np.random.default_rng(0)
    x, y = (c.ravel() for c in np.meshgrid(np.arange(9.0), np.arange(9.0)))
    vertices = np.column_stack([x, y, rng.uniform(-4e-6, 4e-6, 81)])
    cell = np.arange(72).reshape(8, 9)[:, :8].reshape(-1, 1)
    faces = np.concatenate([cell + np.array(way) for way in ((0, 1, 9), (1, 10, 9))]).astype(np.int32)
    flats = prepare(Scene.of_mesh(vertices, faces, name="floor", made_of="pec")).still.flats
    assert len(flats.normals) == 1


def test_a_sliver_that_a_file_rounded_leaves_a_plane_whole():
    """Its own normal is off by so little that its neighbour is joined to it, but 100 m away by more than is a plane."""
    x = np.arange(6) * 20.0
    row = [np.column_stack([x, np.full(6, y), np.zeros(6)]) for y in (0.0, 20.0)]
    vertices = np.concatenate([*row, [[-1e-3, 10.0, 1.5e-8]]])
    cell = np.arange(5)[:, None]
    faces = np.concatenate([[[0, 6, 12]], cell + np.array((0, 1, 6)), cell + np.array((1, 7, 6))]).astype(np.int32)
    flats = prepare(Scene.of_mesh(vertices, faces, name="floor", made_of="pec")).still.flats
    assert len(flats.normals) == 1
