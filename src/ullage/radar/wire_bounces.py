"""Echoes of wires by way of large flat faces: face and wire in either order, and face, wire and the same face again.

The mirror image of the radar in a face sees the wire as the radar itself does, at another angle: the line integral
along the wire is that of a direct echo from the image's place, with the cylinder's series for the angle between the two
directions. Polarisation, reflection and that angle are those at the wire's point of shortest path. A piece of
wire counts where its path meets the face within its rim and is free on all legs.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ullage.kernels import wires as string
from ullage.radar.facets import Flats, Surfaces
from ullage.radar.mirrors import across, crossing, dot, mirrored, reflected, unit
from ullage.radar.multipath import chosen_faces
from ullage.radar.physical import KAPPA, REACH, Bench, Laid, View, common, grown
from ullage.radar.visibility import between
from ullage.radar.wires import placed, scattered

Floats = NDArray[np.float64]
Complexes = NDArray[np.complex128]
Longs = NDArray[np.int64]

FACES = 3
"""Only so many faces, those that look largest, mirror wires."""
MOST = 500
"""In worlds of more flat faces wires do not bounce: it would cost a fifth of a frame of the cargo hold."""
_BENT = ((True, False), (False, True), (True, True))
"""Whether the way there and the way back go over the face."""


@dataclass(frozen=True, slots=True, eq=False)
class _Way:
    """Over which face, with which weight, and which of both legs."""

    face: int
    weight: float
    bent: tuple[bool, bool]
    ends: Floats  # (2, 3) where the wire sees transmitter and receiver, mirrored or not [m]


def lay_wire_bounces(
    ready: Bench, parts: list[Surfaces], flats: Flats, view: View, poses: Floats | None, max_bounces: int,
    grids: Complexes,
) -> list[Laid]:  # fmt: skip
    """Adds the echoes of wires over one flat face to the delay grids, over it twice where three bounces are asked."""
    if not 0 < len(flats) <= MOST:
        return []
    starts, ends = placed(ready.lines, poses)
    faces, weights = chosen_faces(ready, flats, view)
    away = flats.spheres[faces, :3] - view.origins[0]
    looks = flats.spheres[faces, 3] / np.maximum(np.sqrt(dot(away, away)), 1e-3) * weights[faces]
    faces = faces[np.argsort(-looks)[:FACES]]
    out = []
    same = bool((view.origins[0] == view.origins[1]).all())  # there over the face and back over it are one wave, twice
    for bent in _BENT[: 3 if max_bounces > 2 else 2]:
        if same and bent == (False, True):
            continue
        times = 2.0 if same and not all(bent) else 1.0
        at = np.stack([mirrored(o, flats, faces) if b else np.broadcast_to(o, (len(faces), 3))
                       for o, b in zip(view.origins, bent, strict=True)], 1)  # fmt: skip
        spot, held = _held(flats, faces, bent, at, view, starts, ends, ready.gate[1])
        for row in np.flatnonzero(held.any(1)):
            face = int(faces[row])
            way = _Way(face, times * float(weights[face]), bent, at[row])
            laid = _lay(ready, parts, flats, view, way, np.flatnonzero(held[row]), spot[row], (starts, ends), grids)
            out += [laid] if laid is not None else []
    return out


def _held(
    flats: Flats, faces: Longs, bent: tuple[bool, bool], at: Floats, view: View, starts: Floats, ends: Floats,
    gate_m: float,
) -> tuple[Floats, NDArray[np.bool_]]:  # fmt: skip
    """Points of shortest path (f, w, 3) on each wire by way of each face, and whether that way meets the face."""
    along = ends - starts
    size = np.linalg.norm(along, axis=1)
    along /= size[:, None]
    gap = at[:, :, None] - starts  # (f, 2, w, 3)
    z = np.einsum("fswi,wi->fsw", gap, along)
    h = np.sqrt(np.maximum(np.einsum("fswi,fswi->fsw", gap, gap) - z**2, 1e-12))
    place = np.clip((z[:, 0] * h[:, 1] + z[:, 1] * h[:, 0]) / (h[:, 0] + h[:, 1]), 0, size)
    spot = starts + place[..., None] * along
    held = np.linalg.norm(spot[:, None] - at[:, :, None], axis=3).sum(1) <= 2 * gate_m
    for side in range(2):
        if bent[side]:
            f, w = np.nonzero(held)
            _, met = crossing(flats, faces[f], at[f, side], view.origins[side], spot[f, w])
            held[f, w] = met
    return spot, held


def _lay(
    ready: Bench, parts: list[Surfaces], flats: Flats, view: View, way: _Way, which: Longs, spot: Floats,
    placed_: tuple[Floats, Floats], grids: Complexes,
) -> Laid | None:  # fmt: skip
    lines, origins = ready.lines, np.ascontiguousarray(way.ends)
    starts, ends = (np.ascontiguousarray(p[which]) for p in placed_)
    pieces, owner = grown(2048, (2, 3), lambda out, of: string.cut_wires(
        starts, ends, origins, np.array(ready.gate), KAPPA * ready.spec.wavelength_m, REACH, out, of))  # fmt: skip
    middle = pieces.mean(1)
    free = np.ones(len(pieces), bool)
    for side in range(2):
        seen_from = np.broadcast_to(view.origins[side], middle.shape)
        if way.bent[side]:
            faces = np.full(len(middle), way.face, np.int64)
            corner, met = crossing(
                flats, faces, np.broadcast_to(origins[side], middle.shape), view.origins[side], middle
            )
            free &= met
            free[free] = between(parts, seen_from[free], corner[free])
            seen_from = corner
        free[free] = between(parts, seen_from[free], middle[free])
    if not free.any():
        return None
    series = np.zeros((len(which), *lines.series.shape[1:]), complex)
    lit = np.unique(owner[free])
    series[lit] = _series(ready, flats, view, way, lines.modes[which[lit]], unit(ends - starts)[lit], spot[which[lit]])
    n, frames = flats.normals[way.face], view.frames.copy()
    for side in range(2):
        if way.bent[side]:
            frames[side] -= 2 * np.outer(frames[side] @ n, n)
    seen = View(origins, frames, view.fields, view.factor * way.weight)
    echo, delay = np.empty(len(pieces), complex), np.empty(len(pieces))
    told: tuple[Any, ...] = common(ready, seen, grids)
    string.lay_wires(pieces, owner, free.astype(complex), np.zeros(len(pieces)), lines.radii[which], series, *told[:6],
                     *told[8:], echo, delay)  # fmt: skip
    stuffs = lines.stuffs[which][owner]
    via = np.tile(np.array([flats.stuffs[way.face], flats.stuffs[way.face] if all(way.bent) else -1]), (len(pieces), 1))
    return Laid(stuffs, middle, echo, delay, via.astype(np.int64))


def _series(
    ready: Bench, flats: Flats, view: View, way: _Way, modes: Complexes, axis: Floats, spot: Floats
) -> Complexes:
    """Series (w, 2, sines) of wires as the receiver's polarisation takes it: both rows alike."""
    n, stuff = flats.normals[way.face], int(flats.stuffs[way.face])
    coming, going = unit(spot - way.ends[0]), unit(way.ends[1] - spot)
    sent, taken = (_field(ready, view.fields[s], u, n, stuff, way.bent[s]) for s, u in ((0, coming), (1, -going)))
    cosine = dot(across(coming, axis), across(going, axis))
    tm, te = np.moveaxis(scattered(modes, np.arccos(np.clip(cosine, -1, 1))), 1, 0)
    plane = dot(sent, across(axis, coming)) * dot(taken, across(axis, going))
    level = dot(sent, unit(np.cross(axis, coming))) * dot(taken, unit(np.cross(axis, going)))
    both = plane[:, None] * tm + level[:, None] * te
    return np.stack([both, both], 1)


def _field(ready: Bench, field: Floats, u: Floats, n: Floats, stuff: int, bent: bool) -> Complexes:
    """Unit fields (w, 3) of an antenna where its wave comes to the wires along u, after its bounce if it has one.

    A receiver's is that of the wave which it would send.
    """
    first = u - 2 * (u @ n)[:, None] * n if bent else u
    start = across(np.broadcast_to(field, u.shape), first).astype(complex)
    if not bent:
        return start
    normals, stuffs = np.broadcast_to(n, u.shape), np.full(len(u), stuff)
    return reflected(ready.gamma, stuffs, start, first, normals)
