"""Find paths over large flat faces to curved surfaces and wires, and back.

A path is reflected by up to two of the faces of the largest apparent size before the scatterer, and by as many after
it. The mirror images of the radar see the scatterer as the radar itself does [AllenBerkley1979]. Where the antennas
stand in one place, a path and its reverse are the same wave twice. All paths of a frame are followed at once. What
none of their beams meets within the gate is left out first, so that the cost depends on the echoes, not on the size
of the world.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import lru_cache
from itertools import product

import numpy as np

from ullage.arrays import Bools, Floats, Longs
from ullage.kernels import paths as kernel
from ullage.kernels.bounces import Orientations
from ullage.kernels.facets import Antennas
from ullage.kernels.lit import MirrorPaths
from ullage.radar.context import RadarFrame
from ullage.radar.echo_set import EchoSet
from ullage.radar.facets import PlanarPatches
from ullage.radar.multipath import choose_largest
from ullage.radar.visibility import between

Legs = tuple[tuple[int, ...], tuple[int, ...]]

FACES = 3
"""Number of flat faces, those of the largest apparent size, that reflect waves to curved surfaces and wires."""
PAIRS = 2
"""The same for waves that two of them reflect."""
_CHAINS: dict[int, tuple[tuple[int, int], ...]] = {
    2: ((1, 0), (0, 1)), 3: ((1, 1), (2, 0), (0, 2)), 4: ((2, 1), (1, 2)), 5: ((2, 2),),
}  # fmt: skip
"""Numbers of faces before the scatterer and after it, for each number of bounces."""


@dataclass(frozen=True, slots=True, eq=False)
class PathSet:
    """Paths there and back, over none, one or two faces on each leg."""

    faces: Longs  # (n, 2, 2) of each leg from its antenna on, -1 for none
    via: Longs  # (n, d) objects that mirror along it, as the wave meets them, -1 for none
    legs: Longs  # (n, 2) equal legs have one number
    weights: Floats  # (n)
    images: Floats  # (n, 2, 3, 3) each antenna, then its images, the last one again where there are fewer [m]
    frames: Floats  # (n, 2, 3, 3) of the last images
    planes: Floats  # (n, 20, 4) that bound what a path can reach
    counts: Longs  # (n) how many of them there are

    def __len__(self) -> int:
        return len(self.faces)

    @property
    def over_mirrors(self) -> kernel.MirrorPaths:
        """The paths, as kernels take them."""
        return kernel.MirrorPaths(self.faces, self.images, self.legs)

    @property
    def ends(self) -> Floats:
        """The radars (n, 2, 3) as seen from the ends of the paths [m]."""
        return np.ascontiguousarray(self.images[:, :, 2])

    @property
    def mirrors(self) -> MirrorPaths:
        """The paths as kernels take them."""
        return MirrorPaths(self.images, self.frames, self.faces, self.planes, self.counts, self.weights)

    def with_paths(self, echoes: EchoSet, of: Longs) -> EchoSet:
        """Return echoes (m) with the objects that mirror on their paths `of` (m)."""
        return replace(echoes, via=self.via[of], before=(self.faces[:, 0] >= 0).sum(1)[of])

    def antennas(self, radar: Antennas, of: Longs | None = None) -> Antennas:
        """Return the images of one radar that the ends of all paths, or of some (m), see: one for each path."""
        some = slice(None) if of is None else of
        fields = np.repeat(radar.fields[:, [0, 0]], len(self.weights[some]), 0)  # factors hold the polarisation
        return radar._replace(origins=self.ends[some], frames=self.frames[some], fields=fields,
                              factor=radar.factor * self.weights[some])  # fmt: skip


def paths_of(frame: RadarFrame) -> PathSet:
    """Find the paths of two bounces and more over the faces of the largest apparent sizes.

    Faces fade in as mirrors do. Facets of curved surfaces do not reflect here. Paths that lead beyond the gate are left
    out.
    """
    planar, antennas = frame.planar, frame.antennas
    sizes = frame.sizes * ~planar.smooth
    first = largest(sizes, FACES)
    counts = [FACES if bounces == 2 else PAIRS for bounces in range(2, min(frame.max_bounces, max(_CHAINS)) + 1)]
    taken = [choose_largest(sizes[first], count) for count in counts]
    one = antennas.reversible
    rows, over, twice, legs = _rows(tuple(len(which) for which, _ in taken), one)
    chosen = np.concatenate([*(first[which] for which, _ in taken), np.array([-1])])
    shares = np.concatenate([*(weights[which] for which, weights in taken), np.ones(1)])
    faces, count = chosen[rows], len(rows)
    out = kernel.Leads(np.empty((count, 2, 3, 3)), np.empty((count, 2, 3, 3)), np.empty((count, kernel.PLANES, 4)),
                       np.empty(count, np.int64), np.empty(count))  # fmt: skip
    kernel.lead(faces, Orientations(antennas.frames, antennas.fields), antennas.origins, flat_faces(planar),
                kernel.FaceExtents(planar.spheres, planar.across), out, np.empty((2, 2)))  # fmt: skip
    via = np.where(chosen >= 0, planar.object_ids[chosen], -1)[over]
    held = out.reach <= frame.context.gate[1]
    all_ = (faces, via, legs, twice * shares[rows].prod((1, 2)), out.images, out.frames, out.planes, out.counts)
    return PathSet(*(all_ if held.all() else (row[held] for row in all_)))


def flat_faces(planar: PlanarPatches) -> kernel.FlatFaces:
    """Flat faces and their edges, as kernels take them."""
    return kernel.FlatFaces(planar.normals, planar.offsets, planar.first, planar.starts, planar.ends)


def largest(sizes: Floats, count: int) -> Longs:
    """Find the `count` largest sizes of all (p), and the next one, in order of their places."""
    return np.sort(np.argpartition(sizes, -count - 1)[-count - 1 :]) if len(sizes) > count else np.arange(len(sizes))


@lru_cache(maxsize=64)
def _rows(counts: tuple[int, ...], one: bool) -> tuple[Longs, Longs, Floats, Longs]:
    """List the paths of two bounces and more over so many faces each.

    Faces are places in one list of all these faces, followed by -1 for none.

    Returns:
        The faces (n, 2, 2) of both legs; the faces (n, d) as the wave meets them; how often each path counts (n); a
        number (n, 2) for each leg that differs.
    """
    paths: list[Legs] = []
    for bounces, count in enumerate(counts, 2):
        start = sum(counts[: bounces - 2])
        for chains in _CHAINS[bounces]:
            if not (one and chains[0] < chains[1]):
                paths += _picks(range(start, start + count), chains, one)
    rows = [[(*leg, -1, -1)[:2] for leg in legs] for legs in paths]
    most = max(len(counts), 2)
    over = [(*there, *back[::-1], -1, -1, -1)[:most] for there, back in paths]
    twice = np.array([2.0 if one and there != back else 1.0 for there, back in paths])
    known: dict[tuple[int, tuple[int, ...]], int] = {}
    legs = [
        [known.setdefault((0 if one else side, leg), len(known)) for side, leg in enumerate(path)] for path in paths
    ]
    return (np.array(rows, np.int64).reshape(-1, 2, 2), np.array(over, np.int64).reshape(-1, most), twice,
            np.array(legs, np.int64).reshape(-1, 2))  # fmt: skip


def _picks(ids: range, chains: tuple[int, int], one: bool) -> Iterator[Legs]:
    """Choose the faces of both legs, `chains` of them on each; in one place no path and its reverse."""
    there, back = ([leg for leg in product(ids, repeat=count) if len(set(leg)) == count] for count in chains)
    for i, leg in enumerate(there):
        yield from ((leg, other) for other in (back[i:] if one and chains[0] == chains[1] else back))


@dataclass(frozen=True, slots=True, eq=False)
class Reached:
    """Points that paths reach, and how."""

    stops: Floats  # (q, 4, 3) corners of legs [m]
    rows: Longs  # (m, 2) legs of each pair of path and point; -1 where none was followed
    free: Bools  # (m) whether both legs meet their faces and are free


def reached(frame: RadarFrame, paths: PathSet, of: Longs, points: Floats, at: Longs | None = None) -> Reached:
    """Follow both legs of paths (m) to points (m, 3) [m], or to the points whose places are `at` (m).

    Each leg to a point is followed once: the leg back first, the leg there only where that is free.
    """
    at = np.arange(len(of)) if at is None else at
    room = 2 * len(of)
    known = np.full((int(paths.legs.max(initial=0)) + 1, len(points)), -1, np.int32)
    rows, stops, free = np.full((len(of), 2), -1), np.empty((room, 4, 3)), np.zeros(room, np.bool_)
    many = 3 * len(of)
    (a, b), owner = np.empty((2, many, 3)), np.empty(many, np.int64)
    made, pairs, legs = 0, kernel.PathPoints(points, at, of), kernel.KnownLegs(known, rows, stops, free)
    segments, flat, parts = kernel.Segments(a, b, owner), flat_faces(frame.planar), frame.parts
    for side in (1, 0):
        made, count, others = kernel.corners(side, made, pairs, paths.over_mirrors, flat, legs, segments)
        free[owner[:count][~between(parts, a[:count], b[:count])]] = False
        # most are blocked at the point: then the rest needs no rays
        asked = many - others + np.flatnonzero(free[owner[many - others :]])
        free[owner[asked[~between(parts, a.take(asked, 0), b.take(asked, 0))]]] = False
    return Reached(stops, rows, (rows[:, 0] >= 0) & free[rows[:, 0]])
