"""Draw random flights through random worlds: curved, clear of everything, with yaw against the course."""

from __future__ import annotations

import zlib
from pathlib import Path
from typing import Any

import numpy as np

from ullage.arrays import Bools, Floats, Ints, Longs
from ullage.data import Trajectory
from ullage.errors import InputError
from ullage.flight.wander import SmoothNoise
from ullage.geometry import rpy_quat
from ullage.specs import Rig
from ullage.world.random_worlds import plan

CLEARANCE_M, LEAST_CLEARANCE_M = 0.7, 0.4  # of the planned path and of the smoothed one
LATTICE_M, FINE_M = 0.15, 0.02
SPEED_M_S = 0.5
SPACING_M = (0.02, 0.10)  # least and greatest distance between frames
LENGTH_M = (14.0, 26.0)


def flight(kind: str, seed: int, *, volume: bool = False) -> Trajectory:
    """Draw a flight through the world of the same kind and seed.

    The flight visits places far apart in the open area, by the shortest clear path, smoothed. Frames lie 2 to 10 cm
    apart. The heading follows the course, lags it or is held.

    Args:
        kind: one of `ullage.worlds.KINDS`, or a world file.
        seed: 0 or more.
        volume: whether the flight climbs and sinks over all heights; else it stays near one.

    Raises:
        InputError: the kind is unknown, or the seed is not a whole number of 0 or more.
    """
    made = plan(kind, seed)
    rng = np.random.default_rng([made.seed, zlib.crc32(Path(kind).name.encode()), 1])
    level = _level_path(made.open_area, rng)
    spacing = rng.uniform(*SPACING_M)
    s = _arc(level)
    at = np.arange(0, s[-1], spacing)
    xy = np.stack([np.interp(at, s, level[:, k]) for k in range(2)], 1)
    z = _heights(at, made.band_m, volume, rng)
    roll, pitch = (np.radians(2) * np.sin(at / rng.uniform(0.6, 1.5) + k) for k in range(2))
    quat = rpy_quat(roll, pitch, _yaw(xy, at, made.seed, rng))
    t_ns = np.rint(at / SPEED_M_S * 1e9).astype(np.int64)
    return Trajectory(t_ns, np.column_stack([xy, z]), quat)


def rig(kind: str, seed: int) -> Rig:
    """Draw four radars for the flight of the same kind and seed: the X4M05 with its own or another antenna.

    Their pulse interval alternates, since some worlds are longer than one.

    Raises:
        InputError: the kind is unknown, or the seed is not a whole number of 0 or more.
    """
    made = plan(kind, seed)
    rng = np.random.default_rng([made.seed, zlib.crc32(Path(kind).name.encode()), 2])
    if rng.random() < 0.5:
        return Rig.preset("thesis-4", stagger_div=17)
    azimuth, elevation = rng.uniform(45, 85, 2)
    antenna = {"kind": "cosine", "azimuth_deg": azimuth, "elevation_deg": elevation}
    return Rig.preset("thesis-4", stagger_div=17, antenna=antenna)


def _arc(points: Floats) -> Floats:
    """Length along a line of points (n) [m]."""
    return np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(points, axis=0), axis=1))])


def _heights(at: Floats, band_m: tuple[float, float], volume: bool, rng: np.random.Generator) -> Floats:
    """Heights along the flight (n) [m]: near one height, or smooth climbs through the band."""
    low, high = band_m
    if not volume:
        return np.asarray(rng.uniform(low, high) + 0.03 * np.sin(at * rng.uniform(0.8, 2.0)))
    climb = rng.uniform(3.0, 7.0)
    return np.asarray((low + high) / 2 - (high - low) / 2 * np.cos(np.pi * at / climb))


def _yaw(xy: Floats, at: Floats, seed: int, rng: np.random.Generator) -> Floats:
    """Heading along the flight (n) [rad]: on the course, off it by a smooth angle, or held."""
    ahead = np.gradient(xy, axis=0)
    course = np.unwrap(np.arctan2(ahead[:, 1], ahead[:, 0]))
    style = rng.integers(3)
    off = SmoothNoise(np.radians(rng.uniform(10, 40)), 6.0, seed=seed, component=77).at(at / SPEED_M_S)[0]
    if style == 0:
        return np.asarray(course + 0.2 * off)
    if style == 1:
        return np.asarray(course + off + rng.uniform(-np.pi, np.pi))
    return np.asarray(rng.uniform(-np.pi, np.pi) + 0.5 * off)


def _level_path(area: Any, rng: np.random.Generator) -> Floats:
    """Return a smooth path (n, 2) [m] that visits places far apart in the open area."""
    from shapely import contains_xy

    region = _largest(area, CLEARANCE_M)
    low_x, low_y, high_x, high_y = region.bounds
    xs, ys = np.arange(low_x, high_x + LATTICE_M, LATTICE_M), np.arange(low_y, high_y + LATTICE_M, LATTICE_M)
    open_ = contains_xy(region, *np.meshgrid(xs, ys))
    nodes = np.stack([part[open_] for part in np.meshgrid(xs, ys)], 1)
    if len(nodes) < 12:
        raise InputError("the world leaves no room to fly", where="worlds", allowed="another seed")
    graph = lattice_graph(open_)
    line = nodes[np.concatenate(visit_far_places(graph, nodes, rng))]
    length = rng.uniform(*LENGTH_M)
    coarse = line[_arc(line) <= length]
    return _smooth(coarse, area)


def _largest(area: Any, clearance_m: float) -> Any:
    """Return the largest part of the area at a distance from its border, at a smaller one if nothing is left."""
    from shapely import get_parts

    for share in (1.0, 0.85, 0.7):
        parts = [part for part in get_parts(area.buffer(-share * clearance_m)) if part.area > 0.3]
        if parts:
            return max(parts, key=lambda part: part.area)
    raise InputError("the world leaves no room to fly", where="worlds", allowed="another seed")


def lattice_graph(open_: Bools) -> Any:
    """Graph between the open nodes of a lattice and their eight neighbours, weighted by distance [steps]."""
    from scipy.sparse import coo_array

    number = np.full(open_.shape, -1)
    number[open_] = np.arange(open_.sum())
    rows, columns, weights = [], [], []
    for dy, dx in ((0, 1), (1, 0), (1, 1), (1, -1)):
        here = number[: open_.shape[0] - dy, max(-dx, 0) : open_.shape[1] - max(dx, 0)]
        there = number[dy:, max(dx, 0) : open_.shape[1] - max(-dx, 0)]
        both = (here >= 0) & (there >= 0)
        rows.append(here[both])
        columns.append(there[both])
        weights.append(np.full(both.sum(), float(np.hypot(dx, dy))))
    count = int(open_.sum())
    return coo_array((np.concatenate(weights), (np.concatenate(rows), np.concatenate(columns))), (count, count)).tocsr()


def _routes(graph: Any, start: int) -> tuple[Floats, Ints]:
    """Distance of each node from the start [steps], and the node before it on the shortest path."""
    from scipy.sparse.csgraph import dijkstra

    away, before = dijkstra(graph, directed=False, indices=[start], return_predecessors=True)
    return away[0], before[0]


def visit_far_places(
    graph: Any, nodes: Floats, rng: np.random.Generator, *, length_m: float = 1.3 * LENGTH_M[1]
) -> list[Longs]:
    """Nodes along a tour: each next place is one of those farthest from all places visited.

    Args:
        graph: of a lattice, weighted by distance [steps].
        nodes: places of its nodes (n, 2 or 3) [m].
        rng: draws the start, and among the farthest places.
        length_m: the tour ends once it is so long, or everywhere has been reached [m].

    Returns:
        The start, then the nodes of each segment, the last of which is the place visited.
    """
    here = int(rng.integers(len(nodes)))
    far, _ = _routes(graph, here)
    here = int(np.argmax(np.where(np.isfinite(far), far, -1)))
    legs, nearest, travelled = [np.array([here])], np.full(len(nodes), np.inf), 0.0
    while travelled * LATTICE_M < length_m:
        away, before = _routes(graph, here)
        reached = np.isfinite(away)
        nearest = np.minimum(nearest, away)
        worth = np.where(reached, nearest, -1.0) * rng.uniform(0.6, 1.0, len(nodes))
        goal = int(np.argmax(worth))
        if goal == here or not reached[goal]:
            break
        if nearest[goal] * LATTICE_M < 1.0:  # everywhere has been visited: forget, and fly another round
            nearest = np.where(reached, away, np.inf)
        leg = [goal]
        while leg[-1] != here:
            leg.append(int(before[leg[-1]]))
        legs.append(np.array(leg[-2::-1]))
        travelled += float(away[goal])
        here = goal
    return legs


def _smooth(coarse: Floats, area: Any) -> Floats:
    """Return the path as a fine smooth line, smoothed less if it would come too near to an obstacle."""
    from scipy.ndimage import gaussian_filter1d
    from shapely import contains_xy

    s = _arc(coarse)
    fine = np.arange(0, s[-1], FINE_M)
    line = np.stack([np.interp(fine, s, coarse[:, k]) for k in range(2)], 1)
    inner = area.buffer(-LEAST_CLEARANCE_M)
    out = line
    for sigma_m in (0.6, 0.4, 0.25, 0.12):
        out = gaussian_filter1d(line, sigma_m / FINE_M, axis=0, mode="nearest")
        if contains_xy(inner, out).all():
            break
    return np.asarray(out)
