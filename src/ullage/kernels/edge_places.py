"""Loops that find which edges of conductors face a radar, and the points from which they and their corners are seen."""

from __future__ import annotations

from typing import NamedTuple

from ullage.arrays import Bools, Floats, Ints, Longs
from ullage.kernels.corner_diffraction import Corners
from ullage.kernels.loops import lean
from ullage.kernels.vectors import dot


class EdgeSides(NamedTuple):
    """The faces about edges (w)."""

    starts: Floats  # (w, 3) a point of each edge [m]
    normals: Floats  # (w, 2, 3) of both faces, into the free space
    transmissive: Bools  # (w) whether only the first face counts


class CutEdges(NamedTuple):
    """Pieces (m) of edges, and ends (n) of edges."""

    pieces: Floats  # (m, 2, 3) both ends of each piece [m]
    owner: Ints  # (m) edge of each piece
    tips: Floats  # (n, 2, 3) place of each end [m], and its value
    holders: Ints  # (n) edge of each end
    ties: Longs  # (n) piece that goes on from each end, -1 for none
    outward: Floats  # (w, 3) unit vector from each edge into its open side


class CutPairs(NamedTuple):
    """Pieces (q) of lines halfway between pairs (p) of edges."""

    pieces: Floats  # (q, 2, 3) both ends of each piece [m]
    owner: Ints  # (q) pair of each piece
    normals: Floats  # (p, 3) of the face of each pair
    above: Floats  # (p) height of the radar over the face of each pair [m]


class EdgeSpots(NamedTuple):
    """Points at which edges, then pairs, then corners are looked at."""

    places: Floats  # (v, 3) [m]
    seats: Longs  # (m + n) which of them each piece of an edge, then each end, is seen by


@lean(error_model="numpy")
def facing(edges: EdgeSides, place: Floats, out: Bools) -> None:
    """Find which edges have a place (3) in their open side: out (w)."""
    for w in range(len(edges.starts)):
        out[w] = False
        for f in range(1 if edges.transmissive[w] else 2):
            out[w] = out[w] or dot(edges.normals[w, f], place) > dot(edges.normals[w, f], edges.starts[w])


@lean(error_model="numpy")
def heights(starts: Floats, normals: Floats, place: Floats, out: Floats) -> None:
    """Heights (p) of a place (3) over faces with unit normals (p, 3) through points (p, 3) [m]."""
    for p in range(len(starts)):
        out[p] = dot(normals[p], place) - dot(normals[p], starts[p])


@lean(error_model="numpy")
def place_edges(
    edges: CutEdges, pairs: CutPairs, corners: Corners, met: Longs, place: Floats, off: float, spots: EdgeSpots
) -> int:
    """Find the points from which edges are seen, just off them in their open side.

    An end from which a piece goes on is seen where that piece is.

    Args:
        edges: `CutEdges` (m, n).
        pairs: `CutPairs` (q).
        corners: `corner_diffraction.Corners` (c).
        met: (r) the corners that are looked at.
        place: (3) from where [m].
        off: how far off the edges the points lie [m].
        spots: `EdgeSpots`, written.

    Returns:
        How many points belong to edges; those of pairs and corners follow.
    """
    out, count = spots.places, len(edges.pieces)
    for i in range(count):
        spots.seats[i] = i
        for k in range(3):
            out[i, k] = 0.5 * (edges.pieces[i, 0, k] + edges.pieces[i, 1, k]) + off * edges.outward[edges.owner[i], k]
    for i in range(len(edges.tips)):
        spots.seats[len(edges.pieces) + i] = edges.ties[i]
        if edges.ties[i] >= 0:
            continue
        spots.seats[len(edges.pieces) + i] = count
        for k in range(3):
            out[count, k] = edges.tips[i, 0, k] + off * edges.outward[edges.holders[i], k]
        count += 1
    for i in range(len(pairs.pieces)):
        p = pairs.owner[i]
        aside = -off if pairs.above[p] < 0 else off
        for k in range(3):
            out[count + i, k] = 0.5 * (pairs.pieces[i, 0, k] + pairs.pieces[i, 1, k]) + aside * pairs.normals[p, k]
    for i in range(len(met)):
        c = met[i]
        aside = -off if dot(corners.normals[c], place) < dot(corners.normals[c], corners.places[c]) else off
        for k in range(3):
            out[count + len(pairs.pieces) + i, k] = corners.places[c, k] + aside * corners.normals[c, k]
    return count
