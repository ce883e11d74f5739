"""Rows on meshes: curved surfaces, slivers, shadow borders, and worlds turned together with the radar."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import numpy as np
from scipy.spatial.transform import Rotation
from scipy.special import fresnel

from studies.validation.rows import HERE, Row, db, gain, radar
from ullage.arrays import Complexes, Floats, Ints
from ullage.data import Trajectory
from ullage.radar.physical import echoes
from ullage.world import scenes, shapes
from ullage.world.library import WORLDS
from ullage.world.load import load_scene
from ullage.world.materials import Material
from ullage.world.scene import Scene, SceneObject

Mesh = tuple[Floats, Ints]


def curved_meshes() -> Iterator[Row]:
    """Coarse meshes of curved surfaces against fine ones: largest difference of eight frames, over a frame's peak."""
    path = _around(8)
    for name, coarse, fine, bound in (
        ("ellipsoid of 44 mm facets", _ellipsoid(0.044), _ellipsoid(0.014), 0.03),
        ("ellipsoid of 88 mm facets", _ellipsoid(0.088), _ellipsoid(0.014), 0.05),
        ("torus of 80 mm facets", _torus(48, 10), _torus(320, 76), 0.12),
    ):
        want, ours = (echoes(Scene.of_mesh(*m, name="thing", material="pec"), path, radar()) for m in (fine, coarse))
        yield Row(f"{name}, largest difference from a fine mesh", 0.0, _change(ours, want), bound, "")


def slivers() -> Iterator[Row]:
    """A plate of 4,000 slivers against one of two triangles."""
    whole = scenes.plate(0.5, 0.5, 3.0, yaw_deg=10)
    y, z = np.linspace(-0.25, 0.25, 2001), np.array([-0.25, 0.25])
    at = np.stack(np.meshgrid(y, z, indexing="ij"), -1).reshape(-1, 2)
    k = 2 * np.arange(2000)
    faces = np.concatenate([np.stack([k, k + 2, k + 3], 1), np.stack([k, k + 3, k + 1], 1)])
    a, b, c = whole.vertices[whole.faces[0]]
    sides = sorted((b - a, c - b, a - c), key=lambda side: float(np.linalg.norm(side)))[:2]
    along, up = (side / np.linalg.norm(side) for side in sides)
    middle = whole.vertices.mean(0)
    vertices = middle + at[:, :1] * along + at[:, 1:] * up
    cut = Scene.of_mesh(vertices, faces.astype(np.int32), name="plate", material="pec")
    yield Row("plate of 4,000 slivers, turned 10 deg", db(gain(whole)), db(gain(cut)), 0.01)


def shadow_borders() -> Iterator[Row]:
    """A wall at 4 m behind a black screen at 2 m: the double knife edge, by Kirchhoff's integral over the wall."""
    wall = scenes.plate(12, 12, 4.0, name="wall")
    bare = echoes(wall, HERE, radar())[0]
    peak = int(abs(bare).argmax())
    for edge_m, bound_db, bound_deg in ((-0.06, 1.0, 10.0), (0.06, 1.0, 10.0), (0.12, 1.0, 10.0), (0.2, 3.0, 20.0)):
        screen = replace(scenes.plate(10, 5, 2.0, name="screen"), objects=(_black("screen"),))
        screen = replace(screen, vertices=screen.vertices + np.array([0, 0, edge_m - 2.5]))
        ours = echoes(Scene.union([wall, screen]), HERE, radar())[0, peak] / bare[peak]
        want = _knife_edge(edge_m, radar().wavelength_m)
        name = f"screen {abs(edge_m):g} m {'over' if edge_m > 0 else 'below'} the axis"
        yield Row(f"{name}: wall behind it", db(want), db(ours), bound_db)
        turn = float(np.degrees(np.angle(ours / want)))
        phase = float(np.degrees(np.angle(want)))
        yield Row(f"{name}: phase", phase, phase + turn, bound_deg, "deg")


def _black(name: str) -> SceneObject:
    """Opaque, and reflects nothing."""
    return SceneObject(name=name, material=Material(name="black", a=1.0))


def _knife_edge(edge_m: float, wavelength_m: float) -> complex:
    """What a screen half way to a wall at 4 m leaves of its echo: Fresnel's integral there and back, over the wall."""
    y = np.linspace(-3, 3, 60001)
    sine, cosine = fresnel((edge_m - y / 2) * np.sqrt(2 / wavelength_m))
    one_way = (1 + 1j) / 2 * ((0.5 - cosine) - 1j * (0.5 - sine))
    weight = np.exp(-2j * np.pi / wavelength_m * y * y / 4 - (y / 1.6) ** 8)
    return complex((one_way**2 * weight).sum() / weight.sum())


def turned_worlds() -> Iterator[Row]:
    """Shipped worlds turned at random together with the radar: largest change of a sample, over a frame's peak."""
    for name, bounces, bound in (("cluttered-room", 1, 1e-3), ("cargo-hold", 3, 1e-3), ("ntnu-plate", 3, 1e-3)):
        scene = load_scene(WORLDS[name].path)
        path = _inside(scene, 4)
        still = echoes(scene, path, radar(), max_bounces=bounces)
        turn = Rotation.random(random_state=1)
        there = replace(path, position=turn.apply(path.position),
                        quat_xyzw=(turn * Rotation.from_quat(path.quat_xyzw)).as_quat())  # fmt: skip
        change = _change(echoes(_turned(scene, turn), there, radar(), max_bounces=bounces), still)
        yield Row(f"{name} and radar turned, {bounces} bounce{'s' * (bounces > 1)}: change", 0.0, change, bound, "")


def _turned(scene: Scene, turn: Rotation) -> Scene:
    wires = scene.wires
    ends = {name: turn.apply(getattr(wires, name)) for name in ("start", "end") if len(wires)}
    return replace(scene, vertices=turn.apply(scene.vertices), wires=replace(wires, **ends))


def _ellipsoid(edge_m: float) -> Mesh:
    return shapes.ellipsoid((0.3, 0.4, 0.25), edge_m=edge_m)


def _torus(around: int, across: int) -> Mesh:
    """A torus of 0.4 m with a tube of 0.12 m, in so many sections around its axis and around the tube."""
    u, v = np.arange(around) * 2 * np.pi / around, np.arange(across) * 2 * np.pi / across
    u, v = np.meshgrid(u, v, indexing="ij")
    away = 0.4 + 0.12 * np.cos(v)
    vertices = np.stack([away * np.cos(u), away * np.sin(u), 0.12 * np.sin(v)], -1).reshape(-1, 3)
    i, j = (row.ravel() for row in np.meshgrid(np.arange(around), np.arange(across), indexing="ij"))
    a, b, c, d = (p % around * across + q % across for p, q in ((i, j), (i + 1, j), (i + 1, j + 1), (i, j + 1)))
    return vertices, np.concatenate([np.stack([a, b, c], 1), np.stack([a, c, d], 1)]).astype(np.int32)


def _around(count: int) -> Trajectory:
    """Random poses 1 to 2.5 m from the origin, facing it."""
    rng = np.random.default_rng(5)
    out = rng.normal(size=(count, 3))
    out /= np.linalg.norm(out, axis=1, keepdims=True)
    angles = np.column_stack([np.arctan2(-out[:, 1], -out[:, 0]), np.arcsin(out[:, 2]), np.zeros(count)])
    return _poses(out * rng.uniform(1, 2.5, (count, 1)), angles)


def _inside(scene: Scene, count: int) -> Trajectory:
    """Random poses in the middle of a scene."""
    rng, (low, high) = np.random.default_rng(3), scene.bounds
    place = low + (high - low) * (0.2 + 0.6 * rng.random((count, 3)))
    return _poses(place, np.column_stack([rng.uniform(-np.pi, np.pi, count), np.zeros((count, 2))]))


def _poses(place: Floats, angles: Floats) -> Trajectory:
    quat = Rotation.from_euler("ZYX", angles).as_quat()
    return Trajectory(np.arange(len(place)) * 10**8, place, quat)


def _change(ours: Complexes, want: Complexes) -> float:
    """Largest difference of each frame over that frame's peak; the worst frame."""
    return float((abs(ours - want).max(1) / abs(want).max(1)).max())
