"""Loops over ways by flat mirrors to other things, and back: where they go, what becomes of the field."""

from __future__ import annotations

import math

from ullage.kernels.bounces import reflect_field
from ullage.kernels.edges import mirror
from ullage.kernels.lit import spot as shortest
from ullage.kernels.loops import core, lean
from ullage.kernels.outlines import held
from ullage.kernels.vectors import field_across, mirrored, unit_to

PLANES = 20  # of the beams of both legs of a way: five for each of two mirrors


@lean(nogil=True, error_model="numpy")
def lead(faces, origins, frames, normals, offsets, spheres, across, first, starts, images, turned, planes, counts,  # type: ignore[no-untyped-def]
         reach, box):  # fmt: skip
    """Where ways (n) over mirrors lead: images of the antennas, and the beams that come through the mirrors' boxes.

    Args:
        faces: (n, 2, 2) mirrors of each leg from its antenna on, -1 for none.
        origins: (2, 3) antennas [m]; frames: (2, 3, 3) sensor_from_world.
        normals: (p, 3), offsets: (p), spheres: (p, 4), across: (p, 2, 3), first: (p + 1), starts: (e, 3) of the faces.
        images: (n, 2, 3, 3) gets each antenna, then its images, the last one again where there are fewer [m].
        turned: (n, 2, 3, 3) gets the frames of the last images.
        planes: (n, PLANES, 4) gets planes within which, where plane . (x, 1) >= 0, all lies that a way can reach.
        counts: (n) gets how many.
        reach: (n) gets the mean of both legs at the least [m]; box: (2, 2), scratch.
    """
    for i in range(len(faces)):
        counts[i], reach[i] = 0, 0.0
        for side in range(2):
            for k in range(3):
                for row in range(3):
                    turned[i, side, row, k] = frames[side, row, k]
                for step in range(3):
                    images[i, side, step, k] = origins[side, k]
            begin, least = counts[i], 0.0
            for step in range(2):
                p = faces[i, side, step]
                if p < 0:
                    break
                n, apex = normals[p], images[i, side, step + 1]
                mirror(images[i, side, step], n, offsets[p], apex)
                for k in range(3):
                    images[i, side, 2, k] = apex[k]
                for row in range(3):
                    mirrored(n, turned[i, side, row])
                for w in range(begin, counts[i]):  # those of the mirror before, as seen in this one
                    along = 0.0
                    for k in range(3):
                        along += planes[i, w, k] * n[k]
                    for k in range(3):
                        planes[i, w, k] -= 2 * along * n[k]
                    planes[i, w, 3] += 2 * along * offsets[p]
                _box(across[p], starts, first[p], first[p + 1], box)
                counts[i] = _beam(apex, n, offsets[p], across[p], box, planes[i], counts[i])
                gap, square = -offsets[p], 0.0
                for k in range(3):
                    gap += n[k] * apex[k]
                    square += (spheres[p, k] - apex[k]) ** 2
                least = max(math.sqrt(square) - spheres[p, 3], abs(gap))
            reach[i] += 0.5 * least


@core(nogil=True, error_model="numpy")
def _box(axes, starts, begin, end, box):  # type: ignore[no-untyped-def]
    """Least and greatest places (2, 2) of the corners of a rim along two axes (2, 3)."""
    for a in range(2):
        box[a, 0], box[a, 1] = math.inf, -math.inf
        for e in range(begin, end):
            place = axes[a, 0] * starts[e, 0] + axes[a, 1] * starts[e, 1] + axes[a, 2] * starts[e, 2]
            box[a, 0], box[a, 1] = min(box[a, 0], place), max(box[a, 1], place)


@core(nogil=True, error_model="numpy")
def _beam(apex, n, offset, axes, box, planes, made):  # type: ignore[no-untyped-def]
    """Adds the planes of what an image shines on through a box (2, 2) along axes (2, 3) in its mirror; their count."""
    gap = n[0] * apex[0] + n[1] * apex[1] + n[2] * apex[2] - offset
    sign = -1.0 if gap > 0 else 1.0
    for k in range(3):
        planes[made, k] = sign * n[k]
    planes[made, 3] = -sign * offset
    made += 1
    if abs(gap) < 1e-6:
        return made
    for a in range(2):
        here = axes[a, 0] * apex[0] + axes[a, 1] * apex[1] + axes[a, 2] * apex[2]
        for end in range(2):
            # across the mirror a point at depth z behind the image may lie within z / |gap| of the box's side
            inward = 1.0 if end == 0 else -1.0
            slope = -inward * (box[a, end] - here) / abs(gap)
            size = math.sqrt(1 + slope * slope)
            d = 0.0
            for k in range(3):
                planes[made, k] = (inward * axes[a, k] + slope * sign * n[k]) / size
                d -= planes[made, k] * apex[k]
            planes[made, 3] = d
            made += 1
    return made


@core(nogil=True, error_model="numpy")
def _stops(i, point, faces, images, normals, offsets, first, starts, ends, side, out):  # type: ignore[no-untyped-def]
    """Corners (4, 3) of one leg of way i to a point: antenna, at the mirrors, point. How many mirrors it has.

    -1 where a mirror does not stand between an image and what it mirrors to, or is passed beside its rim.
    """
    count = 0
    while count < 2 and faces[i, side, count] >= 0:
        count += 1
    for k in range(3):
        out[0, k] = images[i, side, 0, k]
        out[count + 1, k] = point[k]
    for step in range(count, 0, -1):
        p = faces[i, side, step - 1]
        before, here, there = -offsets[p], -offsets[p], -offsets[p]
        for k in range(3):
            before += normals[p, k] * images[i, side, step - 1, k]
            here += normals[p, k] * images[i, side, step, k]
            there += normals[p, k] * out[step + 1, k]
        if before * there <= 0:
            return -1
        share = here / (here - there)
        for k in range(3):
            out[step, k] = images[i, side, step, k] + share * (out[step + 1, k] - images[i, side, step, k])
        if not held(out[step], p, normals, first, starts, ends):
            return -1
    return count


@lean(nogil=True, error_model="numpy")
def corners(points, at, of, side, made, legs, faces, images, normals, offsets, first, starts, ends, known, rows, stops,  # type: ignore[no-untyped-def]
            free, a, b, owner):  # fmt: skip
    """Where one leg of ways to points meets its mirrors, and which stretches must be free; each leg to a point once.

    Args:
        points: (n, 3) [m]; at: (m) and of: (m) point and way of each pair.
        side: 0 for the way there, 1 for the way back; made: how many legs to points are known.
        legs: (w, 2) numbers of the legs; legs that are alike have one.
        faces, images: as in `lead`.
        normals: (p, 3), offsets: (p), first: (p + 1), starts: (e, 3), ends: (e, 3) of the faces.
        known: (l, n) row of each leg to each point, negative where it is not known; more are.
        rows: (m, 2) gets the row of this leg of each pair that is free so far.
        stops: (q, 4, 3) gets the corners of each new row: antenna, at the mirrors, point [m].
        free: (q) gets whether every mirror is met, from in front and within its rim; for pairs only rows[:, 1] is used.
        a, b: (3 m, 3) get ends of the stretches of new rows [m]: those to points first, all others at the back.
        owner: (3 m) gets their rows.

    Returns:
        How many rows there are, and how many stretches to points and others.
    """
    count, others = 0, 0
    for j in range(len(of)):
        if side == 0 and not free[rows[j, 1]]:
            continue
        i, p = of[j], at[j]
        row = known[legs[i, side], p]
        if row < 0:
            row = made
            made += 1
            known[legs[i, side], p] = row
            over = _stops(i, points[p], faces, images, normals, offsets, first, starts, ends, side, stops[row])
            free[row] = over >= 0
            for step in range(over + 1):
                if step < over:
                    others += 1
                place = count if step == over else len(a) - others
                for k in range(3):
                    a[place, k], b[place, k] = stops[row, step, k], stops[row, step + 1, k]
                owner[place] = row
            count += 1 if over >= 0 else 0
        rows[j, side] = row
    return made, count, others


@core(nogil=True, error_model="numpy")
def _followed(stops, faces, field, normals, object_ids, widths, wavelength, gamma, last, wave):  # type: ignore[no-untyped-def]
    """The field (3) of an antenna at the end of one leg (4, 3) over its mirrors (2), and what share of it they cover.

    `last` (3) gets the direction in which it comes.
    """
    count, total, before, cover = 0, 0.0, 0.0, 1.0
    while count < 2 and faces[count] >= 0:
        count += 1
    for step in range(count + 1):
        total += unit_to(stops[step], stops[step + 1], last)
    size = unit_to(stops[0], stops[1], last)
    along = field[0] * last[0] + field[1] * last[1] + field[2] * last[2]
    square = 0.0
    for k in range(3):
        square += (field[k] - along * last[k]) ** 2
    for k in range(3):
        wave[k] = (field[k] - along * last[k]) / max(math.sqrt(square), 1e-9)
    for step in range(count):
        p = faces[step]
        before += size
        zone = math.sqrt(wavelength * before * max(total - before, 0.0) / max(total, 1e-9))
        slope = abs(normals[p, 0] * last[0] + normals[p, 1] * last[1] + normals[p, 2] * last[2])
        for k in range(2):
            cover *= min(1.0, widths[p, k] * math.sqrt(slope) / max(zone, 1e-9))
        reflect_field(gamma, object_ids[p], normals[p], last, wave)
        size = unit_to(stops[step + 1], stops[step + 2], last)
    return cover


@lean(nogil=True, error_model="numpy")
def weigh(  # type: ignore[no-untyped-def]
    stops, rows, todo, of, faces, fields, normals, object_ids, widths, wavelength, gamma, owned, out, units, waves
):
    """What the bounces of each way make of a wave, by polarisation; the point's is that of a mirror for these legs.

    Args:
        stops: (q, 4, 3) as `corners` gives them [m]; rows: (m, 2) those of both legs to each point.
        todo: (k) which points to do; of: (m) way to each.
        faces: (n, 2, 2) mirrors of each leg from its antenna on, -1 for none.
        fields: (2, 3) unit fields of the antennas.
        normals: (p, 3), object_ids: (p) and widths: (p, 2) of the faces [m].
        wavelength: [m].
        gamma: (s, taps, 2, c) reflection over cos(incidence), TE and TM; only the first tap bounces.
        owned: (m) object of each point.
        out: (m) gets the factor of the points to do.
        units, waves: (3, 3), (2, 3) complex, scratch.
    """
    sent, taken, between, there, back = units[0], units[1], units[2], waves[0], waves[1]
    for j in todo:
        i, cover = of[j], 1.0
        cover *= _followed(
            stops[rows[j, 0]], faces[i, 0], fields[0], normals, object_ids, widths, wavelength, gamma, sent, there
        )
        cover *= _followed(
            stops[rows[j, 1]], faces[i, 1], fields[1], normals, object_ids, widths, wavelength, gamma, taken, back
        )
        square = 0.0
        for k in range(3):
            between[k] = sent[k] + taken[k]
            square += between[k] * between[k]
        for k in range(3):
            between[k] /= max(math.sqrt(square), 1e-9)
        reflect_field(gamma, owned[j], between, sent, there)
        out[j] = cover * (there[0] * back[0] + there[1] * back[1] + there[2] * back[2])


@lean(nogil=True, error_model="numpy")
def meet_wires(begins, stops_at, images, faces, gate, fields, normals, offsets, object_ids, widths, first, starts, ends,  # type: ignore[no-untyped-def]
           wavelength, gamma, of, on, waves, turns, scratch, field):  # fmt: skip
    """Which wires each way can reach within the gate at their points of shortest path, and what becomes of the field.

    Args:
        begins, stops_at: (w, 3) ends of the wires [m].
        images, faces: as in `lead`.
        gate: largest mean range [m]; the rest as in `corners` and `weigh`.
        of, on: (n w) get way and wire of each pair.
        waves: (n w, 2) get the factors of the cylinder's series for fields along it (TM) and across (TE).
        turns: (n w) get the angle between the way on and the way it came, about the wire [rad].
        scratch, field: (5, 4, 3), (2, 3) complex.

    Returns:
        How many pairs there are.
    """
    axis, spot, coming, part, stops = scratch[0, 0], scratch[0, 1], scratch[1], scratch[2], scratch[3:]
    count = 0
    for w in range(len(begins)):
        size = unit_to(begins[w], stops_at[w], axis)
        for i in range(len(images)):
            path = shortest(begins[w], axis, size, images[i, 0, 2], images[i, 1, 2], spot)
            if path > 2 * gate:
                continue
            cover, met = 1.0, True
            for side in range(2):
                if met:
                    over = _stops(i, spot, faces, images, normals, offsets, first, starts, ends, side, stops[side])
                    met = over >= 0
                if met:
                    cover *= _followed(
                        stops[side],
                        faces[i, side],
                        fields[side],
                        normals,
                        object_ids,
                        widths,
                        wavelength,
                        gamma,
                        coming[side],
                        field[side],
                    )
            if not met:
                continue
            along, across = complex(cover, 0.0), complex(cover, 0.0)
            for side in range(2):
                field_across(axis, coming[side], part[0])
                _cross(axis, coming[side], part[1])
                wave = field[side]
                along *= wave[0] * part[0, 0] + wave[1] * part[0, 1] + wave[2] * part[0, 2]
                across *= wave[0] * part[1, 0] + wave[1] * part[1, 1] + wave[2] * part[1, 2]
            across = -across  # the wave goes on against the way in which the receiver's would come
            field_across(coming[0], axis, part[0])
            field_across(coming[1], axis, part[1])
            cosine = -(part[0, 0] * part[1, 0] + part[0, 1] * part[1, 1] + part[0, 2] * part[1, 2])
            of[count], on[count] = i, w
            waves[count, 0], waves[count, 1] = along, across
            turns[count] = math.acos(min(max(cosine, -1.0), 1.0))
            count += 1
    return count


@core(nogil=True, error_model="numpy")
def _cross(a, b, out):  # type: ignore[no-untyped-def]
    """The unit vector across two others."""
    x, y, z = a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]
    size = max(math.sqrt(x * x + y * y + z * z), 1e-12)
    out[0], out[1], out[2] = x / size, y / size, z / size
