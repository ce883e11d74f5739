"""Echoes of the edges of conductors, beyond physical optics: each edge by itself, and waves from edge to edge."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from ullage.geometry import C0
from ullage.kernels import fringe
from ullage.kernels import wires as string
from ullage.radar import diffraction
from ullage.radar import double_diffraction as double
from ullage.radar.facets import Surfaces
from ullage.radar.physical import KAPPA, REACH, Bench, Laid, View, common, grown, shading

Floats = NDArray[np.float64]
Ints = NDArray[np.int32]
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
    wave = ready.pulse.omega / C0
    alone = _pieces(ready, view, edges.starts, edges.ends, np.ones(len(edges)), across=False)
    width = np.linalg.norm(pairs.gaps, axis=1)
    over = _pieces(ready, view, pairs.starts + pairs.gaps / 2, pairs.ends + pairs.gaps / 2,
                   4 / np.sqrt(2 * np.pi * wave * np.maximum(width, 1e-6)), across=True)  # fmt: skip
    one, one_at = _of_edges(ready, edges, view, *alone)
    two, two_at = _of_pairs(ready, pairs, view, *over)
    shade, extra = shading(ready, parts, view, np.concatenate([one_at, two_at]))
    cut = len(one_at)
    return [
        _lay_fringes(ready, view, edges, *one, shade[:cut], extra[:cut], grids),
        _lay_doubles(ready, view, pairs, *two, shade[cut:], extra[cut:], grids),
    ]


def _pieces(
    ready: Bench, view: View, starts: Floats, ends: Floats, factors: Floats, *, across: bool
) -> tuple[Floats, Ints]:
    """Pieces (m, 2, 3) within the gate of lines that can be heard, and the line of each."""
    heard, gate = np.empty(len(starts), np.bool_), np.array(ready.gate)
    fringe.audible(starts, ends, factors, across, view.origins, view.frames, view.fields, ready.table,
                   ready.spec.antenna.kind == "isotropic", ready.pulse.omega / C0, gate, FAINT, heard)  # fmt: skip
    which = np.flatnonzero(heard)
    if not len(which):
        return np.zeros((0, 2, 3)), np.zeros(0, np.int32)
    starts, ends, fine = starts[which], ends[which], (1 if across else _COARSE) * KAPPA * ready.spec.wavelength_m
    pieces, owner = grown(1024, (2, 3), lambda out, of: string.cut_wires(
        starts, ends, view.origins, gate, fine, REACH, out, of))  # fmt: skip
    return pieces, which[owner].astype(np.int32)


def _of_edges(
    ready: Bench, edges: diffraction.Edges, view: View, pieces: Floats, owner: Ints
) -> tuple[tuple[Floats, Ints], Floats]:
    """Pieces whose open side the radar is in, and the points (m, 3) to look at [m]."""
    held = diffraction.facing(edges, ready.rims.sheets, owner, pieces, view.origins.mean(0))
    pieces, owner = pieces[held], owner[held]
    return (pieces, owner), pieces.mean(1) + _NUDGE_M * edges.outward[owner]


def _of_pairs(
    ready: Bench, pairs: double.Pairs, view: View, pieces: Floats, owner: Ints
) -> tuple[tuple[Floats, Ints], Floats]:
    """Pieces of first edges whose face the radar sees, and points on that face to look at [m]."""
    middle, n = pieces.mean(1), pairs.normals[owner]
    above = np.einsum("ni,ni->n", n, view.origins.mean(0) - middle)
    held = (above > 0) | ready.rims.bare[owner]
    side = np.where(above[held] < 0, -1.0, 1.0)[:, None]
    owner = owner[held]
    return (pieces[held] - pairs.gaps[owner, None] / 2, owner), middle[held] + _NUDGE_M * side * n[held]


def _lay_fringes(
    ready: Bench,
    view: View,
    edges: diffraction.Edges,
    pieces: Floats,
    owner: Ints,
    shade: Complexes,
    extra: Floats,
    grids: Complexes,
) -> Laid:
    echo, delay = np.empty(len(pieces), complex), np.empty(len(pieces))
    told = common(ready, view, grids)
    fringe.lay_fringes(pieces, owner, shade, extra, edges.angles, edges.inward, edges.normals, ready.rims.sheets,
                       *told[:6], *told[8:], echo, delay)  # fmt: skip
    return Laid(edges.stuffs[owner], pieces.mean(1), echo, delay)


def _lay_doubles(
    ready: Bench,
    view: View,
    pairs: double.Pairs,
    pieces: Floats,
    owner: Ints,
    shade: Complexes,
    extra: Floats,
    grids: Complexes,
) -> Laid:
    echo, delay = np.empty(len(pieces), complex), np.empty(len(pieces))
    told = common(ready, view, grids)
    fringe.lay_doubles(pieces, owner, shade, extra, pairs.gaps, pairs.angles, pairs.inward, pairs.normals,
                       ready.rims.both, *told[:6], *told[8:], echo, delay)  # fmt: skip
    return Laid(pairs.stuffs[owner], pieces.mean(1) + pairs.gaps[owner] / 2, echo, delay)
