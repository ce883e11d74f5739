"""Round walls of coarse strips echo as the cylinder through their corners does, not as a grating."""

from __future__ import annotations

import numpy as np
import pytest

import ullage as ul
from ullage.geometry import rpy_quat
from ullage.radar import arcs, physical
from ullage.radar.prepared import prepare
from ullage.radar.rounds import Round
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


@pytest.mark.parametrize("height", [0.1, 1.45, 1.7, 2.1])
def test_an_arc_is_what_the_integral_over_it_says(height):
    """Beside the wall, at its end and beyond that, where it is the end alone."""
    wave, eye, radius, width = 2 * np.pi / 0.0411, np.array([-1.19, 0.3, height]), 3.0, 0.1
    half = np.arcsin(width / 2 / radius)
    for angle in (0.2, 1.0, 2.2):
        wall = Round(
            np.zeros(3), np.eye(3), radius, -1.5, 1.5, 0.0, width, 0, strips=np.array([[angle, half, -1.5, 1.5]])
        )
        antennas = physical.AntennaPair(np.array([eye, eye]), np.array([np.eye(3)] * 2), np.zeros((2, 3)))
        lines = arcs._lines(wall)
        spots = arcs._spots(antennas, lines, arcs._places(antennas, lines, np.array([True]), np.inf))
        mine = arcs._along(spots, wave) * arcs._across_chord(spots, wave) * spots.outward.mean(0)
        mine = (mine / spots.ranges.prod(0) * np.exp(-1j * wave * spots.ranges.sum(0))).sum()
        true = _integral(angle, half, radius, eye, wave, bent=True) - _integral(
            angle, half, radius, eye, wave, bent=False
        )
        assert abs(mine - true) < 0.03 * abs(true)


def _integral(angle: float, half: float, radius: float, eye: np.ndarray, wave: float, *, bent: bool) -> complex:
    """Kirchhoff's integral of cos / r^2 over an arc or its chord, point by point."""
    t, dt = np.linspace(-half, half, 400, endpoint=False, retstep=True)
    t += dt / 2
    z = np.linspace(-1.5, 1.5, 6000, endpoint=False) + 0.25e-3
    if bent:
        place = radius * np.stack([np.cos(angle + t), np.sin(angle + t)], 1)
        normal, length = place / radius, np.full(len(t), radius * dt)
    else:
        out, on = np.array([np.cos(angle), np.sin(angle)]), np.array([-np.sin(angle), np.cos(angle)])
        place = radius * (np.cos(half) * out + (np.sin(half) * t / half)[:, None] * on)
        normal, length = np.broadcast_to(out, (len(t), 2)), np.full(len(t), radius * np.sin(half) * dt / half)
    to = place - eye[:2]
    across = (to * normal).sum(1)[:, None]
    r = np.sqrt((to**2).sum(1)[:, None] + (z - eye[2]) ** 2)
    return complex((across / r**3 * np.exp(-2j * wave * r) * length[:, None]).sum() * 0.5e-3)


def test_a_cap_ends_on_the_circle_that_its_wall_ends_on():
    """A floor with chords for a rim, its slivers added, is the disc, point by point; the plane around it the rest."""
    radius, count, wave, eye = 1.0, 40, 2 * np.pi / 0.0411, np.array([0.3, 0.2, 0.9])
    half, angle = np.pi / count, (2 * np.arange(count) + 1) * np.pi / count
    strips = np.column_stack([angle, np.full(count, half), np.zeros(count), np.full(count, 3.0)])
    antennas = physical.AntennaPair(np.array([eye, eye]), np.array([np.eye(3)] * 2), np.zeros((2, 3)))
    t, s = np.meshgrid((np.arange(100) + 0.5) / 50 - 1, (np.arange(24) + 0.5) / 24)
    chord, rise = np.cos(half), np.sqrt(1 - (np.sin(half) * t) ** 2) - np.cos(half)
    on = np.stack([chord + rise * s, np.sin(half) * t], -1)
    turn = np.array([[np.cos(angle), np.sin(angle)], [-np.sin(angle), np.cos(angle)]])
    places = np.einsum("kls,lmn->smnk", turn.transpose(1, 0, 2), on.transpose(2, 0, 1))
    far = np.sqrt(((places - eye[:2]) ** 2).sum(-1) + eye[2] ** 2)
    true = (eye[2] / far**3 * np.exp(-2j * wave * far) * rise * np.sin(half) / 50 / 24).sum((1, 2))
    for sign in (1, -1):
        wall = Round(np.zeros(3), np.eye(3), radius, 0.0, 3.0, 0.0, 0.15, 0, strips=strips,
                     caps=np.tile([sign, 0.0], (count, 1)))  # fmt: skip
        lines = arcs._lines(wall)
        places = arcs._places(antennas, lines, np.array([True]), np.inf)
        spots = arcs._spots(antennas, lines, places.some(np.flatnonzero(places.flat)))
        each = arcs._across_chord(spots, wave) * eye[2] / spots.ranges[0] ** 3 * np.exp(-2j * wave * spots.ranges[0])
        mine = np.bincount(spots.lines.strips, each.real) + 1j * np.bincount(spots.lines.strips, each.imag)
        assert abs(sign * mine - true).max() < 0.02 * abs(true).max()


def test_which_ends_of_strips_have_caps():
    def caps(scene: Scene) -> np.ndarray:
        (wall,) = prepare(scene).rounds
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
    (wall,) = prepare(whole).rounds
    assert len(wall.strips) == len(np.unique(np.round(np.arctan2(whole.vertices[:, 1], whole.vertices[:, 0]), 6)))
    assert np.allclose(wall.strips[:, 2:], [-1.0, 1.0])
    upright = np.flatnonzero(
        abs(np.cross(*np.diff(whole.vertices[whole.faces], axis=1).transpose(1, 0, 2))[:, 2]) < 1e-9
    )
    torn = Scene(whole.vertices, np.delete(whole.faces, upright[0], 0), whole.face_object[1:], whole.objects)
    (wall,) = prepare(torn).rounds
    assert len(wall.strips) == len(prepare(whole).rounds[0].strips) - 1


def test_what_is_hidden_adds_nothing():
    tank = ul.scenes.cylinder(3.0, 3.0, 0.0, edge_m=0.1)
    box = ul.scenes.cylinder(0.3, 0.6, 0.0, edge_m=0.01)
    context = physical.radar_context(Scene.union([tank, box]), SPEC)
    parts, wall = context.world.parts(None), context.world.rounds[0]
    antennas = physical.antenna_pair(SPEC, np.zeros(3), np.eye(3))
    assert arcs.accumulate_arcs(context, parts, (wall,), antennas, np.zeros((3, context.places), complex)) == []
