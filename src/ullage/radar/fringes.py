"""Echoes of the edges of conductors, beyond physical optics: each edge by itself, and waves from edge to edge."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ullage.geometry import C0
from ullage.kernels import double_fringe, fringe, lines
from ullage.kernels import wires as string
from ullage.radar import diffraction
from ullage.radar import double_diffraction as double
from ullage.radar.facets import Surfaces
from ullage.radar.physical import KAPPA, REACH, Bench, Laid, View, common, grown, shading

Floats = NDArray[np.float64]
Ints = NDArray[np.int32]
Longs = NDArray[np.int64]
Complexes = NDArray[np.complex128]

FAINT = 10 ** (-150 / 20)
"""Edges that cannot return more are left out, as path gain amplitude."""

_COARSE = 2.0  # pieces of edges may be longer than facets: their bow is in the closed form
_NUDGE_M = 5e-3  # an edge is looked at this far out in its open side


def lay_edges(ready: Bench, parts: list[Surfaces], view: View, t_ns: int, grids: Complexes) -> list[Laid]:
    """Adds the echoes of conducting edges at one pose to the delay grids."""
    edges, pairs = ready.rims.edges, ready.rims.pairs
    if any(thing.motion is not None for thing in ready.world.scene.objects):
        edges = diffraction.placed(edges, ready.world.scene, t_ns)
        pairs = double.placed(pairs, ready.world.scene, t_ns)
    wave, centre = ready.pulse.omega / C0, view.origins.mean(0)
    lit = diffraction.facing(edges, ready.rims.sheets, centre)
    alone = _parted(ready, view, edges.starts, edges.ends, _heard(ready, view, edges.starts, edges.ends, lit))
    width = np.linalg.norm(pairs.gaps, axis=1)
    above = np.einsum("ni,ni->n", pairs.normals, centre - pairs.starts)
    starts, ends = pairs.starts + pairs.gaps / 2, pairs.ends + pairs.gaps / 2
    heard = _heard(ready, view, starts, ends, (above > 0) | ready.rims.bare,
                   4 / np.sqrt(2 * np.pi * wave * np.maximum(width, 1e-6)))  # fmt: skip
    over, of = _cut(ready, view, starts, ends, heard, KAPPA)
    side = np.where(above[of] < 0, -_NUDGE_M, _NUDGE_M)[:, None]
    outward = _NUDGE_M * edges.outward
    shade, extra = shading(ready, parts, view, np.concatenate([
        alone.pieces.mean(1) + outward[alone.owner], alone.tips[:, :3] + outward[alone.holders],
        over.mean(1) + side * pairs.normals[of]]))  # fmt: skip
    ends_of = np.cumsum([len(alone.owner), len(alone.holders)])
    piece, corner, across = zip(np.split(shade, ends_of), np.split(extra, ends_of), strict=True)
    over -= pairs.gaps[of, None] / 2
    return [*_lay_fringes(ready, view, edges, alone, piece, corner, grids),
            _lay_doubles(ready, view, pairs, over, of, across, grids)]  # fmt: skip


@dataclass(frozen=True, slots=True, eq=False)
class Parted:
    """Lines as `lines.part` parts them: pieces near where the path is shortest, and the ends of what is left."""

    pieces: Floats  # (m, 2, 3) [m]
    owner: Ints  # (m) line of each piece
    tips: Floats  # (n, 5)
    holders: Ints  # (n) line of each end
    ties: Longs  # (n) piece that goes on from each end, -1 for none


def _heard(
    ready: Bench, view: View, starts: Floats, ends: Floats, lit: NDArray[np.bool_], factors: Floats | None = None
) -> Longs:
    """Which lit lines can be heard; `factors` are strengths over that of an edge by itself, of waves across a face."""
    which = np.flatnonzero(lit)
    out = np.empty(len(which), np.bool_)
    strong = np.ones(len(which)) if factors is None else factors[which]
    fringe.audible(starts[which], ends[which], strong, factors is not None, view.origins, view.frames, view.fields,
                   ready.table, ready.spec.antenna.kind == "isotropic", ready.pulse.omega / C0, np.array(ready.gate),
                   FAINT, out)  # fmt: skip
    return np.asarray(which[out])


def _cut(ready: Bench, view: View, starts: Floats, ends: Floats, which: Longs, fine: float) -> tuple[Floats, Ints]:
    """Pieces (m, 2, 3) of some lines within the gate, and the line of each."""
    if not len(which):
        return np.zeros((0, 2, 3)), np.zeros(0, np.int32)
    pieces, owner = grown(1024, (2, 3), lambda out, of: string.cut_wires(
        starts[which], ends[which], view.origins, np.array(ready.gate), fine * ready.spec.wavelength_m, REACH, out,
        of))  # fmt: skip
    return pieces, which[owner].astype(np.int32)


def _parted(ready: Bench, view: View, starts: Floats, ends: Floats, which: Longs) -> Parted:
    """Some lines within the gate, most of them by their ends."""
    if ready.whole_rims:
        pieces, owner = _cut(ready, view, starts, ends, which, _COARSE * KAPPA)
        return Parted(pieces, owner, np.zeros((0, 5)), np.zeros(0, np.int32), np.zeros(0, np.int64))
    near, held = np.empty((len(starts), 2, 3)), np.zeros(len(starts), np.bool_)
    some, open_ = np.empty((len(which), 2, 3)), np.empty(len(which), np.bool_)
    tips, holders = np.empty((4 * len(which), 5)), np.empty(4 * len(which), np.int32)
    sides = np.empty(4 * len(which), np.int32)
    count = lines.part(starts[which], ends[which], view.origins, np.array(ready.gate), ready.pulse.omega / C0, some,
                       open_, tips, holders, sides)  # fmt: skip
    near[which], held[which] = some, open_
    pieces, owner = _cut(ready, view, near[:, 0], near[:, 1], which[open_], _COARSE * KAPPA)
    holders, sides = which[holders[:count]].astype(np.int32), sides[:count]
    # pieces of a line come from its end to its start
    ties = np.where(sides == 0, np.searchsorted(owner, holders, "right") - 1, np.searchsorted(owner, holders))
    cut = sides < 0
    cut |= owner[np.clip(ties, 0, len(owner) - 1)] == holders if len(owner) else False
    return Parted(pieces, owner, tips[:count][cut], holders[cut], np.where(sides < 0, -1, ties)[cut])


def _lay_fringes(
    ready: Bench,
    view: View,
    edges: diffraction.Edges,
    alone: Parted,
    piece: tuple[Complexes, Floats],
    corner: tuple[Complexes, Floats],
    grids: Complexes,
) -> list[Laid]:
    tied = alone.ties >= 0
    for of_tip, of_piece in zip(corner, piece, strict=True):
        of_tip[tied] = of_piece[alone.ties[tied]]
    told = common(ready, view, grids)
    told = edges.angles, edges.inward, edges.normals, ready.rims.sheets, *told[:6], *told[8:]
    echo, delay = np.empty(len(alone.owner), complex), np.empty(len(alone.owner))
    fringe.lay_fringes(alone.pieces, alone.owner, *piece, *told, echo, delay)
    tip, late = np.empty(len(alone.holders), complex), np.empty(len(alone.holders))
    fringe.lay_tips(alone.tips, alone.holders, *corner, *told, tip, late)
    return [Laid(edges.stuffs[alone.owner], alone.pieces.mean(1), echo, delay),
            Laid(edges.stuffs[alone.holders], alone.tips[:, :3], tip, late)]  # fmt: skip


def _lay_doubles(
    ready: Bench,
    view: View,
    pairs: double.Pairs,
    pieces: Floats,
    owner: Ints,
    across: tuple[Complexes, Floats],
    grids: Complexes,
) -> Laid:
    echo, delay = np.empty(len(pieces), complex), np.empty(len(pieces))
    told = common(ready, view, grids)
    double_fringe.lay_doubles(pieces, owner, *across, pairs.gaps, pairs.angles, pairs.inward, pairs.normals,
                              ready.rims.both, *told[:6], *told[8:], echo, delay)  # fmt: skip
    return Laid(pairs.stuffs[owner], pieces.mean(1) + pairs.gaps[owner] / 2, echo, delay)
