"""Loops over rays: exact distances behind Embree's float32 hits, and the ray histogram of the thesis' model."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ullage.arrays import Complexes, Floats, Ints, Longs, Singles
from ullage.kernels.loops import lean

_NOWHERE = 1e9  # [m]


class Rays(NamedTuple):
    """Rays (n)."""

    origin: Floats  # (n, 3) [m]
    direction: Floats  # (n, 3) unit vectors


class EmbreeHits(NamedTuple):
    """What rays (n) hit first in one body, as Embree gives it."""

    prim: NDArray[np.integer]  # (n) number of the triangle, beyond the last one or negative for none
    tfar: Singles  # (n) distance [m]


class MeshFaces(NamedTuple):
    """Faces (k) of a body."""

    corner: Floats  # (k, 3) one corner of each [m]
    normal: Floats  # (k, 3) unit normals
    ids: Ints  # (k) number of each face in the scene


class RoundWires(NamedTuple):
    """Round wires (w), for which Embree has prisms."""

    first: int  # number of the first prism's first triangle
    per_wire: int  # triangles of each prism
    start: Floats  # (w, 3) [m]
    axis: Floats  # (w, 3) unit vectors
    length: Floats  # (w) [m]
    radius: Floats  # (w) [m]
    ids: Ints  # (w) number of each wire in the scene


class NearestHits(NamedTuple):
    """What rays, of any shape, hit first of all."""

    face: Ints  # number of the face in the scene, -1 for none
    distance: Floats  # [m]
    cosine: Floats  # cos(incidence)


class SheetWalk(NamedTuple):
    """Rays (n) under way through thin sheets."""

    points: Longs  # (n) point that each ray leads to
    lengths: Floats  # (n) distance of the point [m]
    passed: Floats  # (n) distance covered [m]
    rays: Floats  # (n, 3) unit vectors


class MetSheets(NamedTuple):
    """The sheet that each ray (n) meets next."""

    distance: Floats  # (n) [m]
    object_id: NDArray[np.integer]  # (n)
    cosine: Floats  # (n) cos(incidence)


class SheetTable(NamedTuple):
    """What sheets (s) let through, there and back, over cos(incidence)."""

    factor: Complexes  # (s, c)
    delay_s: Floats  # (s, c) [s]


class RangeBins(NamedTuple):
    """Ranges that count, and the range bins that they fall into."""

    near_m: float  # least range [m]
    far_m: float  # greatest range [m]
    start_m: float  # range of the first bin [m]
    bin_m: float  # width of a bin [m]


@lean()
def refine_faces(hits: EmbreeHits, rays: Rays, mesh: MeshFaces, nearest: NearestHits) -> None:
    """Put the hits of one body into `nearest` where they are nearer than what is there.

    The float32 distance `tfar` only chooses between the plane and itself: where the float64 distance of the plane is
    far from it (slivers, rays along a face) it is kept.

    Args:
        hits: `EmbreeHits` (n).
        rays: `Rays` (n).
        mesh: `MeshFaces`.
        nearest: `NearestHits` (n), updated.
    """
    prim, tfar = hits
    for i in range(len(prim)):
        p = prim[i]
        if p < 0 or p >= len(mesh.corner):
            continue
        along = 0.0
        gap = 0.0
        for k in range(3):
            along += mesh.normal[p, k] * rays.direction[i, k]
            gap += mesh.normal[p, k] * (mesh.corner[p, k] - rays.origin[i, k])
        reach = float(tfar[i])
        t = reach
        if abs(along) > 1e-9:
            exact = gap / along
            if abs(exact - reach) <= 1e-5 * (1.0 + reach) / max(abs(along), 1e-3):
                t = max(exact, 0.0)
        if t < nearest.distance[i]:
            nearest.face[i] = mesh.ids[p]
            nearest.distance[i] = t
            nearest.cosine[i] = min(abs(along), 1.0)


@lean()
def aim(
    starts: Floats,
    ends: Floats,
    centre: Floats,
    before: float,
    after: float,
    origin: Singles,
    ray: Singles,
    reach: Singles,
) -> None:
    """Aim float32 rays about `centre` between points (1 or n, 3) and (n, 3), short of them by `before` and `after`."""
    for i in range(len(ends)):
        s = i if len(starts) > 1 else 0
        dx, dy, dz = ends[i, 0] - starts[s, 0], ends[i, 1] - starts[s, 1], ends[i, 2] - starts[s, 2]
        length = math.sqrt(dx * dx + dy * dy + dz * dz)
        per = 1.0 / max(length, 1e-12)
        dx, dy, dz = dx * per, dy * per, dz * per
        origin[i, 0] = starts[s, 0] + before * dx - centre[0]
        origin[i, 1] = starts[s, 1] + before * dy - centre[1]
        origin[i, 2] = starts[s, 2] + before * dz - centre[2]
        ray[i, 0], ray[i, 1], ray[i, 2] = dx, dy, dz
        reach[i] = length - before - after
        if reach[i] <= 0:  # nothing counts: a ray without length would still meet the face that it starts on
            origin[i, 0], reach[i] = _NOWHERE, 0.0


@lean()
def refine_wires(hits: EmbreeHits, rays: Rays, wires: RoundWires, nearest: NearestHits) -> None:
    """Put the hits of round wires into `nearest`: distance and normal are those of the cylinder, not of its prism.

    Args:
        hits: `EmbreeHits` (n).
        rays: `Rays` (n).
        wires: `RoundWires`.
        nearest: `NearestHits` (n), updated.
    """
    prim, tfar = hits
    origin, direction = rays
    start, axis, length, radius = wires.start, wires.axis, wires.length, wires.radius
    for i in range(len(prim)):
        if prim[i] < wires.first:
            continue
        w = (prim[i] - wires.first) // wires.per_wire
        ax, ay, az = axis[w, 0], axis[w, 1], axis[w, 2]
        dx, dy, dz = direction[i, 0], direction[i, 1], direction[i, 2]
        ox, oy, oz = origin[i, 0] - start[w, 0], origin[i, 1] - start[w, 1], origin[i, 2] - start[w, 2]
        d_along = dx * ax + dy * ay + dz * az
        o_along = ox * ax + oy * ay + oz * az
        px, py, pz = dx - d_along * ax, dy - d_along * ay, dz - d_along * az
        qx, qy, qz = ox - o_along * ax, oy - o_along * ay, oz - o_along * az
        a = px * px + py * py + pz * pz
        b = px * qx + py * qy + pz * qz
        t = float(tfar[i])
        c = abs(d_along)
        if a > 1e-12:
            root = max(b * b - a * (qx * qx + qy * qy + qz * qz - radius[w] ** 2), 0.0)
            exact = (-b - math.sqrt(root)) / a
            s = o_along + exact * d_along
            if exact >= 0.0 and -1e-9 <= s <= length[w] + 1e-9 and abs(exact - t) <= 2.0 * radius[w] / math.sqrt(a):
                t = exact
                c = math.sqrt(root) / radius[w]
        if t < nearest.distance[i]:
            nearest.face[i] = wires.ids[w]
            nearest.distance[i] = t
            nearest.cosine[i] = min(c, 1.0)


@lean(error_model="numpy")
def pass_transmissive(
    walk: SheetWalk, met: MetSheets, table: SheetTable, slack: float, last: bool, factor: Complexes, late: Floats
) -> int:
    """Take rays through the sheets that they meet next, and drop those that meet none before their points.

    Args:
        walk: `SheetWalk` (n), updated: those that are left come first.
        met: `MetSheets` (n).
        table: `SheetTable`.
        slack: sheets nearer to the point than this do not count, and the next one begins twice as far on [m].
        last: whether rays that still meet a sheet are lost.
        factor: (p) of the points, multiplied by what the sheets let through.
        late: (p) delays of the points [s], added to.

    Returns:
        How many are left.
    """
    todo, lengths, passed, rays = walk
    through, delays = table
    count, n = 0, through.shape[1] - 1
    for i in range(len(todo)):
        here = passed[i] + met.distance[i]
        if not here < lengths[i] - slack:
            continue
        point = todo[i]
        todo[count], lengths[count], passed[count] = point, lengths[i], here + 2 * slack
        for k in range(3):
            rays[count, k] = rays[i, k]
        count += 1
        if last:
            factor[point] = 0
            continue
        place = min(met.cosine[i] * n, n - 1e-3)
        low = int(place)
        u, sheet = place - low, met.object_id[i]
        factor[point] *= through[sheet, low] * (1 - u) + through[sheet, low + 1] * u
        late[point] += delays[sheet, low] * (1 - u) + delays[sheet, low + 1] * u
    return count


@lean()
def turn_fan(fan: Floats, rotation: Floats, out: Floats) -> None:
    """Turn the directions of a fan (m, 3) by n rotations (n, 3, 3); `out` (n, m, 3) gets them."""
    for f in range(len(rotation)):
        r = rotation[f]
        for i in range(len(fan)):
            x, y, z = fan[i, 0], fan[i, 1], fan[i, 2]
            for k in range(3):
                out[f, i, k] = r[k, 0] * x + r[k, 1] * y + r[k, 2] * z


@lean()
def accumulate(hits: NearestHits, reflection: Floats, ranges: RangeBins, out: Floats) -> None:
    """Sum I_m cos(theta) (|v| / far_m)^2 of rays into range bins.

    Args:
        hits: `NearestHits` (n, m).
        reflection: amplitude of each face of the scene.
        ranges: `RangeBins`.
        out: (n, b), added to.
    """
    face, distance, cosine = hits
    frames, bins = out.shape
    for f in range(frames):
        for i in range(face.shape[1]):
            r = distance[f, i]
            if face[f, i] < 0 or r < ranges.near_m or r > ranges.far_m:
                continue
            k = int(np.floor((r - ranges.start_m) / ranges.bin_m + 0.5))
            if 0 <= k < bins:
                out[f, k] += reflection[face[f, i]] * cosine[f, i] * (r / ranges.far_m) ** 2


@lean()
def smooth(values: Floats, weights: Floats, out: Floats) -> None:
    """Sum rows (n, b) over an odd, centred window with weights; beyond the ends all is zero."""
    half = len(weights) // 2
    rows, bins = values.shape
    for f in range(rows):
        for k in range(bins):
            total = 0.0
            for j in range(max(0, k - half), min(bins, k + half + 1)):
                total += weights[j - k + half] * values[f, j]
            out[f, k] = total
