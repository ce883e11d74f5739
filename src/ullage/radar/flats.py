"""Echoes of large flat faces: their mirror images, less what runs along their rims."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ullage.kernels import edges as kernel
from ullage.kernels import rims as draw
from ullage.radar.facets import Flats, Surfaces
from ullage.radar.folding import limits_of
from ullage.radar.physical import Bench, Laid, View, common, each, shading

Floats = NDArray[np.float64]
Complexes = NDArray[np.complex128]
Ints = NDArray[np.int32]
Longs = NDArray[np.int64]

_NUDGE_M = 5e-3
_RINGS = np.arange(6) * np.pi / 3
_ZONE = np.concatenate(
    [[[0.0, 0.0]], *(q * np.stack([np.cos(_RINGS + q), np.sin(_RINGS + q)], 1) for q in (0.4, 0.75))]
)


@dataclass(frozen=True, slots=True, eq=False)
class Rim:
    """The rims of faces as `edges.cut` parts them: pieces, and the ends of what is not cut."""

    pieces: Floats  # (m, 12)
    owner: Ints  # (m) face of each piece
    tips: Floats  # (n, 9)
    holders: Ints  # (n) face of each end
    ties: Ints  # (n) piece that goes on from each end, -1 for none
    windings: Floats  # (k) turns of each face's rim around the axis


def parted(count: int, edges: int, fill: Callable[[Floats, Ints, Floats, Ints, Ints, Floats], tuple[int, int]]) -> Rim:
    """Runs the kernel that parts the rims of `count` faces of `edges` edges, again where there was too little room."""
    rooms = [2048 + 4 * edges, 1024 + 2 * edges]
    windings = np.empty(count)
    while True:
        pieces, owner = np.empty((rooms[0], 12)), np.empty(rooms[0], np.int32)
        tips, holders, ties = np.empty((rooms[1], 9)), np.empty(rooms[1], np.int32), np.empty(rooms[1], np.int32)
        made, ends = fill(pieces, owner, tips, holders, ties, windings)
        if made <= rooms[0] and ends <= rooms[1]:
            return Rim(pieces[:made], owner[:made], tips[:ends], holders[:ends], ties[:ends], windings)
        rooms = [max(rooms[0], int(1.2 * made)), max(rooms[1], int(1.2 * ends))]


def rims(ready: Bench, flats: Flats, view: View, which: Longs, limits: Floats) -> Rim:
    """The rims of some faces, each as far as its limit (p) [m]."""
    return parted(len(which), len(flats.starts), lambda *room: kernel.cut(
        which, flats.spheres, flats.normals, flats.offsets, flats.first, flats.starts, flats.ends,
        view.origins[None], limits, 1e9, ready.pulse.omega, ready.whole_rims, *room))  # fmt: skip


def lay_flats(
    ready: Bench,
    parts: list[Surfaces],
    part: Surfaces,
    view: View,
    grids: Complexes,
) -> tuple[Laid, ...]:
    """Adds the echoes of flat faces within the frame, and of those beyond that fold back into it."""
    flats = part.flats
    opaque = ~ready.sheets.thin[flats.stuffs]
    which = np.flatnonzero(~part.flat_backs.hidden(view.origins, opaque))
    if not len(which):
        return ()
    limits = limits_of(flats, view, ready.gate[1], ready.fold_s)
    rim = rims(ready, flats, view, which, limits)
    told = flats.normals, flats.stuffs, *each(common(ready, view, grids))
    points, lengths = np.empty((len(which), 3)), np.empty(len(which))
    count = draw.crossings(which, rim.windings, flats.normals, flats.offsets, view.origins[None], limits, points,
                           lengths)  # fmt: skip
    points, lengths, which = points[:count], lengths[:count], which[:count]
    looks, seats, open_ = _looks(ready, flats, rim, points, which, lengths)
    shade, extra = shading(ready, parts, view, np.concatenate(looks))
    ends = np.cumsum([len(look) for look in looks])[:-1]
    piece, free, zone = zip(np.split(shade, ends), np.split(extra, ends), strict=True)
    corner = tuple(np.concatenate(pair)[seats] for pair in zip(piece, free, strict=True))
    bright, when = np.empty(count, complex), np.empty(count)
    draw.lay_images(points, which, lengths, *_mean(zone, open_), *told, bright, when)
    return (*lay_rim(rim, piece, corner, told), Laid(flats.stuffs[which], points, bright, when))


def lay_rim(
    rim: Rim, piece: tuple[Complexes, Floats], corner: tuple[Complexes, Floats], told: tuple[Any, ...]
) -> tuple[Laid, Laid]:
    """Lays a rim with factor and delay [s] of what stands before its pieces and ends; stuffs are those of faces."""
    echo, delay = np.empty(len(rim.pieces), complex), np.empty(len(rim.pieces))
    draw.lay_rims(rim.pieces, rim.owner, *piece, *told, echo, delay)
    ends, late = np.empty(len(rim.tips), complex), np.empty(len(rim.tips))
    draw.lay_tips(rim.tips, rim.holders, *corner, *told, ends, late)
    stuffs, middle = told[1], 0.5 * (rim.pieces[:, :3] + rim.pieces[:, 3:6])
    return Laid(stuffs[rim.owner], middle, echo, delay), Laid(stuffs[rim.holders], rim.tips[:, :3], ends, late)


def _looks(
    ready: Bench, flats: Flats, rim: Rim, points: Floats, which: Longs, lengths: Floats
) -> tuple[list[Floats], Longs, NDArray[np.bool_]]:
    """Where to look: pieces and ends of rims, and the first Fresnel zone around each mirror point (k, _ZONE) [m].

    Ends from which a piece goes on are seen where it is. Also of each end, which of all pieces and looks at ends it is
    seen by, and which points of the zones lie on their faces (k, _ZONE).
    """
    free = rim.ties < 0
    lone = rim.tips[free]
    seats = np.where(free, len(rim.pieces) - 1 + np.cumsum(free), rim.ties)
    spots, corners = np.empty((len(rim.pieces), 3)), np.empty((len(lone), 3))
    draw.look_at(rim.pieces, rim.owner, flats.normals, _NUDGE_M, spots)
    draw.look_at_tips(lone, _NUDGE_M, corners)
    radius = np.sqrt(ready.spec.wavelength_m * lengths / 4)[:, None, None]
    spread = _ZONE @ flats.across[which]
    zone = (points[:, None] + radius * spread).reshape(-1, 3)
    within = np.empty(len(zone), np.bool_)
    draw.inside(zone, np.repeat(which, len(_ZONE)), flats.normals, flats.first, flats.starts, flats.ends, within)
    held = within.reshape(len(points), len(_ZONE))
    held[:, 0] = True
    return [spots, corners, zone], seats, held


def _mean(zone: tuple[Complexes, Floats], held: NDArray[np.bool_]) -> tuple[Complexes, Floats]:
    """Mean factor and delay over the part of each zone that lies on its face."""
    share = held.sum(1)
    shade, extra = ((a.reshape(held.shape) * held).sum(1) / share for a in zone)
    return shade, extra
