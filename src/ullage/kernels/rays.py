"""Loops over rays: exact distances behind Embree's float32 hits, and the ray histogram of the thesis' model."""

from __future__ import annotations

import math

import numpy as np

from ullage.kernels.loops import lean

_NOWHERE = 1e9  # [m]


@lean(nogil=True)
def refine_faces(prim, tfar, origin, direction, corner, normal, ids, face, distance, cosine):  # type: ignore[no-untyped-def]
    """Put the hits of one body into `face`, `distance` and `cosine` where they are nearer than what is there.

    The float32 distance `tfar` chooses between plane and fallback only: where the float64 plane distance is
    far from it (slivers, rays along a face) it is kept.
    """
    for i in range(len(prim)):
        p = prim[i]
        if p < 0 or p >= len(corner):
            continue
        along = 0.0
        gap = 0.0
        for k in range(3):
            along += normal[p, k] * direction[i, k]
            gap += normal[p, k] * (corner[p, k] - origin[i, k])
        reach = float(tfar[i])
        t = reach
        if abs(along) > 1e-9:
            exact = gap / along
            if abs(exact - reach) <= 1e-5 * (1.0 + reach) / max(abs(along), 1e-3):
                t = max(exact, 0.0)
        if t < distance[i]:
            face[i] = ids[p]
            distance[i] = t
            cosine[i] = min(abs(along), 1.0)


@lean(nogil=True)
def aim(starts, ends, centre, before, after, origin, ray, reach):  # type: ignore[no-untyped-def]
    """Rays between points (1 or n, 3) and (n, 3) in float32 about `centre`, short of both by `before` and `after`."""
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


@lean(nogil=True)
def refine_wires(  # type: ignore[no-untyped-def]
    prim, tfar, origin, direction, first, per_wire, start, axis, length, radius, ids, face, distance, cosine
):
    """As `refine_faces`, for prisms that stand for round wires: distance and normal are those of the cylinder."""
    for i in range(len(prim)):
        if prim[i] < first:
            continue
        w = (prim[i] - first) // per_wire
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
        if t < distance[i]:
            face[i] = ids[w]
            distance[i] = t
            cosine[i] = min(c, 1.0)


@lean(nogil=True, error_model="numpy")
def pass_transmissive(  # type: ignore[no-untyped-def]
    todo, lengths, passed, rays, distance, object_id, cosine, slack, last, through, delays, factor, late
):
    """Takes rays through the sheets that they meet next, and forgets those that meet none on their way.

    Args:
        todo, lengths, passed, rays: (n), (n) [m], (n) [m], (n, 3) point each ray leads to, how far that is, how much of
            the way is done, unit vectors; in place, those that are left first.
        distance, object_id, cosine: (n) [m], (n), (n) to the next sheet, its object, cos(incidence).
        slack: what stands so near to the point is none, and twice that lies a sheet's other side [m].
        last: whether what is left now is lost.
        through, delays: (s, c) what sheets let through, there and back, and their delay [s] over cos(incidence).
        factor, late: (p) of the points: multiplied, added to.

    Returns:
        How many are left.
    """
    count, n = 0, through.shape[1] - 1
    for i in range(len(todo)):
        here = passed[i] + distance[i]
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
        place = min(cosine[i] * n, n - 1e-3)
        low = int(place)
        u = place - low
        factor[point] *= through[object_id[i], low] * (1 - u) + through[object_id[i], low + 1] * u
        late[point] += delays[object_id[i], low] * (1 - u) + delays[object_id[i], low + 1] * u
    return count


@lean(nogil=True)
def turn_fan(fan, rotation, out):  # type: ignore[no-untyped-def]
    """Directions (n, m, 3) of a fan (m, 3) under n rotations (n, 3, 3)."""
    for f in range(len(rotation)):
        r = rotation[f]
        for i in range(len(fan)):
            x, y, z = fan[i, 0], fan[i, 1], fan[i, 2]
            for k in range(3):
                out[f, i, k] = r[k, 0] * x + r[k, 1] * y + r[k, 2] * z


@lean(nogil=True)
def accumulate(face, distance, cosine, reflection, near_m, far_m, start_m, bin_m, out):  # type: ignore[no-untyped-def]
    """Sum I_m cos(theta) (|v| / far_m)^2 of the rays (n, m) into range bins `out` (n, b)."""
    frames, bins = out.shape
    for f in range(frames):
        for i in range(face.shape[1]):
            r = distance[f, i]
            if face[f, i] < 0 or r < near_m or r > far_m:
                continue
            k = int(np.floor((r - start_m) / bin_m + 0.5))
            if 0 <= k < bins:
                out[f, k] += reflection[face[f, i]] * cosine[f, i] * (r / far_m) ** 2


@lean(nogil=True)
def smooth(values, weights, out):  # type: ignore[no-untyped-def]
    """Weighted moving sum of rows (n, b) with an odd, centred window; nothing stands beyond the ends."""
    half = len(weights) // 2
    rows, bins = values.shape
    for f in range(rows):
        for k in range(bins):
            total = 0.0
            for j in range(max(0, k - half), min(bins, k + half + 1)):
                total += weights[j - k + half] * values[f, j]
            out[f, k] = total
