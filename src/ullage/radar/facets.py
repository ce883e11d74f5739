"""Surfaces ready for physical optics: flat faces by their rims, triangles in clusters, rays for what hides what."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from ullage.arrays import Bools, Floats, Ints, Longs
from ullage.kernels.facets import BALL
from ullage.radar.solids import EVEN, Backs, Faces, backs, behind_skins
from ullage.world.raycast import Raycaster
from ullage.world.scene import Scene
from ullage.world.smoothing import Creases, creases, face_normals, goes_on, half_edges, linked, welded

FLAT_M = 0.11
"""Flat faces at least this long are done by their rims and mirror waves [m]: squares of two waves of the X4M05.

Of smaller ones the rim gives the echo less well than triangles: 0.4 dB too much at 1.5 waves.
"""
STRIP_M = 0.15
"""The same for facets of curved surfaces [m]: shorter ones cost less as triangles, and none is a mirror."""
MIRROR_CORNERS = 12
"""Convex outlines with more corners than this mirror in slices."""
ROUNDED = (1e-5, 1e-7, 1e-9)
"""So far off one plane may corners be, as a share of their triangles' size; the next where a patch so bends."""
SINGLE = 2.0**-24
"""Rounding of a coordinate in single precision, as a share of it: mesh files have no more."""
BENT_M = 5e-4
"""Off its plane by which a patch is none: an eightieth of a wave [m]."""
_CLUSTER = 16  # triangles, about


@dataclass(frozen=True, slots=True, eq=False)
class PlanarPatches:
    """Flat faces of any outline, known by their rims."""

    normals: Floats  # (p, 3)
    offsets: Floats  # (p) plane normal . x = offset [m]
    object_ids: Ints  # (p) object of each face
    spheres: Floats  # (p, 4) centre and radius [m]
    first: Ints  # (p + 1) first edge of each
    starts: Floats  # (e, 3) counter-clockwise about the normal, holes clockwise [m]
    ends: Floats  # (e, 3) [m]
    loop_of: Ints  # (p + 1) first loop of each
    loops: Ints  # (l + 1) first edge of each loop
    mirrors: Floats  # (c, MIRROR_CORNERS, 3) convex parts that can mirror [m]
    sizes: Ints  # (c) corners of each
    flat_of: Ints  # (c) face of each
    widths: Floats  # (p, 2) extent of each along its longest edge and across it [m]
    across: Floats  # (p, 2, 3) two unit vectors in each, at right angles
    smooth: Bools  # (p) whether each is a facet of a curved surface

    def __len__(self) -> int:
        return len(self.offsets)


@dataclass(frozen=True, slots=True, eq=False)
class TransmissiveFaces:
    """The faces that let waves through."""

    rays: Raycaster
    object_ids: Ints  # object of each face that rays can hit


@dataclass(frozen=True, slots=True, eq=False)
class Surfaces:
    """What stands still together: large flat faces, small triangles in clusters, and a tree of rays over both."""

    corners: Floats  # (f, 3, 3) [m]
    normals: Floats  # (f, 3)
    object_ids: Ints  # (f) object of each triangle, which is also its row in the material tables
    spheres: Floats  # (k, 4) centre and radius of each cluster [m]
    first: Ints  # (k + 1)
    backs: Backs  # of the triangles
    planar: PlanarPatches
    flat_backs: Backs  # of the flat faces
    rays: Raycaster
    solid: Scene  # the faces that rays can hit
    faces: Longs = field(default_factory=lambda: np.zeros(0, np.int64))  # (f) face of the scene of each triangle
    flat_faces: Longs = field(default_factory=lambda: np.zeros(0, np.int64))  # (m) faces of the scene in flat faces
    flat_at: Longs = field(default_factory=lambda: np.zeros(0, np.int64))  # (m) and in which flat face each is
    spare: Longs = field(default_factory=lambda: np.zeros(0, np.int64))  # faces of the scene behind skins
    split: dict[bytes, tuple[Raycaster, TransmissiveFaces | None]] = field(default_factory=dict)
    home: Surfaces | None = None  # these before they moved
    poses: Floats | None = None  # (o, 4, 4) of the objects, when they have moved

    def casters(self, thin: Bools) -> tuple[Raycaster, TransmissiveFaces | None]:
        """Rays over what is opaque, and over what is not, for a choice of thin objects (o); built when first asked."""
        key = thin.tobytes()
        if key not in self.split:
            self.split[key] = self._split(thin)
        return self.split[key]

    def _split(self, thin: Bools) -> tuple[Raycaster, TransmissiveFaces | None]:
        mine = thin[self.solid.face_object]
        if not mine.any():
            return self.rays, None
        if self.home is not None and self.poses is not None:  # its trees are built once
            opaque, veil = self.home.casters(thin)
            return opaque.standing(self.poses), veil and replace(veil, rays=veil.rays.standing(self.poses))
        opaque, through = (Raycaster(only(self.solid, kept)) for kept in (~mine, mine))
        return opaque, TransmissiveFaces(through, self.solid.face_object[mine])


def only(scene: Scene, kept: NDArray[np.generic]) -> Scene:
    """The scene with some of its faces (f) alone, for rays: without corner normals."""
    return replace(scene, faces=scene.faces[kept], face_object=scene.face_object[kept], corner_normals=None)


def gather(scene: Scene, faces: Bools) -> Surfaces:
    """The chosen faces of a scene, moving ones as they stand at their start; faces without area are left out."""
    corners = scene.corners()
    normals, area = face_normals(corners)
    index = np.flatnonzero(faces & (area > 1e-12))
    part = only(scene, index)
    rays = Raycaster(part)
    corners, normals, object_ids = corners[index], normals[index], scene.face_object[index]
    patch = coplanar(corners, normals, object_ids)
    bends = slight_bends(corners, object_ids, patch, creases(scene.objects))
    large = (_extents(corners, patch) >= np.where(bends > 0, STRIP_M, FLAT_M))[patch]
    sides = backs(corners, normals, object_ids)
    sides, spare = behind_skins(sides, corners, normals, Faces(patch, object_ids), rays)
    planar = _planar(corners[large], normals[large], object_ids[large], patch[large], bends[patch[large]] > 1)
    lead, at = np.unique(patch[large], return_index=True, return_inverse=True)[1:]
    small = np.flatnonzero(~large)
    order, first = _clusters(corners[small].mean(1), np.sqrt(area[index][small]))
    small = small[order]
    mine = np.ascontiguousarray(corners[small])
    return Surfaces(mine, np.ascontiguousarray(normals[small]), object_ids[small].copy(), _spheres(mine, first), first,
                    sides.take(small), planar, sides.take(np.flatnonzero(large)[lead]), rays, part, index[small],
                    index[large], at.astype(np.int64), index[spare])  # fmt: skip


def strewn(corners: Floats, normals: Floats, object_ids: Ints, sides: Backs, home: Surfaces) -> tuple[Surfaces, Longs]:
    """Triangles (f, 3, 3) with normals, objects and outer sides, among what else there is, and their order (f)."""
    order, first = _clusters(corners.mean(1), np.sqrt(face_normals(corners)[1]))
    mine = np.ascontiguousarray(corners[order])
    made = replace(home, corners=mine, normals=np.ascontiguousarray(normals[order]), object_ids=object_ids[order],
                   spheres=_spheres(mine, first), first=first, backs=sides.take(order))  # fmt: skip
    return made, order


def twin_edges(corners: Floats) -> tuple[Longs, Longs]:
    """Pairs of half edges of triangles (f, 3, 3) in one place: triangle times 3, and the corner each begins at."""
    order, first, _ = half_edges(welded(corners))
    twin = np.delete(np.arange(len(order)), first)
    return order[twin - 1], order[twin]


def coplanar(corners: Floats, normals: Floats, object_ids: Ints) -> Longs:
    """Which patch each triangle (f, 3, 3) belongs to: joined by edges, in one plane, of one object.

    Neighbours may be off by what files round; but where that adds up to a bend, as round a wall of long, narrow strips,
    less is allowed. The plane is that of the neighbour with the greater height over its longest edge: rounding turns
    it less. Corners of single precision are off it by at most twice their rounding each, wherever they lie.
    """
    if not len(corners):
        return np.zeros(0, np.int64)
    a, b = (half // 3 for half in twin_edges(corners))
    height = _heights(corners)
    a, b = np.where(height[a] < height[b], b, a), np.where(height[a] < height[b], a, b)
    gap = abs(np.einsum("ni,nki->nk", normals[a], corners[b] - corners[a, :1])).max(1)
    rounded = _rounded(corners)
    size = np.linalg.norm(corners[b, 1] - corners[b, 0], axis=1) + np.linalg.norm(corners[b, 2] - corners[b, 0], axis=1)
    size, mine = np.maximum(size, 1e-2), object_ids[a] == object_ids[b]
    same, patch = np.zeros(len(a), bool), np.arange(len(corners))
    asked = np.ones(len(corners), bool)
    for most in ROUNDED:
        allowed = np.maximum(most * size, rounded if most == ROUNDED[0] else 0.0)
        same = np.where(asked[a], (gap < allowed) & mine, same)
        patch = linked(a[same], b[same], len(corners))
        asked = np.bincount(patch, _off_plane(corners, normals, patch) > BENT_M)[patch] > 0
        if not asked.any():
            break
    return patch


def _rounded(corners: Floats) -> float:
    """How far corners (f, 3, 3) may lie off one plane or line by their rounding in single precision [m]."""
    return 4 * SINGLE * float(np.linalg.norm(corners, axis=2).max(initial=0))


def _heights(corners: Floats) -> Floats:
    """Height of each triangle (f, 3, 3) over its longest edge [m]."""
    sides = np.roll(corners, -1, 1) - corners
    longest = np.linalg.norm(sides, axis=2).max(1)
    return np.asarray(np.linalg.norm(np.cross(sides[:, 0], sides[:, 1]), axis=1) / np.maximum(longest, 1e-30))


def _off_plane(corners: Floats, normals: Floats, patch: Longs) -> Floats:
    """How far triangles (f, 3, 3) lie off the plane of their patch in the mean, where slivers count for little [m]."""
    normal, middle = _planes(corners, normals, patch)
    return np.asarray(abs(np.einsum("ni,nki->nk", normal[patch], corners - middle[patch, None])).max(1))


def _planes(corners: Floats, normals: Floats, patch: Longs) -> tuple[Floats, Floats]:
    """Normal and centre of area (p, 3) of each patch of triangles (f, 3, 3).

    The normal is that of the vector area. The rounding of a corner inside the patch cancels there, however thin its
    triangles are; the normal of a single needle is off by the rounding over its height. It points to the side of the
    first triangle's.
    """
    lead = np.unique(patch, return_index=True)[1][patch]
    area = 2 * face_normals(corners)[1] + 1e-30
    alike = area * np.where(np.einsum("ni,ni->n", normals, normals[lead]) < 0, -1.0, 1.0)
    total: Floats = np.stack([np.bincount(patch, alike * n) for n in normals.T], 1)
    normal = total / np.maximum(np.linalg.norm(total, axis=1), 1e-30)[:, None]
    middle = np.stack([np.bincount(patch, area * m) for m in corners.mean(1).T], 1) / np.bincount(patch, area)[:, None]
    return normal, np.asarray(middle)


def slight_bends(corners: Floats, object_ids: Ints, patch: Longs, limits: Creases) -> Longs:
    """Count the edges over which each patch continues without a crease: facets of a curved surface have two or more.

    Those at its rim may have only one.
    """
    count = int(patch.max()) + 1 if len(patch) else 0
    if not count:
        return np.zeros(0, np.int64)
    a, b = twin_edges(corners)
    smooth = (patch[a // 3] != patch[b // 3]) & (object_ids[a // 3] == object_ids[b // 3])
    smooth &= goes_on(corners, a, b, object_ids, limits)
    return np.bincount(patch[np.concatenate([a[smooth], b[smooth]]) // 3], minlength=count)


def _extents(corners: Floats, patch: Longs) -> Floats:
    """Twice the greatest distance of each patch from its centre of area [m].

    A rectangle's is its diagonal. Unlike a box along the axes, it stays the same when the world is turned.
    """
    if not len(patch):
        return np.zeros(0)
    count = int(patch.max()) + 1
    area = face_normals(corners)[1]
    middles = corners.mean(1)
    centre: Floats = np.stack([np.bincount(patch, area * m, count) for m in middles.T], 1)
    centre /= np.bincount(patch, area, count)[:, None]
    out = np.zeros(count)
    np.maximum.at(out, patch, np.linalg.norm(corners - centre[patch, None], axis=2).max(1))
    return 2 * out


def _planar(corners: Floats, normals: Floats, object_ids: Ints, patch: Longs, curved: Bools) -> PlanarPatches:
    """Rims of patches: the directed edges that no neighbour of the same patch runs back along."""
    names, lead, patch = np.unique(patch, return_index=True, return_inverse=True)
    normal, middle = _planes(corners, normals, patch)
    flip = np.einsum("ni,ni->n", normals, normal[patch]) < 0
    turned = corners.copy()
    turned[flip] = corners[flip][:, ::-1]
    tri = welded(turned)
    start, end = tri.ravel(), np.roll(tri, -1, 1).ravel()
    of = np.repeat(patch, 3)
    wide = int(tri.max(initial=0)) + 1
    key, back = (of * wide + start) * wide + end, (of * wide + end) * wide + start
    outline = np.flatnonzero(~np.isin(key, back))
    outline = outline[np.argsort(of[outline], kind="stable")]
    first = np.searchsorted(of[outline], np.arange(len(names) + 1)).astype(np.int32)
    a = turned.reshape(-1, 3)[outline]
    b = np.roll(turned, -1, 1).reshape(-1, 3)[outline]
    offsets = np.einsum("ni,ni->n", normal, middle)
    order, loop_of, loops = _ordered(start[outline], end[outline], first)
    kept = _turning(a[order], b[order], loops, _rounded(corners))
    last = np.append(kept, len(order))[1:] - 1  # the edge that ends where the next one kept begins
    a, b = np.ascontiguousarray(a[order[kept]]), np.ascontiguousarray(b[order[last]])
    loops = np.searchsorted(kept, loops).astype(np.int32)
    first = loops[loop_of]
    mirrors, sizes, flat_of = _convex(turned, patch, normal, a, first, loop_of)
    across = _across(normal, first, a, b)
    spheres, widths = _extent(normal, offsets, across, first, a)
    return PlanarPatches(
        normal,
        offsets,
        object_ids[lead].copy(),
        spheres,
        first,
        a,
        b,
        loop_of,
        loops,
        mirrors,
        sizes,
        flat_of,
        widths,
        across,
        curved[lead],
    )


def _across(normals: Floats, first: Ints, starts: Floats, ends: Floats) -> Floats:
    """Two unit vectors (p, 2, 3) in each face: along its longest edge, the first of those as long, and across it.

    They turn with the face, so that what is asked for along them does not change when the world is turned.
    """
    if not len(normals):
        return np.zeros((0, 2, 3))
    edge = ends - starts
    size = np.linalg.norm(edge, axis=1)
    most = np.repeat(np.maximum.reduceat(size, first[:-1]), np.diff(first))
    long = np.flatnonzero(size > (1 - EVEN) * most)
    longest = long[np.searchsorted(long, first[:-1])]
    along = edge[longest] - np.einsum("ni,ni->n", edge[longest], normals)[:, None] * normals
    along /= np.linalg.norm(along, axis=1, keepdims=True)
    return np.stack([along, np.cross(normals, along)], 1)


def _extent(normals: Floats, offsets: Floats, across: Floats, first: Ints, starts: Floats) -> tuple[Floats, Floats]:
    """Sphere (p, 4) about the middle of each face, and its extent (p, 2), along two unit vectors (p, 2, 3) [m]."""
    if not len(across):
        return np.zeros((0, 4)), np.zeros((0, 2))
    of, begin = np.repeat(np.arange(len(across)), np.diff(first)), first[:-1]
    places = np.einsum("nij,nj->ni", across[of], starts)
    low, high = np.minimum.reduceat(places, begin), np.maximum.reduceat(places, begin)
    middle = np.einsum("ni,nij->nj", (low + high) / 2, across) + offsets[:, None] * normals
    radius = np.maximum.reduceat(np.linalg.norm(starts - middle[of], axis=1), begin)
    return np.column_stack([middle, radius]), high - low


def _ordered(start: Longs, end: Longs, first: Ints) -> tuple[Longs, Ints, Ints]:
    """An order that strings each face's rim into closed loops, the first loop of each face, and of loops the edge."""
    order: list[int] = []
    loops, loop_of = [0], [0]
    for p in range(len(first) - 1):
        leaving: dict[int, list[int]] = {}
        for e in range(first[p], first[p + 1]):
            leaving.setdefault(int(start[e]), []).append(e)
        while leaving:
            here = next(iter(leaving))
            while here in leaving:
                out = leaving[here]
                order.append(out.pop())
                if not out:
                    del leaving[here]
                here = int(end[order[-1]])
            loops.append(len(order))
        loop_of.append(len(loops) - 1)
    return np.asarray(order, np.int64), np.asarray(loop_of, np.int32), np.asarray(loops, np.int32)


def _turning(starts: Floats, ends: Floats, loops: Ints, rounded: float) -> Longs:
    """Edges (n) of rims to keep, so that each runs on to the next bend: cuts of neighbours leave none.

    The corner between two edges goes if it lies within the rounding [m] of their chord, every other one at a time.
    """
    kept = np.arange(len(starts))
    odd, idle = True, 0
    while len(kept) and idle < 2:
        begin = np.searchsorted(kept, loops)
        many = np.diff(begin)
        place = np.arange(len(kept)) - np.repeat(begin[:-1], many)
        before, last = starts[np.roll(kept, 1)], np.append(kept, len(starts))[1:] - 1
        back, ahead = starts[kept] - before, ends[last] - starts[kept]
        chord = np.linalg.norm(back + ahead, axis=1)
        off = np.linalg.norm(np.cross(back, ahead), axis=1) / np.maximum(chord, 1e-30)
        gone = (place > 0) & (place % 2 == odd) & (off <= rounded) & (np.einsum("ni,ni->n", back, ahead) > 0)
        gone &= np.repeat(many, many) > 3
        kept, odd, idle = kept[~gone], not odd, 0 if gone.any() else idle + 1
    return kept


def _convex(
    triangles: Floats, patch: Longs, normal: Floats, starts: Floats, first: Ints, loop_of: Ints
) -> tuple[Floats, Ints, Ints]:
    """Convex outlines that cover each face: its rim, sliced, where that is one convex loop; otherwise its triangles."""
    outlines: list[Floats] = []
    owner: list[int] = []
    by_face = np.argsort(patch, kind="stable")
    bound = np.searchsorted(patch[by_face], np.arange(len(normal) + 1))
    corners, begin, convex = _outlines(starts, first, normal)
    for p in range(len(normal)):
        if loop_of[p + 1] - loop_of[p] == 1 and convex[p] and begin[p + 1] - begin[p] >= 3:
            slices = _slices(corners[begin[p] : begin[p + 1]])
            outlines += slices
            owner += [p] * len(slices)
            continue
        parts = triangles[by_face[bound[p] : bound[p + 1]]]
        outlines += list(parts)
        owner += [p] * len(parts)
    out = np.zeros((len(outlines), MIRROR_CORNERS, 3))
    for i, outline in enumerate(outlines):
        out[i, : len(outline)] = outline
    return out, np.array([len(o) for o in outlines], np.int32), np.asarray(owner, np.int32)


def _slices(outline: Floats) -> list[Floats]:
    """A convex outline (n, 3) in slices of at most `MIRROR_CORNERS` corners about its first corner."""
    step = MIRROR_CORNERS - 2
    return [np.concatenate([outline[:1], outline[i : i + step + 1]]) for i in range(1, len(outline) - 1, step)]


def _outlines(starts: Floats, first: Ints, normal: Floats) -> tuple[Floats, Longs, Bools]:
    """Rims as one loop each without the corners at which they run straight on, where each begins; which are convex."""
    of = np.repeat(np.arange(len(normal)), np.diff(first))
    before, after = _neighbours(first)
    back, ahead = starts - starts[before], starts[after] - starts
    bend = np.linalg.norm(np.cross(back, ahead), axis=1)
    turns = bend > 1e-7 * np.linalg.norm(back, axis=1) * np.linalg.norm(ahead, axis=1)
    corners, of = starts[turns], of[turns]
    begin = np.searchsorted(of, np.arange(len(normal) + 1))
    _, after = _neighbours(begin)
    step = corners[after] - corners
    inward = np.einsum("ni,ni->n", np.cross(step, step[after]), normal[of]) <= 0
    return corners, begin, np.bincount(of[inward], minlength=len(normal)) == 0


def _neighbours(first: NDArray[np.integer]) -> tuple[Longs, Longs]:
    """Of every corner of loops that begin at `first`, the one before it and the one after it."""
    count = np.diff(first)
    here = np.arange(first[-1])
    begin, last = np.repeat(first[:-1], count), np.repeat(first[1:], count) - 1
    return np.where(here == begin, last, here - 1), np.where(here == last, begin, here + 1)


def joined(parts: Sequence[PlanarPatches]) -> PlanarPatches:
    """The flat faces of several parts as one."""
    if len(parts) == 1:
        return parts[0]

    def strung(name: str, shift: str) -> Ints:
        ends, pieces = 0, [np.zeros(1, np.int32)]
        for part in parts:
            row = getattr(part, name)
            pieces.append((row[1:] + ends).astype(np.int32))
            ends += len(getattr(part, shift))
        return np.concatenate(pieces)

    def loose(name: str) -> Floats:
        return np.concatenate([getattr(part, name) for part in parts])

    loops = [part.loops[:1] for part in parts[:1]]
    edges = count = faces = 0
    loop_of, flat_of = [np.zeros(1, np.int32)], []
    for part in parts:
        loops.append(part.loops[1:] + edges)
        loop_of.append(part.loop_of[1:] + count)
        flat_of.append(part.flat_of + faces)
        edges, count, faces = edges + len(part.starts), count + len(part.loops) - 1, faces + len(part)
    return PlanarPatches(loose("normals"), loose("offsets"), loose("object_ids").astype(np.int32), loose("spheres"),
                 strung("first", "starts"), loose("starts"), loose("ends"),
                 np.concatenate(loop_of).astype(np.int32), np.concatenate(loops).astype(np.int32), loose("mirrors"),
                 loose("sizes").astype(np.int32), np.concatenate(flat_of).astype(np.int32),
                 loose("widths"), loose("across"), loose("smooth").astype(np.bool_))  # fmt: skip


def _clusters(centres: Floats, sizes: Floats) -> tuple[Longs, Ints]:
    """An order of the triangles and where each cluster starts: halves along the longest side, large ones alone."""
    order, first = np.arange(len(centres)), np.arange(min(len(centres), 1))
    while len(first):
        here, count = centres[order], np.diff(first, append=len(order))
        span = np.maximum.reduceat(here, first) - np.minimum.reduceat(here, first)
        small = span.max(1) < 2 * np.maximum(np.maximum.reduceat(sizes[order], first), 0.5)
        split = ((count > _CLUSTER) | ~small) & (count > 1)
        if not split.any():
            break
        cluster, axis = np.repeat(np.arange(len(first)), count), span.argmax(1)
        rank = np.where(split[cluster], here[np.arange(len(order)), axis[cluster]], 0.0)
        order = order[np.lexsort((rank, cluster))]
        first = np.sort(np.concatenate([first, (first + count // 2)[split]]))
    return order, np.append(first, len(order)).astype(np.int32)


def _spheres(corners: Floats, first: Ints) -> Floats:
    """Spheres (k, 4) about clusters of triangles (f, 3, 3) that hold the sphere of each of them.

    Kernels leave out clusters beyond the gate, then triangles beyond it. Clusters follow the axes of the world. They
    must leave out nothing that the test of a triangle keeps: its range may fold to the start of the frame.
    """
    if not len(corners):
        return np.zeros((0, 4))
    low, high = corners.min(1), corners.max(1)
    middle = (np.minimum.reduceat(low, first[:-1]) + np.maximum.reduceat(high, first[:-1])) / 2
    radii = BALL * np.linalg.norm(np.roll(corners, -1, 1) - corners, axis=2).max(1)
    away = np.linalg.norm(corners.mean(1) - np.repeat(middle, np.diff(first), axis=0), axis=1)
    return np.column_stack([middle, np.maximum.reduceat(away + radii, first[:-1])])
