"""Which triangles are one plane."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

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
    planar = prepare(Scene.of_mesh(vertices, faces, name="floor", made_of="pec")).still.planar
    assert len(planar.normals) == 1


def test_a_sliver_that_a_file_rounded_leaves_a_plane_whole():
    """Its own normal is off by so little that its neighbour is joined to it, but 100 m away by more than is a plane."""
    x = np.arange(6) * 20.0
    row = [np.column_stack([x, np.full(6, y), np.zeros(6)]) for y in (0.0, 20.0)]
    vertices = np.concatenate([*row, [[-1e-3, 10.0, 1.5e-8]]])
    cell = np.arange(5)[:, None]
    faces = np.concatenate([[[0, 6, 12]], cell + np.array((0, 1, 6)), cell + np.array((1, 7, 6))]).astype(np.int32)
    planar = prepare(Scene.of_mesh(vertices, faces, name="floor", made_of="pec")).still.planar
    assert len(planar.normals) == 1


def cut_in_needles(count: int, fan: bool) -> tuple[np.ndarray, np.ndarray]:
    """A square of 0.5 m as triangles half a millimetre wide: a zigzag strip, or a fan about a point of its edge."""
    x = np.linspace(-0.25, 0.25, count // (1 if fan else 2) + 1)
    top = np.column_stack([x, np.full(len(x), 0.25)])
    step = np.arange(len(x) - 1)
    if fan:
        corners = np.concatenate([top, [[0, -0.25], [-0.25, -0.25], [0.25, -0.25]]])
        n = len(x)
        return corners, np.concatenate([np.column_stack([np.full(n - 1, n), step + 1, step]),
                                        [[n + 1, n, 0], [n, n + 2, n - 1]]])  # fmt: skip
    corners, n = np.concatenate([top, top * [1, -1]]), len(x)
    return corners, np.concatenate([np.column_stack([step, n + step, step + 1]),
                                    np.column_stack([step + 1, n + step, n + step + 1])])  # fmt: skip


@pytest.mark.parametrize("fan", [False, True])
@pytest.mark.parametrize("far_m", [0.0, 100.0])
@pytest.mark.parametrize("kind", [np.float64, np.float32])
def test_a_plate_cut_in_4000_needles_echoes_as_the_plate(kind, far_m, fan):
    """Single precision turns the normal of a needle by up to 4 deg at 100 m; that of the plate hardly."""
    turn = Rotation.from_euler("zyx", [7, 3, 4], degrees=True)
    here, spec = np.full(3, far_m), ul.RadarSpec.preset("x4m05", noise=None)

    def echo(count: int, fan: bool) -> np.ndarray:
        flat, faces = cut_in_needles(count, fan)
        corners = turn.apply(np.column_stack([np.zeros(len(flat)), flat])) + here + [3, 0, 0]
        plate = Scene.of_mesh(
            corners.astype(kind).astype(float), faces.astype(np.int32), name="plate", made_of="concrete"
        )
        assert len(prepare(plate).still.planar) == 1
        return np.asarray(physical.echoes(plate, ul.Trajectory.stationary(here), spec))

    whole = echo(2, fan=False)
    assert abs(echo(4000, fan) - whole).max() < 1e-3 * abs(whole).max()


def test_cuts_by_needles_leave_a_outline_no_corners():
    flat, faces = cut_in_needles(4000, fan=False)
    plate = Scene.of_mesh(
        np.column_stack([np.full(len(flat), 3.0), flat]), faces.astype(np.int32), name="plate", made_of="concrete"
    )
    assert len(prepare(plate).still.planar.starts) <= 6
