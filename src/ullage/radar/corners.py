"""Corners of flat faces at right angles, which return waves to where they came from.

Two faces at right angles, or three, send an echo back from any place before them. So a small corner reflector echoes
more strongly than large walls that are turned away. `multipath` follows waves between the faces with the largest
apparent size. Here are the chains of faces that touch, whatever their size. Those with the strongest echo are followed
besides.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from ullage.arrays import Floats, Longs
from ullage.kernels import corners as kernel
from ullage.radar.context import AntennaPair, RadarContext
from ullage.radar.facets import PlanarPatches, Surfaces
from ullage.radar.solids import Backs

COSINE = 0.1
"""Faces whose normals have a product up to this are at right angles: 6 deg off them a corner returns little."""
GAP_M = 0.02
"""Faces that leave a gap up to this touch [m]."""
FAINT = 0.005
"""Corners weaker than this share of an endless mirror's echo are left out; they count in full from twice this on."""
EVEN = 1.2
"""A face this much smaller than its mirror, or more, carries the integral of both paths over two faces."""


@dataclass(frozen=True, slots=True, eq=False)
class Corners:
    """Chains of two or three flat faces that touch at right angles."""

    faces: Longs  # (n, 3) as the wave meets them, -1 for none
    sides: NDArray[np.int8]  # (n, 3) side of each face on which the corner is open, 0 for both

    def __len__(self) -> int:
        return len(self.faces)


def corners_of(parts: list[Surfaces]) -> Corners:
    """Find the corners of all parts, whose flat faces are joined in this order. Faces of two parts make none."""
    found, count = [], 0
    for part in parts:
        home = part.home or part  # what moves keeps its corners
        mine = _corners(home.planar, home.flat_backs, part.home is not None)
        found.append(Corners(np.where(mine.faces >= 0, mine.faces + count, -1), mine.sides) if count else mine)
        count += len(part.planar)
    if len(found) == 1:
        return found[0]
    return Corners(np.concatenate([one.faces for one in found]), np.concatenate([one.sides for one in found]))


@lru_cache(maxsize=16)
def _corners(planar: PlanarPatches, backs: Backs, apart: bool) -> Corners:
    """Find the corners of the flat faces of one part, with the outer sides of closed bodies.

    Objects that move `apart` make corners of their own faces only.
    """
    pairs, sides = _pairs(planar)
    if apart:
        of = planar.object_ids[pairs]
        pairs, sides = _picked((pairs, sides), of[:, 0] == of[:, 1])
    outward = np.sign(np.einsum("pi,pi->p", backs.outward[:, :3], planar.normals)).astype(np.int8)
    outer = outward[pairs]
    sides = np.where(sides == 0, outer, sides).astype(np.int8)
    pairs, sides = _picked((pairs, sides), ((outer == 0) | (outer == sides)).all(1))
    triples, three = _triples(pairs, sides)
    both = np.concatenate([pairs, pairs[:, ::-1]]), np.concatenate([sides, sides[:, ::-1]])
    radius = planar.spheres[:, 3]
    double, two = _picked(both, EVEN * radius[both[0][:, 0]] >= radius[both[0][:, 1]])
    none = np.full((len(double), 1), -1)
    return Corners(np.concatenate([np.hstack([double, none]), triples]).astype(np.int64),
                   np.concatenate([np.hstack([two, 0 * none]), three]).astype(np.int8))  # fmt: skip


def _picked(rows: tuple[Longs, NDArray[np.int8]], kept: NDArray[np.bool_]) -> tuple[Longs, NDArray[np.int8]]:
    return rows[0][kept], rows[1][kept]


def _pairs(planar: PlanarPatches) -> tuple[Longs, NDArray[np.int8]]:
    """Find the pairs (n, 2) of flat faces that touch at right angles, and the sides (n, 2) on which they lie."""
    rims = kernel.Rims(planar.normals, planar.offsets, planar.spheres, planar.across, planar.first, planar.starts,
                       planar.ends)  # fmt: skip
    room = 4 * len(planar)
    while True:
        pairs, sides = np.empty((room, 2), np.int64), np.empty((room, 2), np.int8)
        count = kernel.touching(rims, ~planar.smooth, COSINE, GAP_M, pairs, sides)
        if count <= room:
            return pairs[:count], sides[:count]
        room = count


def _triples(pairs: Longs, sides: NDArray[np.int8]) -> tuple[Longs, NDArray[np.int8]]:
    """Find three faces each of which touches the two others, in every order (n, 3), and their open sides (n, 3)."""
    known = {(int(a), int(b)): (int(s), int(t)) for (a, b), (s, t) in zip(pairs, sides, strict=True)}
    known |= {(b, a): (t, s) for (a, b), (s, t) in known.items()}
    after: dict[int, list[int]] = {}
    for a, b in known:
        after.setdefault(a, []).append(b)
    rows, open_ = [], []
    for (a, b), (s, t) in known.items():
        for c in after[b]:
            if (a, c) not in known:
                continue
            (s2, u), (t2, u2) = known[a, c], known[b, c]
            if min(s * s2, t * t2, u * u2) >= 0:  # both neighbours of each face lie on one side of it
                rows.append((a, b, c))
                open_.append((s or s2, t or t2, u or u2))
    return np.array(rows, np.int64).reshape(-1, 3), np.array(open_, np.int8).reshape(-1, 3)


def strengths_of(
    context: RadarContext, planar: PlanarPatches, antennas: AntennaPair, corners: Corners, most: int
) -> tuple[Floats, Floats]:
    """Estimate the echoes (n) of corners of up to `most` faces.

    Returns:
        The estimates over one metre there and back, 0 beyond the gate; how much of each corner counts, which fades
        out towards `FAINT`.
    """
    share, lengths = np.empty((2, len(corners)))
    faces = kernel.CornerFaces(planar.normals, planar.offsets, planar.spheres, planar.widths)
    kernel.strengths(antennas.origins, context.gate[1], context.spec.wavelength_m, corners.faces, corners.sides, faces,
                     share, lengths, np.empty((5, 3)))  # fmt: skip
    counts = np.clip(share / FAINT - 1, 0, 1)
    if most < 3:
        counts[corners.faces[:, 2] >= 0] = 0
    return share / lengths, counts
