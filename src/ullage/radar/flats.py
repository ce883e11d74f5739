"""Echoes of large flat faces: their mirror images, less what runs along their rims."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ullage.arrays import Bools, Complexes, Floats, Ints, Longs
from ullage.kernels import edges as kernel
from ullage.kernels import rims as draw
from ullage.radar.context import Bench, View, common, shading
from ullage.radar.facets import Flats, Surfaces
from ullage.radar.folding import limits_of
from ullage.radar.laid import Laid, laid_by
from ullage.radar.penetration import TAPS

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

    @staticmethod
    def none(faces: int) -> Rim:
        """No rims, of so many faces that hold their mirror points."""
        none = np.zeros(0, np.int32)
        return Rim(np.zeros((0, 12)), none, np.zeros((0, 9)), none, none, np.ones(faces))


def parted(count: int, edges: int, fill: Callable[..., tuple[int, int]]) -> Rim:
    """Runs the kernel that parts the rims of `count` faces of `edges` edges, again where there was too little room."""
    rooms = [2048 + 4 * edges, 1024 + 2 * edges]
    windings = np.empty(count)
    scratch = np.empty((4, 3)), np.empty((69, 8)), np.empty((69, 2)), np.empty(3, np.int64)
    while True:
        pieces, owner = np.empty((rooms[0], 12)), np.empty(rooms[0], np.int32)
        tips, holders, ties = np.empty((rooms[1], 9)), np.empty(rooms[1], np.int32), np.empty(rooms[1], np.int32)
        made, ends = fill(pieces, owner, tips, holders, ties, windings, *scratch)
        if made <= rooms[0] and ends <= rooms[1]:
            return Rim(pieces[:made], owner[:made], tips[:ends], holders[:ends], ties[:ends], windings)
        rooms = [max(rooms[0], int(1.2 * made)), max(rooms[1], int(1.2 * ends))]


def rims(ready: Bench, flats: Flats, view: View, which: Longs, limits: Floats) -> Rim:
    """The rims of some faces, each as far as its limit (p) [m]."""
    return parted(len(which), len(flats.starts), lambda *room: kernel.cut(
        which, flats.spheres, flats.normals, flats.offsets, flats.first, flats.starts, flats.ends,
        view.origins[None], view.aside, limits, 1e9, ready.pulse.omega, ready.whole_rims, *room))  # fmt: skip


def lay_flats(
    ready: Bench,
    parts: list[Surfaces],
    part: Surfaces,
    view: View,
    grids: Complexes,
    done: Bools | None = None,
) -> list[Laid]:
    """Adds the echoes of flat faces within the frame, and of those beyond that fold back into it.

    Those that are `done` (p) otherwise are left out.
    """
    flats = part.flats
    opaque = ~ready.sheets.thin[flats.stuffs]
    hidden = part.flat_backs.hidden(view.origins, opaque)
    which = np.flatnonzero(~(hidden if done is None else hidden | done))
    if not len(which):
        return []
    limits = limits_of(flats, view, ready.gate[1], ready.fold_s)
    rim = rims(ready, flats, view, which, limits)
    told = flats.normals, flats.stuffs, *common(ready, view, grids)
    return [lay_parted(ready, flats, which, rim, limits, lambda at, _: shading(ready, parts, view, at), told)[0]]


Shading = Callable[[Floats, NDArray[np.integer]], tuple[Complexes, Floats]]
"""Factor (m) and delay (m) [s] of what stands before points (m, 3), told the face (m) of each."""


@dataclass(frozen=True, slots=True, eq=False)
class Outlined:
    """Of flat faces what their echoes are done by."""

    normals: Floats  # (p, 3)
    offsets: Floats  # (p) [m]
    spheres: Floats  # (p, 4) [m]
    across: Floats  # (p, 2, 3)
    first: Ints  # (p + 1)
    starts: Floats  # (e, 3) [m]
    ends: Floats  # (e, 3) [m]


def lay_parted(
    ready: Bench,
    flats: Flats | Outlined,
    which: Longs,
    rim: Rim,
    limits: Floats,
    shading_of: Shading,
    told: tuple[Any, ...],
) -> tuple[Laid, Longs]:
    """Adds the echoes of some faces whose rims are parted: of their mirror points, pieces and ends.

    What the kernel that lays them is `told` begins with normals, stuffs and origins. Gives the face of each echo too.
    """
    points = np.empty((len(which), 9))
    count = draw.crossings(which, rim.windings, flats.normals, flats.offsets, told[2], limits, points)
    points, which = points[:count], which[:count]
    looks, owner, seats, open_ = _looks(ready, flats, rim, points, which)
    shade, extra = shading_of(looks, owner)
    if len(points):
        factor, late = _mean(shade[len(shade) - open_.size :], extra[len(extra) - open_.size :], open_)
        shade, extra = np.concatenate([shade[seats], factor]), np.concatenate([extra[seats], late])
    else:
        shade, extra = shade[seats], extra[seats]
    laid = lay_rim(rim, points, which, shade, extra, told)
    return laid, np.concatenate([rim.owner, rim.holders, which])


def lay_rim(
    rim: Rim, points: Floats, which: Longs, shade: Complexes, extra: Floats, told: tuple[Any, ...], /,
    stuffs: Ints | None = None, via: Longs | None = None, before: Longs | None = None,
) -> Laid:  # fmt: skip
    """Lays rims and mirror points (k, 9) with factor and delay [s] of what stands before pieces, ends and points.

    The stuffs (m) of what is laid are those of faces that `told` gives, if none are named.
    """
    owner = np.concatenate([rim.owner, rim.holders, which.astype(np.int32)])
    ends = np.concatenate([rim.tips, points])

    def put(shade: Complexes, grids: Complexes, *out: Any) -> None:
        draw.lay_rims(rim.pieces, ends, len(rim.tips), owner, shade, extra, *told[:-1], grids, *out,
                      np.empty(TAPS, complex), np.empty(TAPS))  # fmt: skip

    def places() -> Floats:
        return np.concatenate([0.5 * (rim.pieces[:, :3] + rim.pieces[:, 3:6]), ends[:, :3]])

    rays = np.zeros(len(owner), np.bool_)
    rays[len(owner) - len(points) :] = True
    stuffs = told[1][owner] if stuffs is None else stuffs
    return laid_by(put, shade, told[-1], stuffs, places, via=via, before=before, rays=rays)


def _looks(
    ready: Bench, flats: Flats | Outlined, rim: Rim, points: Floats, which: Longs
) -> tuple[Floats, Longs, Longs, Bools]:
    """Where to look: pieces and ends of rims, and the first Fresnel zone around each mirror point (k, _ZONE) [m].

    Also on which face each look lies, which of the looks each piece and end is seen by, and which points of the zones
    lie on their faces (k, _ZONE).
    """
    most, about = len(rim.pieces) + len(rim.tips), len(points) * len(_ZONE)
    spots, faces = np.empty((most + about, 3)), np.empty(most + about, np.int64)
    seats, within = np.empty(most, np.int64), np.empty((len(points), len(_ZONE)), np.bool_)
    count = draw.look_at(rim.pieces, rim.owner, rim.tips, rim.holders, rim.ties, flats.normals, _NUDGE_M, spots, faces,
                         seats)  # fmt: skip
    draw.look_about(points, which, flats.across, _ZONE, ready.spec.wavelength_m, flats.normals, flats.first,
                    flats.starts, flats.ends, spots[count:], faces[count:], within)  # fmt: skip
    return spots[: count + about], faces[: count + about], seats, within


def _mean(shade: Complexes, extra: Floats, held: Bools) -> tuple[Complexes, Floats]:
    """Mean factor and delay over the part of each zone that lies on its face."""
    share = held.sum(1)
    shade, extra = shade.reshape(held.shape), extra.reshape(held.shape)
    return np.einsum("kz,kz->k", shade, held) / share, np.einsum("kz,kz->k", extra, held) / share
