"""What moves echoes at every moment as what stands still in its place does."""

from dataclasses import replace

import numpy as np
import pytest

import ullage as ul
from ullage.radar.movers import Movers
from ullage.world.moving import LiveMotion
from ullage.world.raycast import Raycaster

RADAR = ul.RadarSpec.preset("x4m05", noise=None)
TURNS = np.array([[0, 0, 0, 1], [0.1, -0.2, 0.15, 0.96]])


def motion(k):
    """A thing that goes and turns about its own corner of the world."""
    out = LiveMotion((0.1 * k, 0.0, 0.0), TURNS[0])
    for t_ns, turn in zip((0, 10**9), TURNS, strict=True):
        out.see(t_ns, (0.1 * k, 0.3 * t_ns * 1e-9, -0.1 * k), turn / np.linalg.norm(turn))
    return out


def world():
    """A box of flat faces, a ball of triangles, a sheet one sees through, and a wire, before a wall."""
    box = ul.scenes.trihedral(0.4, 3.0)
    ball = ul.scenes.sphere(0.2, 2.0)
    sheet = ul.scenes.plate(0.6, 0.6, 1.2, material="plasterboard", name="sheet")
    wire = ul.scenes.wire(0.002, 0.8, 1.6)
    parts = [box, ball, sheet, wire]
    still = ul.Scene.union([*parts, ul.scenes.plate(4, 4, 5.0, name="wall")])
    wall = len(still.objects) - 1
    paths = [None if k == wall else motion(k) for k in range(len(still.objects))]
    return still, replace(still, objects=tuple(replace(o, motion=p) for o, p in zip(still.objects, paths, strict=True)))


def frozen(still, poses):
    """The still world with everything brought to its place."""
    corners = still.corners()
    corners = np.einsum("nij,nkj->nki", poses[still.face_object, :3, :3], corners)
    corners += poses[still.face_object, None, :3, 3]
    turn, shift = poses[still.wires.object_id, :3, :3], poses[still.wires.object_id, :3, 3]
    start, end = (np.einsum("nij,nj->ni", turn, p) + shift for p in (still.wires.start, still.wires.end))
    faces = np.arange(3 * len(corners)).reshape(-1, 3).astype(still.faces.dtype)
    return replace(
        still, vertices=corners.reshape(-1, 3), faces=faces, wires=replace(still.wires, start=start, end=end)
    )


@pytest.mark.parametrize("max_bounces", [1, 2])
def test_a_moment_of_what_moves_is_a_still_world(max_bounces):
    still, moving = world()
    track = ul.Trajectory.stationary(n=3, rate_hz=2.5)  # 0 to 0.8 s
    frames = ul.simulate(moving, track, RADAR, max_bounces=max_bounces).samples
    for i, t_ns in enumerate(track.t_ns):
        there = frozen(still, moving.poses(int(t_ns)))
        want = ul.simulate(there, track[i : i + 1], RADAR, max_bounces=max_bounces).samples[0]
        strength = abs(frames[i] - want).max() / abs(want).max()
        assert strength < 1e-5, i


def test_where_they_start_they_are_as_they_were():
    _, moving = world()
    moves = np.array([o.motion is not None for o in moving.objects])[moving.face_object]
    movers = Movers(moving, moves)
    home, same = movers.at(moving.poses(0)), movers.at(moving.poses(-5))
    np.testing.assert_array_equal(home.corners, same.corners)
    there = movers.at(moving.poses(10**9))
    np.testing.assert_allclose(np.linalg.norm(there.normals, axis=1), 1, atol=1e-12)
    edges = there.planar.ends - there.planar.starts
    np.testing.assert_allclose(
        np.linalg.norm(edges, axis=1), np.linalg.norm(home.planar.ends - home.planar.starts, axis=1), atol=1e-12
    )
    lead = there.planar.starts[there.planar.first[:-1]]
    np.testing.assert_allclose(np.einsum("ni,ni->n", lead, there.planar.normals), there.planar.offsets, atol=1e-12)


def test_a_caster_told_to_stand_sees_what_one_asked_for_the_time_sees():
    _, moving = world()
    rng = np.random.default_rng(0)
    rays = rng.normal(size=(500, 3))
    rays /= np.linalg.norm(rays, axis=1, keepdims=True)
    caster = Raycaster(moving)
    for t_ns in (0, 4 * 10**8, 10**9):
        face, distance = caster.hits(np.zeros(3), rays, t_ns=t_ns)
        stood_face, stood = caster.standing(moving.poses(t_ns)).hits(np.zeros(3), rays)
        np.testing.assert_array_equal(face, stood_face)
        np.testing.assert_allclose(distance[face >= 0], stood[face >= 0], atol=1e-9)
