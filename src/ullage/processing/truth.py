"""True surfaces on a grid, and those that the radars could have seen; for metrics only, never for processing."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ullage.antenna import boresight_pattern
from ullage.arrays import Bools, Floats, Longs
from ullage.data import Frames, Recording, Trajectory, sensors_of
from ullage.errors import InputError
from ullage.geometry import quat_matrix
from ullage.grids import Grid
from ullage.world.raycast import Raycaster
from ullage.world.scene import Scene
from ullage.world.section import section, wire_section

SPECULAR_RAD = np.radians(10.0)
OBLIQUE_RAD = np.radians(75.0)
LOOK_M, LOOK_RAD = 0.05, np.radians(4.0)
EYES = 80
MOST_POINTS, SEED = 400_000, 7
KRONECKER = 1 / np.array([1.32471795724474602596, 1.32471795724474602596**2])  # by the plastic number
SLACK_M = 0.02
BORDER = 1e-3
"""How far beyond a grid's border a surface still lies on it [steps]."""


@dataclass(frozen=True, slots=True, eq=False)
class Surface:
    """Points on the true surfaces, and what the flight could see of them."""

    points: Floats  # (s, 3) [m]
    normals: Floats  # (s, 3), zero for wires: they have no one normal
    object_id: Longs  # (s) into scene.objects
    looks: Longs  # (s) views in beam, in range, in line of sight and near enough to the normal
    seen: Bools  # (s) in beam, in range and in line of sight at least once, at any incidence
    in_view: Bools  # (s) in range and in line of sight from the flight in any direction: what a lidar there would see
    corners: Floats  # (c, 3) corners of triangles on a volume: surface too, but not spread by area [m]

    def observable(self, min_looks: int) -> Bools:
        """Mark the points that at least this many views could see."""
        return np.asarray(self.looks >= min_looks)


def spaced_looks(path: Trajectory, *, step_m: float = LOOK_M, turn_rad: float = LOOK_RAD) -> Longs:
    """Indices of poses that lie at least a step or a turn after the one before."""
    keep = [0]
    ahead = quat_matrix(path.quat_xyzw)[:, :, 0]
    for i in range(1, len(path)):
        moved = np.linalg.norm(path.position[i] - path.position[keep[-1]]) >= step_m
        if moved or ahead[i] @ ahead[keep[-1]] <= np.cos(turn_rad):
            keep.append(i)
    return np.asarray(keep, np.int64)


class NoSurfaceError(InputError):
    """No surface of a scene lies on a grid, so that nothing can be compared there."""


def true_path(frames: Frames) -> Trajectory:
    """Return the true poses of the sensor, as far as known."""
    return frames.believed if frames.truth is None else frames.truth


def surface_of(scene: Scene, grid: Grid, frames: Recording, *, spacing_m: float | None = None) -> Surface:
    """Sample the true surfaces on the grid and count the views that could see each point.

    Raises:
        NoSurfaceError: nothing of the scene lies on the grid.
    """
    parts = sensors_of(frames)
    plane = grid.at_height(float(np.mean(np.concatenate([true_path(p).position[:, 2] for p in parts]))))
    spacing = (min(0.025, grid.step_m / 2) if grid.dims == 2 else grid.step_m / 2) if spacing_m is None else spacing_m
    points, normals, owner = (_slice if grid.dims == 2 else _volume)(scene, plane, spacing)
    inside = _on_grid(plane, points)
    points, normals, owner = points[inside], normals[inside], owner[inside]
    if not len(points):
        height = f" at z = {plane.origin_m[2]:.2f} m" if plane.dims == 2 else ""
        raise NoSurfaceError(f"no surface of the scene lies on the grid{height}", where=scene.name)
    looks, seen = np.zeros(len(points), np.int64), np.zeros(len(points), bool)
    caster = Raycaster(scene)
    smooth = np.array([8 * o.material.roughness_m < parts[0].spec.wavelength_m for o in scene.objects])[owner]
    for part in parts:
        _count_looks(part, caster, points, normals, smooth, looks, seen)
    reach_m = max(float(part.range_m[-1]) for part in parts)
    in_view = seen.copy()
    in_view[~seen] = in_sight(scene, frames, points[~seen], reach_m=reach_m, slack_m=SLACK_M)
    corners = np.unique(scene.corners().reshape(-1, 3), axis=0) if grid.dims == 3 else np.zeros((0, 3))
    return Surface(points, normals, owner, looks, seen, in_view, corners[_on_grid(plane, corners)])


def _on_grid(grid: Grid, points: Floats) -> Bools:
    """Return whether each point is on the grid with its whole border, since walls of a room are often just there."""
    low = np.asarray(grid.origin_m)[: grid.dims]
    high = low + grid.step_m * np.asarray(grid.shape)[::-1]
    hair, mine = BORDER * grid.step_m, points[:, : grid.dims]
    return np.asarray(np.all((mine >= low - hair) & (mine <= high + hair), axis=1))


def _count_looks(
    frames: Frames,
    caster: Raycaster,
    points: Floats,
    normals: Floats,
    smooth: Bools,
    looks: Longs,
    seen: Bools,
) -> None:
    path = true_path(frames)
    ahead = quat_matrix(path.quat_xyzw)[:, :, 0]
    beam = half_beam_rad(frames)
    limit = np.where(smooth & (frames.ray_model is None), np.cos(SPECULAR_RAD), np.cos(OBLIQUE_RAD))
    round_ones, columns = np.asarray(~normals.any(axis=1)), np.ascontiguousarray(points.T)
    for i in spaced_looks(path):
        near = _in_beam(columns, path.position[i], ahead[i], float(frames.range_m[-1]), beam)
        ray = points[near] - path.position[i]
        ray /= np.maximum(np.sqrt(np.einsum("ij,ij->i", ray, ray)), 1e-9)[:, None]
        facing = round_ones[near] | (abs(np.einsum("ij,ij->i", ray, normals[near])) >= limit[near])
        wanted = np.flatnonzero(facing | ~seen[near])
        clear = wanted[caster.visible(path.position[i], points[near[wanted]], slack_m=SLACK_M)]
        seen[near[clear]] = True
        looks[near[clear[facing[clear]]]] += 1


def half_beam_rad(frames: Frames) -> float:
    """Half opening of a sensor's beam: of the thesis' fan of rays, else where its antenna has fallen by 3 dB."""
    if frames.ray_model:
        return float(np.radians(frames.ray_model.fov_deg) / 2)
    return boresight_pattern(frames.spec.antenna).half_power_rad


def _in_beam(columns: Floats, eye: Floats, ahead: Floats, reach: float, half_rad: float) -> Longs:
    """Indices of the points, given as columns (3, p), in the beam and in range; most points are in neither."""
    x, y, z = columns
    along = x * ahead[0]
    along += y * ahead[1]
    along += z * ahead[2]
    along -= eye @ ahead
    front = np.flatnonzero(along >= min(np.cos(half_rad), 0.0) * 2 * reach)
    square = (x[front] - eye[0]) ** 2 + (y[front] - eye[1]) ** 2 + (z[front] - eye[2]) ** 2
    lit = (along[front] >= np.cos(half_rad) * np.sqrt(square)) & (square <= reach**2)
    return np.asarray(front[lit], np.int64)


def _slice(scene: Scene, plane: Grid, spacing: float) -> tuple[Floats, Floats, Longs]:
    z = float(plane.origin_m[2])
    corners = scene.corners()
    above = corners[:, :, 2] > z
    cut = np.flatnonzero(above.any(1) & ~above.all(1))
    lines = section(scene, z)
    counts = np.maximum(np.ceil(np.linalg.norm(lines[:, 1] - lines[:, 0], axis=1) / spacing), 1).astype(int)
    which = np.repeat(np.arange(len(lines)), counts)
    share = (np.arange(counts.sum()) - np.repeat(np.cumsum(counts) - counts, counts) + 0.5) / np.repeat(counts, counts)
    flat = lines[which, 0] + share[:, None] * (lines[which, 1] - lines[which, 0])
    normal = _normals(corners[cut])[which]
    owner = scene.face_object[cut][which].astype(np.int64)
    wires = wire_section(scene, z)
    near = _nearest_wire(scene, wires, z)
    xy = np.concatenate([flat, wires])
    return (
        np.column_stack([xy, np.full(len(xy), z)]),
        np.concatenate([normal, np.zeros((len(wires), 3))]),
        np.concatenate([owner, near]),
    )


def _nearest_wire(scene: Scene, points: Floats, z: float) -> Longs:
    if not len(points):
        return np.zeros(0, np.int64)
    a, b = scene.wires.start, scene.wires.end
    rise = b[:, 2] - a[:, 2]
    share = np.clip((z - a[:, 2]) / np.where(abs(rise) > 1e-9, rise, 1.0), 0, 1)
    at = (a + share[:, None] * (b - a))[:, :2]
    closest = np.argmin(np.linalg.norm(points[:, None] - at[None], axis=2), axis=1)
    return np.asarray(scene.wires.object_id[closest], np.int64)


def _normals(corners: Floats) -> Floats:
    cross = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    return np.asarray(cross / np.maximum(np.linalg.norm(cross, axis=1, keepdims=True), 1e-12))


def _volume(scene: Scene, grid: Grid, spacing: float) -> tuple[Floats, Floats, Longs]:
    """Points spread evenly over the area of all surfaces: equal areas hold equal counts, whatever their triangles.

    One point for each `spacing` squared, at most MOST_POINTS in all. Wires count with the area of their mantle. Each
    object has at least one point.
    """
    corners, wires = scene.corners(), scene.wires
    area = np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1) / 2
    mantle = 2 * np.pi * wires.radius_m * np.linalg.norm(wires.end - wires.start, axis=1)
    measure = np.concatenate([area, mantle])
    owner = np.concatenate([scene.face_object, wires.object_id]).astype(np.int64)
    if not measure.sum() > 0:
        return np.zeros((0, 3)), np.zeros((0, 3)), np.zeros(0, np.int64)
    most = max(MOST_POINTS - len(scene.objects), 1)
    piece = _even_picks(measure, min(most, int(np.ceil(measure.sum() / spacing**2))))
    left_out = np.setdiff1d(owner, owner[piece])
    extra = [int(np.argmax(np.where(owner == one, measure, -1.0))) for one in left_out]
    piece = np.concatenate([piece, np.array(extra, np.int64)])
    points, normals = _points_on(scene, corners, piece)
    return points, normals, owner[piece]


def _even_picks(measure: Floats, count: int) -> Longs:
    """Indices (count) of pieces, each as often as its measure says: one draw from each of `count` equal strata."""
    edges = np.cumsum(measure)
    drawn = (np.arange(count) + np.random.default_rng(SEED).random(count)) * (edges[-1] / count)
    return np.asarray(np.minimum(np.searchsorted(edges, drawn, side="right"), len(measure) - 1), np.int64)


def _points_on(scene: Scene, corners: Floats, piece: Longs) -> tuple[Floats, Floats]:
    """A point on each piece, triangles first, then wires; those on one piece are spread by a Kronecker sequence."""
    order = np.argsort(piece, kind="stable")
    rank = np.empty(len(piece), np.int64)
    rank[order] = np.arange(len(piece)) - np.searchsorted(piece[order], piece[order])
    start = np.random.default_rng(SEED).random((len(corners) + len(scene.wires), 2))
    share = (start[piece] + rank[:, None] * KRONECKER) % 1.0
    points, normals = np.zeros((len(piece), 3)), np.zeros((len(piece), 3))
    on_face = piece < len(corners)
    face, (s, t) = piece[on_face], share[on_face].T
    s, t = np.where(s + t > 1, 1 - s, s), np.where(s + t > 1, 1 - t, t)
    a = corners[face, 0]
    points[on_face] = a + s[:, None] * (corners[face, 1] - a) + t[:, None] * (corners[face, 2] - a)
    normals[on_face] = _normals(corners)[face]
    wire = piece[~on_face] - len(corners)
    begin = scene.wires.start[wire]
    points[~on_face] = begin + share[~on_face, :1] * (scene.wires.end[wire] - begin)
    return points, normals


def in_sight(
    scene: Scene, frames: Recording, points: Floats, *, eyes: int = EYES, reach_m: float = np.inf, slack_m: float = 1e-3
) -> Bools:
    """Return whether each point (p, 3) is visible from any place of the flight, in any direction and at any incidence.

    Args:
        scene: what hides points.
        frames: one sensor's, or several.
        points: asked about (p, 3) [m].
        eyes: places of the flight that are tried.
        reach_m: range of sight [m].
        slack_m: what lies so near before a point does not hide it: the surface that the point is on [m].
    """
    spots = np.concatenate([true_path(p).position for p in sensors_of(frames)])
    spots = spots[np.linspace(0, len(spots) - 1, min(eyes, len(spots))).astype(int)]
    caster = Raycaster(scene)
    seen = np.zeros(len(points), bool)
    for spot in spots:
        todo = np.flatnonzero(~seen)
        if not len(todo):
            break
        todo = todo[np.linalg.norm(points[todo] - spot, axis=1) <= reach_m]
        seen[todo[caster.visible(spot, points[todo], slack_m=slack_m)]] = True
    return seen
