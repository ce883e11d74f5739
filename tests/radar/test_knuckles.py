"""Coarse knuckles of dished heads echo as the tori through their corners do."""

from __future__ import annotations

import numpy as np
import pytest
import trimesh
from radar_worlds import dished

import ullage as ul
from ullage.geometry import rpy_quat
from ullage.radar import physical
from ullage.radar.prepared import prepare
from ullage.radar.quadrics import Quadric
from ullage.world import shapes
from ullage.world.scene import Scene

SPEC = ul.RadarSpec.preset("x4m05")
RADIUS, CROWN, KNUCKLE, HALF = 0.6, 1.2, 0.15, 0.4
LEAN = np.arcsin((RADIUS - KNUCKLE) / (CROWN - KNUCKLE))


def vessel(edge_m: float) -> Scene:
    """A vessel with dished heads."""
    steps = int(CROWN * LEAN / edge_m) + 2, int(KNUCKLE * (np.pi / 2 - LEAN) / edge_m) + 3
    mesh = dished(RADIUS, CROWN, KNUCKLE, HALF, steps=steps, around=int(2 * np.pi * RADIUS / edge_m))
    return Scene.of_mesh(*mesh, name="vessel", made_of="pec")


def frames(edge_m: float) -> np.ndarray:
    """Echoes (4, b) within, before both heads too, and of one from outside."""
    places = np.array([[0.15, 0.1, 0.0], [0.1, 0.05, 0.3], [-0.2, 0.2, -0.25], [0.3, 0.1, 1.7]])
    turns = np.array([rpy_quat(0, p, y) for p, y in ((-0.9, 0.3), (-1.3, 0), (0.8, 1.0), (1.2, np.pi))])
    path = ul.Trajectory(np.arange(4) * 10**9, places, turns)
    return physical.echoes(vessel(edge_m), path, SPEC)[:, SPEC.range_m > 0.15]


@pytest.fixture(scope="module")
def fine() -> np.ndarray:
    """A vessel of facets narrower than half a wave."""
    return frames(0.015)


@pytest.mark.parametrize("edge_m", [0.1, 0.15])
def test_a_coarse_vessel_echoes_as_a_fine_one(fine, edge_m):
    off = abs(frames(edge_m) - fine).max(1) / abs(fine).max(1)
    assert 20 * np.log10(off.max()) < -30  # knuckles of facets: -11 and -10


def test_pieces_stand_for_all_of_a_knuckle_and_nothing_else():
    scene = vessel(0.15)
    world = prepare(scene)
    assert len(world.spheres) == 2
    (knuckles,) = world.patches(SPEC.wavelength_m, 0.5)
    middles = np.concatenate([world.still.planar.spheres[:, :3], world.still.corners.mean(1)])
    out, up = np.hypot(*middles.T[:2]), abs(middles[:, 2])
    bent = (up > HALF + 1e-3) & (out > CROWN * np.sin(LEAN) - 1e-3)
    assert np.array_equal(np.concatenate([knuckles.planar, knuckles.small]), bent)
    turn = np.pi / 2 - LEAN
    area = 2 * np.pi * KNUCKLE * ((RADIUS - KNUCKLE) * turn + KNUCKLE * np.sin(turn))
    a, b, c = knuckles.fine.corners.transpose(1, 0, 2)
    assert np.linalg.norm(np.cross(b - a, c - a), axis=1).sum() / 2 == pytest.approx(2 * area, rel=2e-3)
    sides = (knuckles.fine.corners + np.roll(knuckles.fine.corners, 1, 1)) / 2  # their mean is that of a parabola
    tube = np.hypot(np.hypot(sides[..., 0], sides[..., 1]) - RADIUS + KNUCKLE, abs(sides[..., 2]) - HALF)
    assert abs(tube.mean() - KNUCKLE) < 1e-4
    assert abs(tube - KNUCKLE).max() < 5e-4
    middles = knuckles.fine.corners.mean(1)
    outward = knuckles.fine.backs.outward[:, :3]
    assert np.allclose(abs(outward), abs(knuckles.fine.normals))
    assert ((outward * middles).sum(1) > 0).all()


@pytest.mark.parametrize("shape", ["capsule", "cylinder"])
def test_other_ends_are_no_knuckles(shape):
    mesh = {
        "capsule": lambda: shapes.capsule(0.7, 1.5, segment_m=0.1),
        "cylinder": lambda: shapes.cylinder(0.7, 1.5, segment_m=0.1),
    }[shape]()
    world = prepare(Scene.of_mesh(*mesh, name="thing", made_of="pec"))
    assert world.patches(SPEC.wavelength_m, 0.5) == [None]


def test_walls_are_searched_for_caps_near_their_own_ends(monkeypatch):
    """The points that are brought into walls' frames grow with their number, not with its square."""
    asked = []
    whole = Quadric.local
    monkeypatch.setattr(Quadric, "local", lambda self, points: asked.append(points.size) or whole(self, points))

    def points(count):
        pipe = trimesh.creation.cylinder(0.1, 1.0, sections=24)
        pipes = [pipe.copy().apply_translation((1.5 * k, 0, 0)) for k in range(count)]
        mesh, start = trimesh.util.concatenate(pipes), len(asked)
        world = prepare(Scene.of_mesh(mesh.vertices, mesh.faces.astype(np.int32), name="pipes"))
        assert len(world.quadrics) == count
        assert all((wall.caps == 1).all() for wall in world.quadrics)
        return sum(asked[start:])

    assert points(12) < 2.5 * points(6)
