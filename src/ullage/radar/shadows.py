"""What is left of a mirror echo where shadow borders lie on its face.

The wave bends around what stands before a face twice, there and back. Kirchhoff's integral runs over both places x
and y at which the wave passes the plane of the occluder. Its integrand is M(x) M(y), the occluder's mask at both, times
a Gaussian of imaginary exponent [BornWolf1999]. The places correlate by r = d1 / (d1 + 2 d2), with d1 from the radar
to the occluder and d2 from there to the face.

Without correlation the two passes are independent. The result is then the square of one pass: 1 less the line integral
of e^{-j r phi} over the angle along the borders. Here phi is the phase by which the path over a point of the face
exceeds the shortest. The derivative by the correlation is the Gaussian over all pairs of border points [Plackett1954].
Along straight parallel edges that has a closed form, which is integrated from 0 to r. One endless edge gives the double
knife edge: 1/4 at the border of an occluder next to the radar, 1/2 at that of one next to the face. Pairs of edges in
one direction, or in opposite ones, give rods and slits. Other pairs are left out.

Rays find cells with a border along some directions about each mirror point, and narrow them. Within its cell a border
lies where the surface that hides the dark side ends: its triangles are followed from the one that the ray hits.
Borders run straight from direction to direction. The end of a face is no shadow border: its outline has an echo of
its own.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from ullage.arrays import Bools, Complexes, Floats, Longs
from ullage.kernels import shadow_borders, shadows
from ullage.kernels.edges import FaceOutlines
from ullage.kernels.shadow_borders import BorderCells, Directions, ShadowLines
from ullage.kernels.shadows import ShadowBorders
from ullage.radar.visibility import OpaqueView

RAYS = 20
"""Directions about a mirror point."""
CELLS = np.array([0.15, 1.0, 2.0, 3.3, 5.5, 9.0, 14.0])
"""Distances of the sampled places along each direction, over the distance at which the phase is 1 rad."""
FADING = shadows.Fading(10.0, 20.0, 100.0, 200.0)
PARTS, TIMES = 4, 2
"""The cell of a border is cut into this many parts, this many times."""
MOST = 4
"""Borders along a direction: what lies beyond more of them is left out."""
ASIDE = 0.05
"""Angle from a face's longest edge to the first direction: edges of occluders often run along edges of faces [rad]."""
_ANGLES = ASIDE + 2 * np.pi * np.arange(RAYS) / RAYS
_TURN = np.stack([np.cos(_ANGLES), np.sin(_ANGLES)], 1)


def _rule(nodes: int) -> shadows.QuadratureRule:
    """Gauss's rule over (0, 1)."""
    places, weights = np.polynomial.legendre.leggauss(nodes)
    return shadows.QuadratureRule((1 + places) / 2, weights / 2)


_RULES = shadows.Rules(_rule(6), _rule(16))


class MirrorPoints(NamedTuple):
    """Mirror points (k) on flat faces."""

    rows: Floats  # (k, 9) as `outlines.crossings` gives them
    on: Longs  # (k) face of each
    lit: Bools  # (k) whether each is lit itself


def echo_shares(
    points: MirrorPoints, faces: FaceOutlines, across: Floats, wavelength_m: float, view: OpaqueView
) -> Complexes:
    """Find what part (k) of the echoes of mirror points the shadow borders about them leave.

    Args:
        points: mirror points (k).
        faces: flat faces (p).
        across: (p, 2, 3) unit vectors in the faces, at right angles.
        wavelength_m: [m].
        view: what casts shadows.
    """
    many = len(points.on)
    units = np.sqrt(wavelength_m * points.rows[:, 3] / (4 * np.pi))
    directions = Directions(points.rows, points.on, units, across, _TURN, CELLS)
    cells = _cells(points.lit, directions, faces, view)
    reach, ratios = np.empty((2, many, RAYS, MOST))
    normals = np.empty((many, RAYS, MOST, 2))
    borders = ShadowBorders(points.lit, np.zeros((many, RAYS), np.int64), reach, ratios, normals)
    found = len(cells.low)
    dark, lines = (
        np.empty((found, 3)),
        ShadowLines(np.empty((found, 3)), np.empty((found, 3)), np.empty(found, np.bool_)),
    )
    shadow_borders.dark_ends(directions, cells, view.origin, lines, dark)
    shadow_borders.place_borders(directions, cells, view.shadow_ends(dark, lines), borders)
    out = np.empty(many, complex)
    shadows.echo_shares(borders, FADING, _RULES, np.empty((RAYS, MOST, 6)), out)
    return out


def _cells(lit: Bools, directions: Directions, faces: FaceOutlines, view: OpaqueView) -> BorderCells:
    """Find narrow cells in which light changes along directions about mirror points, lit themselves or not (k)."""
    rays = len(lit) * RAYS
    counts, places = np.empty((len(lit), RAYS), np.int64), np.empty((rays * len(CELLS) + 1, 3))
    made, clear = shadow_borders.sample(directions, faces, counts, places), view.clear
    lit_there, most = clear(places[:made]), rays * MOST
    point, direction, slot = np.empty((3, most), np.int64)
    low, high = np.empty((2, most))
    cells = BorderCells(point, direction, slot, low, high, np.empty(most, np.bool_))
    count = shadow_borders.changes(lit, counts, lit_there, CELLS, MOST, cells)
    point, direction, slot = point[:count], direction[:count], slot[:count]
    cells = BorderCells(point, direction, slot, low[:count], high[:count], cells.lit[:count])
    inner = np.empty((count * (PARTS - 1), 3))
    for _ in range(TIMES if count else 0):
        shadow_borders.between(directions, cells, PARTS, inner)
        shadow_borders.narrow(clear(inner), PARTS, cells)
    return cells
