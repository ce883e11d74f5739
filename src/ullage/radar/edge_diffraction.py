"""Echoes of the edges of conductors, beyond physical optics: each edge by itself, and waves from edge to edge."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ullage.arrays import Bools, Floats, Ints, Longs
from ullage.geometry import C0
from ullage.kernels import corner_diffraction as corner_kernel
from ullage.kernels import double_edge_diffraction, edge_diffraction, edge_places, lines
from ullage.kernels import wires as string
from ullage.kernels.facets import EchoSums, Transmission
from ullage.radar import diffraction
from ullage.radar import double_diffraction as double
from ullage.radar.context import KAPPA, REACH, RadarFrame, grown
from ullage.radar.echo_set import EchoSet, echo_set

FAINT = 10 ** (-150 / 20)
"""Edges that cannot return more are left out, as path gain amplitude."""

_COARSE = 2.0  # pieces of edges may be longer than facets: their bow is in the closed form
_NUDGE_M = 5e-3  # an edge is looked at this far out in its open side


def accumulate_edges(frame: RadarFrame) -> list[EchoSet]:
    """Add the echoes of conducting edges to the delay grids."""
    outlines, poses, origins = frame.context.outlines, frame.poses, frame.antennas.origins
    edges, pairs = outlines.edges.placed(poses), outlines.pairs.placed(poses)
    corners, place = _corners(frame), 0.5 * (origins[0] + origins[1])
    alone, over, met = _alone(frame, edges, place), _over(frame, pairs, place), _receivable_corners(frame, corners)
    many, ends, across = len(alone.owner), len(alone.holders), len(over.of)
    spots = edge_places.EdgeSpots(np.empty((many + ends + across + len(met), 3)), np.empty(many + ends, np.int64))
    single = edge_places.CutEdges(
        alone.pieces, alone.owner, alone.tips, alone.holders, alone.ties, diffraction.outward(edges)
    )
    paired = edge_places.CutPairs(over.pieces, over.of, pairs.normals, over.above)
    count = edge_places.place_edges(single, paired, corners, met, place, _NUDGE_M, spots)
    last = count + across
    factor, late = frame.transmission_to(spots.places[: last + len(met)])
    beside = Transmission(factor[spots.seats], late[spots.seats])
    out = [_accumulate_edge_diffraction(frame, edges, alone, beside)]
    if across:
        out.append(_accumulate_doubles(frame, pairs, over, Transmission(factor[count:last], late[count:last])))
    if len(met):
        out.append(_accumulate_corners(frame, corners, met, Transmission(factor[last:], late[last:])))
    return out


def _alone(frame: RadarFrame, edges: diffraction.Edges, place: Floats) -> Parted:
    """Part the edges that are strong enough by themselves, seen from a place (3) [m]."""
    lit = np.empty(len(edges), np.bool_)
    edge_places.facing(
        edge_places.EdgeSides(edges.starts, edges.normals, frame.context.outlines.transmissive), place, lit
    )
    asked = edge_diffraction.EdgeLines(edges.starts, edges.ends, lit, diffraction.equal_factors(edges))
    return _parted(frame, edges.starts, edges.ends, _receivable(frame, asked, False))


@dataclass(frozen=True, slots=True, eq=False)
class Across:
    """Pieces of lines halfway between pairs of edges, and of paths that turn at an edge between."""

    pieces: Floats  # (m, 2, 3) [m]
    of: Ints  # (m) pair of each
    turns: Bools  # (m) whether the path turns
    above: Floats  # (p) height of the radar over the face of each pair [m]


def _over(frame: RadarFrame, pairs: double.Pairs, place: Floats) -> Across:
    """Cut the pairs of edges that are strong enough, seen from a place (3) [m]."""
    above, outlines = np.empty(len(pairs)), frame.context.outlines
    if not len(pairs):
        return Across(np.zeros((0, 2, 3)), np.zeros(0, np.int32), np.zeros(0, np.bool_), above)
    edge_places.heights(pairs.starts, pairs.normals, place, above)
    starts, ends = double.halfway(pairs)
    asked = edge_diffraction.EdgeLines(starts, ends, (above > 0) | outlines.bare, outlines.strong)
    receivable = _receivable(frame, asked, True)
    over, of = _cut(frame, starts[receivable], ends[receivable], KAPPA)
    of, turns = receivable[of].astype(np.int32), np.zeros(len(of), np.bool_)
    if len(of):
        over, of, turns = _with_turns(frame, pairs, receivable, over, of)
    return Across(over, of, turns, above)


def _corners(frame: RadarFrame) -> corner_kernel.Corners:
    """Give the corners of faces as kernels take them, placed in the world."""
    outlines = frame.context.outlines
    at = outlines.corners.placed(frame.poses)
    return corner_kernel.Corners(at.places, at.along, at.lengths, at.angles, at.normals, outlines.corners_bare)


def _receivable_corners(frame: RadarFrame, corners: corner_kernel.Corners) -> Longs:
    out = np.empty(len(corners.places), np.int64)
    wave, gate = frame.context.pulse.omega / C0, np.array(frame.context.gate)
    return out[: corner_kernel.audible(corners, frame.radar, wave, gate, FAINT, out)]


def _accumulate_corners(
    frame: RadarFrame, corners: corner_kernel.Corners, met: Longs, between: Transmission
) -> EchoSet:
    def put(between: Transmission, sums: EchoSums) -> None:
        pulse = frame.context.pulse_grid
        corner_kernel.accumulate_corners(met, corners, between, frame.radar, pulse, sums, np.empty((9, 3)))

    return echo_set(put, between, frame.grids, frame.context.outlines.corners.object_ids[met], corners.places[met])


def _with_turns(
    frame: RadarFrame, pairs: double.Pairs, receivable: Longs, over: Floats, of: Ints
) -> tuple[Floats, Ints, Bools]:
    """Join the pieces of pairs of edges and those of paths that turn at an edge between.

    Returns:
        The pieces (m, 2, 3) [m], the pair of each (m), and whether its path turns (m).
    """
    paired = double_edge_diffraction.PairLines(pairs.starts, pairs.ends, pairs.gaps, frame.context.outlines.closed)
    ends, pair = np.empty((len(receivable) + 1, 2, 3)), np.empty(len(receivable) + 1, np.int32)
    count = double_edge_diffraction.turning(receivable, paired, frame.antennas.origins[None], np.empty(3), ends, pair)
    turns = np.zeros(len(of) + count, np.bool_)
    if not count:
        return over, of, turns
    turns[len(of) :] = True
    return np.concatenate([over, ends[:count]]), np.concatenate([of, pair[:count]]), turns


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


def _receivable(frame: RadarFrame, asked: edge_diffraction.EdgeLines, across: bool) -> Longs:
    """Find the lit lines whose echoes are not too faint; `across`: only the electric field across them counts."""
    context, antennas, found = frame.context, frame.antennas, []
    wave, gate, scratch = context.pulse.omega / C0, np.array(context.gate), np.empty(3)
    for pair in (antennas,) if antennas.reversible else (antennas, antennas.swapped()):
        out = np.empty(len(asked.lit), np.int64)
        count = edge_diffraction.audible(asked, across, context.antennas(pair), wave, gate, FAINT, scratch, out)
        found.append(out[:count])
    return found[0] if len(found) == 1 else np.union1d(*found)


def _cut(frame: RadarFrame, starts: Floats, ends: Floats, fine: float) -> tuple[Floats, Ints]:
    """Pieces (m, 2, 3) of some lines within the gate, and the line of each."""
    gate, fresnel = np.array(frame.context.gate), fine * frame.context.spec.wavelength_m
    return grown(1024, (2, 3), lambda out, of: string.cut_wires(
        starts, ends, frame.antennas.origins[None], gate, fresnel, REACH, out, of))  # fmt: skip


def _parted(frame: RadarFrame, starts: Floats, ends: Floats, which: Longs) -> Parted:
    """Some of the lines, as far as they lie within the gate, most of them by their ends."""
    starts, ends = starts[which], ends[which]
    many, context = len(starts), frame.context
    if context.whole_outlines:
        pieces, owner = _cut(frame, starts, ends, _COARSE * KAPPA)
        owner = which[owner].astype(np.int32)
        return Parted(pieces, owner, np.zeros((0, 2, 3)), np.zeros(0, np.int32), np.zeros(0, np.int64))
    out = lines.PartedLines(np.empty((many, 2, 3)), np.empty(many, np.bool_), np.empty((4 * many, 2, 3)),
                            np.empty(4 * many, np.int32), np.empty(4 * many, np.int32))  # fmt: skip
    count = lines.part(starts, ends, frame.antennas.origins, np.array(context.gate), context.pulse.omega / C0, out)
    some = np.flatnonzero(out.held)
    near, far = (np.ascontiguousarray(out.near[some, end]) for end in range(2))
    pieces, owner = _cut(frame, near, far, _COARSE * KAPPA)
    owner, ties = some[owner].astype(np.int32), np.empty(count, np.int64)
    count = lines.tie(owner, np.empty(many + 1, np.int64), out.tips[:count], out.holders, out.sides, ties)
    holders = which[out.holders[:count]].astype(np.int32)
    return Parted(pieces, which[owner].astype(np.int32), out.tips[:count], holders, ties[:count])


def _accumulate_edge_diffraction(
    frame: RadarFrame, edges: diffraction.Edges, alone: Parted, between: Transmission
) -> EchoSet:
    owner, pulse = np.concatenate([alone.owner, alone.holders]), frame.context.pulse_grid
    wedges = edge_diffraction.Wedges(edges.angles, edges.inward, edges.normals, frame.context.outlines.transmissive)
    pieces = edge_diffraction.EdgePieces(alone.pieces, alone.tips, owner)

    def put(between: Transmission, sums: EchoSums) -> None:
        edge_diffraction.accumulate_edge_diffraction(
            pieces, wedges, between, frame.radar, pulse, sums, np.empty((4, 3))
        )

    def places() -> Floats:
        return np.concatenate([_middles(alone.pieces), alone.tips[:, 0]])

    return echo_set(put, between, frame.grids, edges.object_ids[owner], places)


def _accumulate_doubles(frame: RadarFrame, pairs: double.Pairs, over: Across, between: Transmission) -> EchoSet:
    pieces, owner = over.pieces - pairs.gaps[over.of, None] / 2, over.of
    both, pulse = frame.context.outlines.both, frame.context.pulse_grid
    faced = double_edge_diffraction.EdgePairs(
        pairs.gaps, pairs.angles, pairs.inward, pairs.normals, both, pairs.lengths
    )
    turned = double_edge_diffraction.PairPieces(pieces, owner, over.turns)

    def put(between: Transmission, sums: EchoSums) -> None:
        double_edge_diffraction.accumulate_doubles(turned, faced, between, frame.radar, pulse, sums, np.empty((3, 3)))

    return echo_set(put, between, frame.grids, pairs.object_ids[owner], lambda: _middles(over.pieces))
