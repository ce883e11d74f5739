"""Echoes of the edges of conductors, beyond physical optics: each edge by itself, and waves from edge to edge."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from ullage.arrays import Bools, Complexes, Floats, Ints, Longs
from ullage.geometry import C0
from ullage.kernels import double_fringe, fringe, lines
from ullage.kernels import wires as string
from ullage.radar import diffraction
from ullage.radar import double_diffraction as double
from ullage.radar.context import KAPPA, REACH, Bench, View, common, grown, shading
from ullage.radar.facets import Surfaces
from ullage.radar.laid import Laid, laid_by

FAINT = 10 ** (-150 / 20)
"""Edges that cannot return more are left out, as path gain amplitude."""

_COARSE = 2.0  # pieces of edges may be longer than facets: their bow is in the closed form
_NUDGE_M = 5e-3  # an edge is looked at this far out in its open side


def lay_edges(ready: Bench, parts: list[Surfaces], view: View, poses: Floats | None, grids: Complexes) -> list[Laid]:
    """Adds the echoes of conducting edges at one pose to the delay grids; `poses` (o, 4, 4) of objects if any moves."""
    edges, pairs = diffraction.placed(ready.rims.edges, poses), double.placed(ready.rims.pairs, poses)
    centre = (view.origins[0] + view.origins[1]) / 2
    lit = diffraction.facing(edges, ready.rims.sheets, centre)
    alone = _parted(ready, view, edges.starts, edges.ends, _heard(ready, view, edges.starts, edges.ends, lit))
    above = np.einsum("ni,ni->n", pairs.normals, centre - pairs.starts)
    lit = (above > 0) | ready.rims.bare
    starts, ends = pairs.starts + pairs.gaps / 2, pairs.ends + pairs.gaps / 2
    heard = _heard(ready, view, starts, ends, lit, ready.rims.strong)
    over, of = _cut(ready, view, starts[heard], ends[heard], KAPPA)
    of = heard[of].astype(np.int32)
    side = np.where(above[of] < 0, -_NUDGE_M, _NUDGE_M)[:, None]
    outward = diffraction.outward(edges, np.concatenate([alone.owner, alone.holders])) * _NUDGE_M
    free = alone.ties < 0
    cut = len(alone.owner)
    seats = np.concatenate([np.arange(cut), np.where(free, cut - 1 + np.cumsum(free), alone.ties)])
    shade, extra = shading(ready, parts, view, np.concatenate([
        _middles(alone.pieces) + outward[:cut], alone.tips[free, 0] + outward[cut:][free],
        _middles(over) + side * pairs.normals[of]]))  # fmt: skip
    count = len(shade) - len(of)
    across = shade[count:], extra[count:]
    over -= pairs.gaps[of, None] / 2
    return [_lay_fringes(ready, view, edges, alone, (shade[seats], extra[seats]), grids),
            _lay_doubles(ready, view, pairs, over, of, across, grids)]  # fmt: skip


def _middles(pieces: Floats) -> Floats:
    return 0.5 * (pieces[:, 0] + pieces[:, 1])


@dataclass(frozen=True, slots=True, eq=False)
class Parted:
    """Lines as `lines.part` parts them: pieces near where the path is shortest, and the ends of what is left."""

    pieces: Floats  # (m, 2, 3) [m]
    owner: Ints  # (m) line of each piece
    tips: Floats  # (n, 2, 3) as `lines.part` gives them
    holders: Ints  # (n) line of each end
    ties: Longs  # (n) piece that goes on from each end, -1 for none


def _heard(ready: Bench, view: View, starts: Floats, ends: Floats, lit: Bools, factors: Floats | None = None) -> Longs:
    """Which lit lines can be heard; `factors` are strengths over that of an edge by itself, of waves across a face."""
    strong = np.ones(len(lit)) if factors is None else factors
    heard = np.zeros(len(lit), np.bool_)
    for side in (slice(None),) if (view.origins[0] == view.origins[1]).all() else (slice(None), slice(None, None, -1)):
        out = np.empty(len(lit), np.bool_)
        one, turn, field = (np.ascontiguousarray(row[side])[None] for row in (view.origins, view.frames, view.fields))
        fringe.audible(starts, ends, lit, strong, factors is not None, one, turn, field, ready.table,
                       ready.spec.antenna.kind == "isotropic", ready.pulse.omega / C0, np.array(ready.gate), FAINT,
                       np.empty(3), out)  # fmt: skip
        heard |= out
    return np.flatnonzero(heard)


def _cut(ready: Bench, view: View, starts: Floats, ends: Floats, fine: float) -> tuple[Floats, Ints]:
    """Pieces (m, 2, 3) of some lines within the gate, and the line of each."""
    gate, fresnel = np.array(ready.gate), fine * ready.spec.wavelength_m
    return grown(1024, (2, 3), lambda out, of: string.cut_wires(
        starts, ends, view.origins[None], gate, fresnel, REACH, out, of))  # fmt: skip


def _parted(ready: Bench, view: View, starts: Floats, ends: Floats, which: Longs) -> Parted:
    """Some of the lines, as far as they lie within the gate, most of them by their ends."""
    starts, ends = starts[which], ends[which]
    if ready.whole_rims:
        pieces, owner = _cut(ready, view, starts, ends, _COARSE * KAPPA)
        return Parted(
            pieces, which[owner].astype(np.int32), np.zeros((0, 2, 3)), np.zeros(0, np.int32), np.zeros(0, np.int64)
        )
    near, held = np.empty((len(starts), 2, 3)), np.empty(len(starts), np.bool_)
    tips, holders = np.empty((4 * len(starts), 2, 3)), np.empty(4 * len(starts), np.int32)
    sides = np.empty(4 * len(starts), np.int32)
    count = lines.part(starts, ends, view.origins, np.array(ready.gate), ready.pulse.omega / C0, near, held, tips,
                       holders, sides)  # fmt: skip
    tips, holders, sides = tips[:count], holders[:count], sides[:count]
    some = np.flatnonzero(held)
    pieces, owner = _cut(ready, view, np.ascontiguousarray(near[some, 0]), np.ascontiguousarray(near[some, 1]),
                         _COARSE * KAPPA)  # fmt: skip
    owner = some[owner].astype(np.int32)
    # pieces of a line come from its end to its start
    ties = np.where(sides == 0, np.searchsorted(owner, holders, "right") - 1, np.searchsorted(owner, holders))
    cut = sides < 0
    cut |= owner[np.clip(ties, 0, len(owner) - 1)] == holders if len(owner) else False
    return Parted(pieces, which[owner].astype(np.int32), tips[cut], which[holders[cut]].astype(np.int32),
                  np.where(sides < 0, -1, ties)[cut])  # fmt: skip


def _lay_fringes(
    ready: Bench,
    view: View,
    edges: diffraction.Edges,
    alone: Parted,
    seen: tuple[Complexes, Floats],
    grids: Complexes,
) -> Laid:
    told, (shade, extra) = common(ready, view, grids), seen
    owner = np.concatenate([alone.owner, alone.holders])

    def put(shade: Complexes, grids: Complexes, *out: Any) -> None:
        fringe.lay_fringes(alone.pieces, alone.tips, owner, shade, extra, edges.angles, edges.inward, edges.normals,
                           ready.rims.sheets, *told[:6], *told[8:-1], grids, *out, np.empty((4, 3)))  # fmt: skip

    points = np.concatenate([_middles(alone.pieces), alone.tips[:, 0]])
    return laid_by(put, shade, grids, edges.stuffs[owner], points)


def _lay_doubles(
    ready: Bench,
    view: View,
    pairs: double.Pairs,
    pieces: Floats,
    owner: Ints,
    across: tuple[Complexes, Floats],
    grids: Complexes,
) -> Laid:
    told, (shade, extra) = common(ready, view, grids), across

    def put(shade: Complexes, grids: Complexes, *out: Any) -> None:
        double_fringe.lay_doubles(pieces, owner, shade, extra, pairs.gaps, pairs.angles, pairs.inward, pairs.normals,
                                  ready.rims.both, *told[:6], *told[8:-1], grids, *out, np.empty((3, 3)))  # fmt: skip

    return laid_by(put, shade, grids, pairs.stuffs[owner], _middles(pieces) + pairs.gaps[owner] / 2)
