"""Coarse curved surfaces echo as the surfaces through their corners do: ellipsoid, torus, bend, dished head, cone."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import lru_cache

import numpy as np
import pytest
import trimesh
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

import ullage as ul
from ullage.errors import UllageWarning
from ullage.geometry import rpy_quat
from ullage.radar import patches, physical
from ullage.radar.prepared import prepare
from ullage.world import shapes
from ullage.world.moving import LiveMotion
from ullage.world.scene import Scene

SPEC = ul.RadarSpec.preset("x4m05", noise=None)
Mesh = tuple[NDArray[np.float64], NDArray[np.int32]]


def skin(rings: NDArray[np.float64], *, closed: bool) -> Mesh:
    """A mesh through rings (n, m, 3) of points; points in one place are welded."""
    n, m = rings.shape[:2]
    i, j = np.meshgrid(np.arange(n if closed else n - 1), np.arange(m), indexing="ij")
    a, b, c, d = (p * m + q for p, q in ((i, j), ((i + 1) % n, j), ((i + 1) % n, (j + 1) % m), (i, (j + 1) % m)))
    faces = np.concatenate([np.stack(t, -1).reshape(-1, 3) for t in ((a, b, c), (a, c, d))])
    vertices, at = np.unique(np.round(rings.reshape(-1, 3), 9), axis=0, return_inverse=True)
    faces = at.reshape(-1)[faces]
    whole = (faces != np.roll(faces, 1, 1)).all(1)
    return vertices, faces[whole].astype(np.int32)


def ellipsoid(edge_m: float) -> Mesh:
    return shapes.ellipsoid((0.3, 0.4, 0.25), edge_m=edge_m)


def ring(edge_m: float, turn: float = 2 * np.pi, wide: float = 0.4, tube: float = 0.12) -> Mesh:
    """A torus, or part of one."""
    count = int(np.ceil(turn * (wide + tube) / edge_m))
    u, v = np.arange(count + (turn < 6)) * turn / count, np.arange(int(np.ceil(2 * np.pi * tube / edge_m)))
    u, v = np.meshgrid(u, v * 2 * np.pi / len(v), indexing="ij")
    away = wide + tube * np.cos(v)
    return skin(np.stack([away * np.cos(u), away * np.sin(u), tube * np.sin(v)], -1), closed=turn > 6)


def bend(edge_m: float) -> Mesh:
    return ring(edge_m, turn=np.pi / 2, wide=0.35, tube=0.1)


def vessel(edge_m: float) -> Mesh:
    """A cylinder with elliptical heads, half as deep as wide."""
    turn = np.linspace(0, np.pi / 2, int(np.ceil(1.21 * 0.4 / edge_m)) + 1)
    top = np.stack([0.4 * np.sin(turn), 0.4 + 0.2 * np.cos(turn)], 1)
    profile = np.concatenate([top, top[::-1] * [1, -1]])
    around = np.arange(int(np.ceil(2 * np.pi * 0.4 / edge_m)))
    around = around * 2 * np.pi / len(around)
    level = np.broadcast_to(profile[:, 1:], (len(profile), len(around)))
    return skin(np.stack([profile[:, :1] * np.cos(around), profile[:, :1] * np.sin(around), level], -1), closed=False)


def poses(count: int = 8) -> ul.Trajectory:
    """Poses all round at 1 to 2.5 m, facing the origin."""
    rng = np.random.default_rng(5)
    out = rng.normal(size=(count, 3))
    out /= np.linalg.norm(out, axis=1, keepdims=True)
    turns = [rpy_quat(0, np.arcsin(z), np.arctan2(-y, -x)) for x, y, z in out]
    return ul.Trajectory(np.arange(count) * 10**9, out * rng.uniform(1, 2.5, (count, 1)), np.array(turns))


def frames(mesh: Mesh, *, cut: bool = True) -> NDArray[np.complex64]:
    """The echoes; `cut`: False where the mesh is so fine that it must not be cut."""
    scene = Scene.of_mesh(*mesh, name="thing", made_of="pec")
    assert cut or prepare(scene).patches(SPEC.wavelength_m, 0.5) == [None]
    return physical.echoes(scene, poses(), SPEC)


def off_db(coarse: NDArray[np.complex64], fine: NDArray[np.complex64]) -> NDArray[np.float64]:
    """Largest difference in each frame over that frame's peak [dB]."""
    return np.asarray(20 * np.log10(abs(coarse - fine).max(1) / abs(fine).max(1)))


@lru_cache(maxsize=4)
def truth(make: Callable[[float], Mesh], edge_m: float) -> NDArray[np.complex64]:
    """What a mesh echoes that is so fine that it is not cut."""
    return frames(make(edge_m), cut=False)


@pytest.mark.parametrize(("make", "fine_m", "edge_m", "worst_db", "median_db"), [
    (ellipsoid, 0.014, 0.044, -31, -34),  # facets: -20, -23
    (ellipsoid, 0.014, 0.088, -26, -35),  # -11, -14
    (ring, 0.01, 0.051, -24, -32),  # -2, -3
    pytest.param(ring, 0.01, 0.08, -18, -34, marks=pytest.mark.slow),  # +5, +3
    pytest.param(bend, 0.008, 0.03, -16, -26, marks=pytest.mark.slow),  # -9, -13
    pytest.param(vessel, 0.012, 0.05, -30, -34, marks=pytest.mark.slow),  # -8, -15
    pytest.param(vessel, 0.012, 0.1, -15, -27, marks=pytest.mark.slow),  # 0, -12; without normals of the wall -19
])  # fmt: skip
def test_a_coarse_curved_surface_echoes_as_a_fine_one(make, fine_m, edge_m, worst_db, median_db):
    off = off_db(frames(make(edge_m)), truth(make, fine_m))
    assert off.max() < worst_db
    assert np.median(off) < median_db


@pytest.mark.parametrize("make", [ring, bend])
def test_turning_a_curved_thing_and_the_radar_changes_nothing(make):
    vertices, faces = make(0.06)
    turn, path = Rotation.random(random_state=4), poses()
    turned = replace(path, position=turn.apply(path.position),
                     quat_xyzw=(turn * Rotation.from_quat(path.quat_xyzw)).as_quat())  # fmt: skip
    there = physical.echoes(Scene.of_mesh(turn.apply(vertices), faces, name="thing", made_of="pec"), turned, SPEC)
    assert off_db(there, frames((vertices, faces))).max() < -80


@pytest.mark.parametrize("scene", [
    ul.scenes.room((6, 4, 3), plate={"width_m": 0.5, "height_m": 0.5, "distance_m": 2.0}),
    ul.scenes.sphere(0.3, distance_m=3.0),
    ul.scenes.cylinder(0.3, 1.0, distance_m=3.0),
    Scene.of_mesh(*skin(np.array([[[x, y, z] for x, y in ((0, 0), (1, 0), (1, 1), (0, 1))] for z in (0, 1)]),
                        closed=False), name="duct"),
], ids=["room", "ball", "cylinder", "duct"])  # fmt: skip
def test_flat_things_and_those_with_a_closed_form_stay_as_they_are(scene):
    assert prepare(scene).patches(SPEC.wavelength_m, 0.5) == [None]


def moving(mesh: Mesh, poses: list[tuple[NDArray[np.float64], Rotation]]) -> Scene:
    """A mesh that goes through these positions and turns, one every 0.1 s."""
    path = LiveMotion(poses[0][0], poses[0][1].as_quat())
    for i, (place, turn) in enumerate(poses):
        path.see(i * 10**8, place, turn.as_quat())
    return Scene.of_mesh(*mesh, name="thing", made_of="pec", motion=path)


@pytest.mark.parametrize("others", [0, 1])
def test_a_curved_thing_that_moves_echoes_as_it_does_at_rest_in_its_place(others):
    vertices, faces = ellipsoid(0.088)
    rng = np.random.default_rng(1)
    where = [(rng.uniform((1.9, -0.1, -0.1), (2.1, 0.1, 0.1)), Rotation.random(random_state=i)) for i in range(4)]
    beside = [Scene.of_mesh(*ring(0.08), name="ring", made_of="pec").moved((3.0, 1.0, 0.0))] * others
    path = ul.Trajectory.stationary(n=4, rate_hz=10)
    whole = Scene.union([moving((vertices, faces), where), *beside])
    frames = physical.echoes(whole, path, SPEC)
    for i, (place, turn) in enumerate(where):
        there = Scene.of_mesh(turn.apply(vertices) + place, faces, name="thing", made_of="pec")
        want = physical.echoes(Scene.union([there, *beside]), path[i : i + 1], SPEC)
        assert abs(frames[i : i + 1] - want).max() < 1e-4 * abs(want).max()


def test_a_body_of_revolution_that_turns_about_its_axis_has_no_doppler():
    vertices, faces = shapes.ellipsoid((0.3, 0.3, 0.2), edge_m=0.08)
    where = [(np.array([2.0, 0, 0]), Rotation.from_euler("z", a)) for a in np.linspace(0, 1, 9)]
    frames = physical.echoes(moving((vertices, faces), where), ul.Trajectory.stationary(n=9, rate_hz=10), SPEC)
    peak = frames[:, abs(frames).mean(0).argmax()]
    assert 20 * np.log10(abs(peak / peak.mean() - 1).max()) < -34  # facets: -11


def test_a_curved_thing_that_comes_closer_has_the_doppler_of_its_speed():
    step_m = 0.004
    where = [(np.array([2.0 - step_m * i, 0, 0]), Rotation.identity()) for i in range(9)]
    frames = physical.echoes(moving(ellipsoid(0.088), where), ul.Trajectory.stationary(n=9, rate_hz=10), SPEC)
    peak = frames[:, abs(frames).mean(0).argmax()]
    turns = np.angle(peak[1:] / peak[:-1])
    assert turns == pytest.approx(np.full(8, 4 * np.pi * step_m / SPEC.wavelength_m), rel=0.02)


def test_pieces_stand_for_whole_facets_and_fill_the_surface():
    scene = Scene.of_mesh(*ring(0.051), name="ring", made_of="pec")
    world = prepare(scene)
    (found,) = world.patches(SPEC.wavelength_m, 0.5)
    assert found.small.all()
    assert found.planar.all()
    a, b, c = found.fine.corners.transpose(1, 0, 2)
    area = np.linalg.norm(np.cross(b - a, c - a), axis=1).sum() / 2
    assert area == pytest.approx(4 * np.pi**2 * 0.4 * 0.12, rel=3e-3)  # facets: 1.3 % less
    outward = found.fine.backs.outward[:, :3]
    middles = found.fine.corners.mean(1)
    away = np.hypot(middles[:, 0], middles[:, 1])
    normal = np.stack([middles[:, 0] * (1 - 0.4 / away), middles[:, 1] * (1 - 0.4 / away), middles[:, 2]], 1) / 0.12
    assert (np.einsum("ni,ni->n", outward, normal) > 0.99).all()


def test_too_many_pieces_are_cut_more_coarsely_with_one_warning(monkeypatch):
    monkeypatch.setattr(patches, "MOST", 3000)
    scene = Scene.of_mesh(*ring(0.051), name="ring", made_of="pec")
    with pytest.warns(UllageWarning, match=r"ring: curved surfaces would take \d+ pieces; cut into \d+"):
        (found,) = prepare(scene).patches(SPEC.wavelength_m, 0.5)
    assert 2000 < len(found.fine.corners) <= 3000  # 1950 facets


@pytest.mark.parametrize("seed", range(2))
def test_broken_curved_meshes_echo_without_failing(seed):
    rng = np.random.default_rng(seed)
    vertices, faces = ellipsoid(0.088)
    faces = faces.copy()
    flipped = rng.random(len(faces)) < 0.2
    faces[flipped] = faces[flipped][:, ::-1]
    faces = np.concatenate([faces[rng.random(len(faces)) < 0.9], faces[:40], rng.integers(0, len(vertices), (20, 3))])
    out = frames((vertices, faces.astype(np.int32)))
    assert np.isfinite(out).all()
    assert abs(out).max() < 1


def test_a_cone_of_long_facets_alone_has_an_echo() -> None:
    """All its pieces are too long to share a ray."""
    cone = trimesh.creation.cone(0.4, 1.0)
    scene = Scene.of_mesh(np.asarray(cone.vertices), np.asarray(cone.faces, np.int32), name="cone", made_of="pec")
    path = ul.Trajectory.stationary((-3.0, 0.0, 0.5))
    assert 20 * np.log10(abs(ul.simulate(scene, path, SPEC).samples).max()) == pytest.approx(-88, abs=4)
