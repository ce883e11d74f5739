"""Round walls of coarse strips echo as the cylinder through their corners does, not as a grating."""

from __future__ import annotations

import numpy as np
import pytest

import ullage as ul
from ullage.geometry import rpy_quat
from ullage.radar import cylinder_correction, physical
from ullage.radar.context import antenna_pair, radar_context, radar_frame
from ullage.radar.prepared import prepare
from ullage.world.scene import Scene

SPEC = ul.RadarSpec.preset("x4m05")
PLACES = np.array([[-1.19, y, 0.2] for y in (0.0, 0.3, 0.6)])
INSIDE = ul.Trajectory(np.arange(3) * 10**9, PLACES, np.tile(rpy_quat(0.0, 0.0, np.pi / 2), (3, 1)))


def frames(scene: Scene, path: ul.Trajectory = INSIDE) -> np.ndarray:
    """Echoes (n, b) without noise."""
    return physical.echoes(scene, path, SPEC)


def apart(mine: np.ndarray, fine: np.ndarray, ranges: np.ndarray) -> float:
    """The greatest difference in some ranges (b), in decibels of each frame's peak."""
    off = abs(mine - fine) / abs(fine).max(1, keepdims=True)
    return float(20 * np.log10(off[:, ranges].max()))


@pytest.fixture(scope="module")
def smooth() -> np.ndarray:
    """A tank of strips narrower than half a wave."""
    return frames(ul.scenes.cylinder(3.0, 3.0, 0.0, material="pec", edge_m=0.02))


@pytest.mark.parametrize(("edge_m", "between_db", "most_db"), [(0.05, -44, -41), (0.1, -48, -40), (0.2, -50, -29)])
def test_a_tank_of_strips_has_no_ghosts_between_its_near_wall_and_its_far_one(smooth, edge_m, between_db, most_db):
    found = frames(ul.scenes.cylinder(3.0, 3.0, 0.0, material="pec", edge_m=edge_m))
    between = (SPEC.range_m > 2.4) & (SPEC.range_m < 3.9)
    assert apart(found, smooth, between) < between_db  # -25 of bare strips, whatever their width
    assert apart(found, smooth, SPEC.range_m > 1.0) < most_db  # -24, -17 and -8 of bare strips


@pytest.mark.parametrize(("radius_m", "edge_m", "most_db"), [(0.5, 0.05, -35), (0.5, 0.1, -32), (1.0, 0.2, -30)])
def test_a_drum_of_strips_echoes_as_the_drum_through_their_corners(radius_m, edge_m, most_db):
    here = ul.Trajectory.stationary((0, 0, 0), n=1)
    drums = [ul.scenes.cylinder(radius_m, 1.5, radius_m + 1.3, edge_m=edge) for edge in (edge_m, 0.015)]
    assert apart(*(frames(drum, here) for drum in drums), SPEC.range_m > 0.5) < most_db  # -15, -3 and -4 bare


def test_which_ends_of_strips_have_caps():
    def caps(scene: Scene) -> np.ndarray:
        (wall,) = prepare(scene).quadrics
        return np.unique(wall.caps, axis=0)

    drum = ul.scenes.cylinder(1.0, 2.0, 0.0, edge_m=0.1)
    height = drum.vertices[drum.faces][..., 2]

    def of(faces: np.ndarray) -> Scene:
        return Scene.of_mesh(drum.vertices, faces, name="drum", made_of="pec")

    assert caps(drum) == pytest.approx(np.array([[1, 1]]))
    assert caps(of(drum.faces[height.min(1) < 0.99])) == pytest.approx(np.array([[1, 0]]))
    wide = drum.vertices.copy()
    wide[:, :2] *= 2  # the cap's plane goes on around the opening
    lid = drum.faces[height.min(1) > 0.99]
    edges = np.stack([lid, np.roll(lid, -1, 1)], -1).reshape(-1, 2)
    edges = edges[~(edges[:, None, ::-1] == edges).all(-1).any(1)]
    out = edges + len(drum.vertices)
    ring = np.concatenate([np.column_stack([edges, out[:, :1]]), np.column_stack([edges[:, 1:], out[:, ::-1]])])
    open_ = np.concatenate([drum.faces[height.min(1) < 0.99], ring])
    found = caps(Scene.of_mesh(np.concatenate([drum.vertices, wide]), open_, name="drum", made_of="pec"))
    assert found == pytest.approx(np.array([[1, -1]]))
    both = Scene.of_mesh(
        np.concatenate([drum.vertices, wide]), np.concatenate([drum.faces, ring]), name="drum", made_of="pec"
    )
    assert caps(both) == pytest.approx(np.array([[1, 0]]))


def test_strips_with_holes_stay_as_they_are():
    whole = ul.scenes.cylinder(1.0, 2.0, 0.0, edge_m=0.1)
    (wall,) = prepare(whole).quadrics
    assert len(wall.strips) == len(np.unique(np.round(np.arctan2(whole.vertices[:, 1], whole.vertices[:, 0]), 6)))
    assert np.allclose(wall.strips[:, 2:], [-1.0, 1.0])
    upright = np.flatnonzero(
        abs(np.cross(*np.diff(whole.vertices[whole.faces], axis=1).transpose(1, 0, 2))[:, 2]) < 1e-9
    )
    torn = Scene(whole.vertices, np.delete(whole.faces, upright[0], 0), whole.face_object[1:], whole.objects)
    (wall,) = prepare(torn).quadrics
    assert len(wall.strips) == len(prepare(whole).quadrics[0].strips) - 1


def test_what_is_hidden_adds_nothing():
    tank = ul.scenes.cylinder(3.0, 3.0, 0.0, edge_m=0.1)
    box = ul.scenes.cylinder(0.3, 0.6, 0.0, edge_m=0.01)
    context = radar_context(Scene.union([tank, box]), SPEC)
    frame = radar_frame(context, antenna_pair(SPEC, np.zeros(3), np.eye(3)))
    vars(frame)["quadrics"] = frame.quadrics[:1]
    assert cylinder_correction.accumulate_cylinder_corrections(frame) == []
