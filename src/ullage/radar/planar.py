"""Echoes of large flat faces: their mirror images, less what runs along their edges."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ullage.arrays import Bools, Complexes, Floats, Ints, Longs
from ullage.kernels import edges as kernel
from ullage.kernels import outlines as draw
from ullage.kernels.edges import CutLimits, FaceOutlines, Outline
from ullage.kernels.facets import EchoSums, LitFaces, Transmission
from ullage.radar.context import RadarFrame
from ullage.radar.echo_set import EchoSet, echo_set
from ullage.radar.facets import PlanarPatches, Surfaces
from ullage.radar.folding import limits_of
from ullage.radar.penetration import TAPS
from ullage.radar.shadows import MirrorPoints, echo_shares
from ullage.radar.visibility import OpaqueView

_NUDGE_M = 5e-3
_RINGS = np.arange(6) * np.pi / 3
_ZONE = np.concatenate(
    [[[0.0, 0.0]], *(q * np.stack([np.cos(_RINGS + q), np.sin(_RINGS + q)], 1) for q in (0.4, 0.75))]
)
_INNER = len(_ZONE)
_WIDE = np.concatenate([_ZONE, *(q * np.stack([np.cos(_RINGS), np.sin(_RINGS)], 1) for q in (1.3, 2.6, 5.0, 7.0))])
"""The zone, and places so far off that a shadow border beyond them leaves an echo as it is."""


def cut_outlines(which: Longs, faces: FaceOutlines, origins: Floats, aside: Floats, limits: CutLimits) -> Outline:
    """Cut the outlines of some faces (k), with more room where there was too little.

    Args:
        which: (k) the faces.
        faces: all faces (p).
        origins: (1 or p, 2, 3) transmitter and receiver, for all faces or for each [m].
        aside: (3) as `context.AntennaPair.aside` [m].
        limits: how far outlines are followed.
    """
    rooms, windings = [2048 + 4 * len(faces.starts), 1024 + 2 * len(faces.starts)], np.empty(len(which))
    scratch = kernel.CutScratch(np.empty((4, 3)), np.empty((69, 8)), np.empty((69, 2)), np.empty(3, np.int64))
    while True:
        pieces, owner = np.empty((rooms[0], 12)), np.empty(rooms[0], np.int32)
        tips, holders, ties = np.empty((rooms[1], 9)), np.empty(rooms[1], np.int32), np.empty(rooms[1], np.int32)
        outline = Outline(pieces, owner, tips, holders, ties, windings)
        made, ends = kernel.cut(which, faces, origins, aside, limits, outline, scratch)
        if made <= rooms[0] and ends <= rooms[1]:
            return Outline(pieces[:made], owner[:made], tips[:ends], holders[:ends], ties[:ends], windings)
        rooms = [max(rooms[0], int(1.2 * made)), max(rooms[1], int(1.2 * ends))]


def face_outlines(planar: PlanarPatches | Outlined) -> FaceOutlines:
    """Flat faces as kernels take them."""
    return FaceOutlines(planar.spheres, planar.normals, planar.offsets, planar.first, planar.starts, planar.ends)


def accumulate_planar(frame: RadarFrame, part: Surfaces, done: Bools | None = None) -> list[EchoSet]:
    """Add the echoes of flat faces within the frame, and of those beyond that fold back into it.

    Those that are `done` (p) otherwise are left out.
    """
    context, antennas, planar = frame.context, frame.antennas, part.planar
    opaque = ~context.transmissive.thin[planar.object_ids]
    hidden = part.flat_backs.hidden(antennas.origins, opaque)
    which = np.flatnonzero(~(hidden if done is None else hidden | done))
    if not len(which):
        return []
    limits = limits_of(planar, antennas, context.gate[1], context.fold_s)
    follow = CutLimits(limits, 1e9, context.pulse.omega, context.whole_outlines)
    outline = cut_outlines(which, face_outlines(planar), antennas.origins[None], antennas.aside, follow)
    casters = [one.casters(context.transmissive.thin)[0] for one in frame.parts]
    view = OpaqueView(casters, 0.5 * (antennas.origins[0] + antennas.origins[1]))

    def past_borders(points: Floats, which: Longs, free: Bools) -> Complexes:
        mirrors = MirrorPoints(points, which, free)
        return echo_shares(mirrors, face_outlines(planar), planar.across, context.spec.wavelength_m, view)

    shading = Shading(lambda points, _: frame.transmission_to(points), past_borders)
    return [accumulate_parted(frame, planar, which, outline, limits, shading, frame.lit(planar))[0]]


class Shading(NamedTuple):
    """How what stands before faces weakens their echoes."""

    to_points: Callable[[Floats, NDArray[np.integer]], tuple[Complexes, Floats]]
    """Factor (m) and delay (m) [s] of what stands before points (m, 3) on faces (m)."""
    past_borders: Callable[[Floats, Longs, Bools], Complexes] | None = None
    """Factor (k) of shadow borders about mirror points (k, 9) on faces (k), themselves lit or not (k).

    Without it, a mirror echo is weakened by the share of its Fresnel zone that is hidden.
    """


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


def accumulate_parted(
    frame: RadarFrame, planar: PlanarPatches | Outlined, which: Longs, outline: Outline, limits: Floats,
    shading: Shading, lit: LitFaces,
) -> tuple[EchoSet, Longs]:  # fmt: skip
    """Add the echoes of some faces (k) whose outlines are cut: of their mirror points, pieces and ends.

    Returns:
        The echoes (m), and the face of each (m).
    """
    points = np.empty((len(which), 9))
    count = draw.crossings(
        which, outline.windings, planar.normals, planar.offsets, lit.antennas.origins, limits, points
    )
    points, which = points[:count], which[:count]
    zone = _ZONE if shading.past_borders is None else _WIDE
    looks, owner, seats, open_, looked = _looks(frame.context.spec.wavelength_m, planar, outline, points, which, zone)
    transmission, extra = shading.to_points(looks, owner)
    if len(points):
        about = transmission[looked:], extra[looked:], open_
        if shading.past_borders is None:
            factor, late = _mean(*about)
        else:
            factor, late = _past_borders(*about, points, which, shading.past_borders)
        transmission, extra = np.concatenate([transmission[seats], factor]), np.concatenate([extra[seats], late])
    else:
        transmission, extra = transmission[seats], extra[seats]
    between = Transmission(transmission, extra)
    echoes = accumulate_outline(frame, outline, points, which, between, lit)
    return echoes, np.concatenate([outline.owner, outline.holders, which])


def accumulate_outline(
    frame: RadarFrame, outline: Outline, points: Floats, which: Longs, between: Transmission, lit: LitFaces
) -> EchoSet:
    """Add the echoes of outlines and of mirror points to the delay grids.

    Args:
        frame: the frame.
        outline: pieces (m) and ends (n) of outlines.
        points: (k, 9) mirror points, as `outlines.crossings` gives them.
        which: (k) face of each mirror point.
        between: what lies before the pieces, then the ends, then the mirror points (m + n + k).
        lit: the faces, and the radars that see them.
    """
    owner = np.concatenate([outline.owner, outline.holders, which.astype(np.int32)])
    ends = np.concatenate([outline.tips, points])
    echoes = draw.OutlineEchoes(outline.pieces, ends, len(outline.tips), owner)
    known = draw.KnownEnd(np.empty(TAPS, complex), np.empty(TAPS))

    def put(between: Transmission, sums: EchoSums) -> None:
        draw.accumulate_outlines(echoes, lit, between, frame.context.pulse_grid, sums, known)

    def places() -> Floats:
        return np.concatenate([0.5 * (outline.pieces[:, :3] + outline.pieces[:, 3:6]), ends[:, :3]])

    rays = np.zeros(len(owner), np.bool_)
    rays[len(owner) - len(points) :] = True
    return echo_set(put, between, frame.grids, lit.materials[owner], places, rays=rays)


def _looks(
    wave_m: float, planar: PlanarPatches | Outlined, outline: Outline, points: Floats, which: Longs, zone: Floats
) -> tuple[Floats, Longs, Longs, Bools, int]:
    """Find where to look: at pieces and ends of rims, and at places of a zone (z, 2) around each mirror point (k).

    Returns:
        The places (m, 3) [m]; the face of each; which of them each piece and end is seen by; which places of the zones
        lie on their faces (k, z); and how many places come before those of zones, of which only these are looked at.
    """
    most, about = len(outline.pieces) + len(outline.tips), len(points) * len(zone)
    spots, faces = np.empty((most + about, 3)), np.empty(most + about, np.int64)
    seats, within = np.empty(most, np.int64), np.empty((len(points), len(zone)), np.bool_)
    count = draw.look_at(outline, planar.normals, _NUDGE_M, draw.Spots(spots, faces), seats)
    rest = draw.Spots(spots[count:], faces[count:])
    made = count + draw.look_about(points, which, face_outlines(planar), planar.across, zone, wave_m, rest, within)
    return spots[:made], faces[:made], seats, within, count


def _mean(transmission: Complexes, extra: Floats, held: Bools) -> tuple[Complexes, Floats]:
    """Mean factor and delay over the part of each zone that lies on its face, `held` (k, z)."""
    share = held.sum(1)
    first = np.cumsum(share) - share
    return np.add.reduceat(transmission, first) / share, np.add.reduceat(extra, first) / share


def _past_borders(
    transmission: Complexes,
    extra: Floats,
    held: Bools,
    points: Floats,
    which: Longs,
    shares_of: Callable[[Floats, Longs, Bools], Complexes],
) -> tuple[Complexes, Floats]:
    """Factor and delay of mirror points: of the sheets before the lit part of each zone, and of shadow borders."""
    factor, late = np.empty(len(held), complex), np.empty(len(held))
    lit, bordered = np.empty((2, len(held)), np.bool_)
    draw.through_sheets(transmission, extra, held, _INNER, Transmission(factor, late), lit, bordered)
    some = np.flatnonzero(bordered)
    if len(some):
        factor[some] *= shares_of(points[some], which[some], lit[some])
    return factor, late
