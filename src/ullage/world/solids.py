"""Building blocks of worlds: named parts of one material, and functions that make their meshes."""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from ullage.arrays import Floats
from ullage.geometry import apply, transform
from ullage.world import shapes
from ullage.world.materials import material
from ullage.world.scene import Scene
from ullage.world.sdf_geometry import WIRE_RADIUS_M, WIRE_SLENDERNESS, round_bar
from ullage.world.shapes import Shape

ROUND_SIDES = 16
"""Sides of a round part in furniture."""


@dataclass(frozen=True, slots=True, eq=False)
class Part:
    """A mesh of one material."""

    name: str
    material: str
    shape: Shape
    thickness_m: float | None = None  # of a sheet [m]; None: the material's own

    def moved(self, position_m: ArrayLike = (0, 0, 0), *, yaw_deg: float = 0.0, prefix: str = "") -> Part:
        """The part turned about the vertical and shifted."""
        return replace(self, name=prefix + self.name, shape=moved(self.shape, position_m, yaw_deg=yaw_deg))


@dataclass(frozen=True, slots=True, eq=False)
class Rod:
    """A straight round bar, pipe or wire, kept as its axis."""

    name: str
    material: str
    start: tuple[float, float, float]  # [m]
    end: tuple[float, float, float]  # [m]
    radius_m: float

    @property
    def length_m(self) -> float:
        """Length [m]."""
        return float(np.linalg.norm(np.subtract(self.end, self.start)))

    @property
    def center(self) -> Floats:
        """Middle of the axis (3) [m]."""
        return np.add(self.start, self.end) / 2

    @property
    def rpy_rad(self) -> tuple[float, float, float]:
        """The turn that takes z to the axis [rad]."""
        x, y, z = np.subtract(self.end, self.start)
        return 0.0, math.atan2(math.hypot(x, y), z), math.atan2(y, x) if math.hypot(x, y) > 1e-12 else 0.0

    @property
    def is_wire(self) -> bool:
        """Whether a scene keeps it as a line, as it does when a world file is read."""
        return self.radius_m <= WIRE_RADIUS_M and self.length_m >= WIRE_SLENDERNESS * self.radius_m

    def mesh(self) -> Shape:
        """The rod as triangles."""
        vertices, faces = round_bar(self.radius_m, self.length_m)
        return apply(transform(self.center, self.rpy_rad), vertices), faces


@dataclass(frozen=True, slots=True, eq=False)
class Box:
    """A cuboid along the axes."""

    name: str
    material: str
    center: tuple[float, float, float]  # [m]
    size: tuple[float, float, float]  # [m]


Solid = Part | Rod | Box


def scene_of(parts: Iterable[Solid], *, name: str) -> Scene:
    """The parts as a scene; thin rods become wires, as they do when a world file is read."""
    return Scene.union([_one(part) for part in parts], name=name)


def _one(part: Solid) -> Scene:
    chosen = material(part.material)
    if isinstance(part, Part):
        made_of = chosen if part.thickness_m is None else chosen.but(thickness_m=part.thickness_m)
        return Scene.of_mesh(*part.shape, name=part.name, material=made_of)
    if isinstance(part, Box):
        return Scene.of_mesh(*moved(shapes.box(part.size), part.center), name=part.name, material=chosen)
    if part.is_wire:
        return Scene.of_wires(np.array(part.start), np.array(part.end), part.radius_m, name=part.name, material=chosen)
    return Scene.of_mesh(*part.mesh(), name=part.name, material=chosen)


def join(*meshes: Shape) -> Shape:
    """Several meshes as one; nothing is merged."""
    shift = np.cumsum([0, *(len(v) for v, _ in meshes)])[:-1]
    faces = np.concatenate([f + s for (_, f), s in zip(meshes, shift, strict=True)])
    return np.concatenate([v for v, _ in meshes]), faces.astype(np.int32)


def moved(
    mesh: Shape,
    position_m: ArrayLike = (0, 0, 0),
    *,
    roll_deg: float = 0.0,
    pitch_deg: float = 0.0,
    yaw_deg: float = 0.0,
) -> Shape:
    """The mesh turned about fixed x, y, z, then shifted."""
    pose = transform(position_m, np.radians([roll_deg, pitch_deg, yaw_deg]))
    return apply(pose, mesh[0]), mesh[1]


def turned_over(mesh: Shape) -> Shape:
    """The mesh with its faces toward the other side."""
    return mesh[0], np.ascontiguousarray(mesh[1][:, ::-1])


def mirrored(mesh: Shape, axis: int = 1) -> Shape:
    """The mesh mirrored across the plane through the origin, still wound outward."""
    sign = np.ones(3)
    sign[axis] = -1
    return turned_over((mesh[0] * sign, mesh[1]))


def block(low: Sequence[float], high: Sequence[float]) -> Shape:
    """A box between two corners [m]."""
    a, b = np.asarray(low, float), np.asarray(high, float)
    return moved(shapes.box(b - a), (a + b) / 2)


def prism(profile_xz: ArrayLike, width_m: float) -> Shape:
    """An outline in the x-z plane, spread over y from -width / 2 to +width / 2."""
    vertices, faces = shapes.extrude([np.asarray(profile_xz, float)], width_m)
    return np.stack([vertices[:, 0], width_m / 2 - vertices[:, 2], vertices[:, 1]], axis=1), faces


def bar(start: ArrayLike, end: ArrayLike, radius_m: float, *, sides: int = ROUND_SIDES) -> Shape:
    """A closed round bar between two points."""
    return limb([start, end], [radius_m, radius_m], sides=sides)


def limb(points: Sequence[ArrayLike], radii_m: Sequence[float], *, sides: int = ROUND_SIDES) -> Shape:
    """A closed round body about a line of points, of a radius at each."""
    line = np.array([np.asarray(p, float) for p in points])
    ahead = np.gradient(line, axis=0)
    ahead /= np.linalg.norm(ahead, axis=1, keepdims=True)
    side = np.cross(ahead[0], [0, 0, 1.0] if abs(ahead[0, 2]) < 0.9 else [0, 1.0, 0])
    turn = 2 * np.pi / sides * np.arange(sides)
    rings = []
    for centre, axis, radius in zip(line, ahead, radii_m, strict=True):
        u = side - axis * (side @ axis)
        u /= np.linalg.norm(u)
        v = np.cross(axis, u)
        rings.append(centre + radius * (np.cos(turn)[:, None] * u + np.sin(turn)[:, None] * v))
        side = u
    return loft(np.array(rings))


def loft(rings: ArrayLike, *, caps: bool = True) -> Shape:
    """A skin through closed rings (k, m, 3) that turn to the left seen along their line; flat star-shaped ends."""
    grid = np.asarray(rings, float)
    count, around = grid.shape[:2]
    index = np.arange(count * around).reshape(count, around)
    after = np.roll(index, -1, axis=1)
    quads = np.stack([index[:-1], after[:-1], after[1:], index[1:]], axis=-1).reshape(-1, 4)
    faces = [quads[:, [0, 1, 2]], quads[:, [0, 2, 3]]]
    if caps:
        middle = np.full(around, count * around)
        faces += [np.stack([middle, after[0], index[0]], 1), np.stack([middle + 1, index[-1], after[-1]], 1)]
    vertices = np.concatenate([grid.reshape(-1, 3), grid[[0, -1]].mean(1)])
    return clean((vertices, np.concatenate(faces).astype(np.int32)))


def flat(polygon: Any, place: Callable[[Floats], Floats]) -> Shape:
    """A sheet: shapely polygons, holes and all, cut into triangles and put in space by `place` ((n, 2) to (n, 3)).

    It faces the side from which the polygon's first axis turns to its second by the left.
    """
    from shapely import get_parts, remove_repeated_points

    out = []
    for part in get_parts(remove_repeated_points(polygon, 1e-9)):
        if part.geom_type != "Polygon" or part.area < 1e-9:
            continue
        rings, tri, area = shapes.earcut(part)
        out.append((place(np.concatenate(rings)), tri[area > 1e-10].astype(np.int32)))
    return join(*out)


@dataclass(frozen=True, slots=True, eq=False)
class Skin:
    """A sheet through a lattice of points, which may have holes; between four of them it is flat, or two triangles.

    Args:
        u: rising coordinates of the lattice along its first axis (k).
        v: along its second (m); the sheet faces the side from which u turns to v by the left.
        points: where they lie (k, m, 3) [m].
    """

    u: Floats
    v: Floats
    points: Floats

    def place(self, uv: Floats) -> Floats:
        """Points (n, 3) of the sheet [m] at coordinates (n, 2)."""
        from scipy.interpolate import RegularGridInterpolator

        return np.asarray(RegularGridInterpolator((self.u, self.v), self.points)(uv))

    def mesh(self, holes: Sequence[Any] = ()) -> Shape:
        """The sheet without holes: shapely polygons in (u, v)."""
        from shapely import box, intersects, union_all

        gone = union_all(list(holes))
        low, high = (np.stack(np.meshgrid(*ends, indexing="ij"), axis=-1)
                     for ends in ((self.u[:-1], self.v[:-1]), (self.u[1:], self.v[1:])))  # fmt: skip
        cells = box(low[..., 0], low[..., 1], high[..., 0], high[..., 1])
        cut = intersects(gone, cells)
        at = np.arange(self.points[..., 0].size).reshape(self.points.shape[:2])
        quads = np.stack([at[:-1, :-1], at[1:, :-1], at[1:, 1:], at[:-1, 1:]], axis=-1)[~cut]
        whole = self.points.reshape(-1, 3), np.concatenate([quads[:, [0, 1, 2]], quads[:, [0, 2, 3]]]).astype(np.int32)
        return clean(join(whole, *(flat(cell - gone, self.place) for cell in cells[cut] if not gone.covers(cell))))

    def neck(self, hole: Any, outward: ArrayLike) -> Shape:
        """A closed pipe that goes from the rim of a hole as far as `outward` (3) [m], to a level end."""
        corners = np.asarray(hole.exterior.coords)
        rim = []
        for a, b in itertools.pairwise(corners):  # the rim bends where it crosses a line of the lattice
            cuts = [(k - a[i]) / (b[i] - a[i]) for i, at in enumerate((self.u, self.v)) for k in at
                    if (a[i] - k) * (b[i] - k) < 0]  # fmt: skip
            rim += [a + share * (b - a) for share in [0.0, *sorted(cuts)]]
        near, step = self.place(np.array(rim)), np.asarray(outward, float)
        length = float(np.linalg.norm(step))
        along = near @ step / length
        far = near + np.outer((along.max() + length - along) / length, step)
        return loft([near, far, np.broadcast_to(far.mean(0), far.shape)], caps=False)


def revolved(radius_m: ArrayLike, along_m: ArrayLike, segment_m: float) -> Skin:
    """A round body about z, seen from within: u runs to the right round its widest ring from +x [m], v up its profile.

    Args:
        radius_m: of the profile's points (m) [m].
        along_m: their heights (m) [m].
        segment_m: longest chord of a facet [m].
    """
    radius, height = np.asarray(radius_m, float), np.asarray(along_m, float)
    turn = np.linspace(0, 2 * np.pi, 4 * math.ceil(np.pi / 2 * radius.max() / segment_m) + 1)
    ring = np.stack([np.cos(turn), -np.sin(turn)], axis=1)
    rings = [np.column_stack([r * ring, np.full(len(ring), z)]) for r, z in zip(radius, height, strict=True)]
    along = np.concatenate([[0.0], np.cumsum(np.hypot(np.diff(radius), np.diff(height)))])
    return Skin(turn * radius.max(), along, np.stack(rings, axis=1))


def clean(mesh: Shape, *, decimals: int = 4) -> Shape:
    """The mesh on a lattice of 10^-decimals m, equal vertices merged, faces without area and unused vertices gone."""
    rounded = np.round(np.asarray(mesh[0], float), decimals) + 0.0
    vertices, where = np.unique(rounded, axis=0, return_inverse=True)
    faces = where.reshape(-1)[mesh[1]]
    a, b, c = (vertices[faces[:, k]] for k in range(3))
    faces = faces[np.linalg.norm(np.cross(b - a, c - a), axis=1) > 1e-9]
    used, faces = np.unique(faces, return_inverse=True)
    return vertices[used], faces.reshape(-1, 3).astype(np.int32)
