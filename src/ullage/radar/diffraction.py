"""Edges of conductors: where physical optics is corrected for the currents that bend around them.

Every straight edge at which a conducting mesh ends, or turns by more than its crease, is a wedge whose free space has
an angle n pi: n = 2 at the rim of a sheet, 1.5 at the edge of a box. The fringe currents of that wedge
[Michaeli1986], [Ufimtsev2007] are added to first-bounce echoes. Left out: inner corners (n < 1), edges that another
surface touches, edges of what lets waves through, and bodies narrower than a quarter wave.
"""

from __future__ import annotations

from dataclasses import dataclass, fields, replace
from functools import lru_cache

import numpy as np

from ullage.arrays import Bools, Floats, Ints, Longs
from ullage.radar import corner_diffraction as corner
from ullage.radar import double_diffraction as double
from ullage.radar.echo_set import Rows
from ullage.world.raycast import Raycaster
from ullage.world.scene import Scene
from ullage.world.smoothing import creases, face_normals, goes_on, half_edges, linked, welded

NARROW = 0.25
"""Faces narrower than this part of a wave are the side of a thin plate, or no face at all."""
_AROUND_M = 0.01  # nothing may cut a circle of this radius about an edge
_STRAIGHT_RAD = 1e-3  # edges that turn by less, and lie off one line by a smaller share of it, are one
_FEW = 100  # so many corners are looked at twice sooner than sorted
_STEP_M = 0.25  # an edge is tested at its middle, and cut so that there is one at least so often


@dataclass(frozen=True, slots=True, eq=False)
class Edges(Rows):
    """Straight edges of conducting bodies, in the frame of their objects."""

    POINTS, DIRECTIONS = ("starts", "ends"), ("inward", "normals")
    starts: Floats  # (w, 3) [m]
    ends: Floats  # (w, 3) [m]
    angles: Floats  # (w) of the free space, over pi
    inward: Floats  # (w, 2, 3) unit vectors in both faces, away from the edge
    normals: Floats  # (w, 2, 3) of both faces, into the free space
    widths: Floats  # (w, 2) of both faces across the edge [m]
    object_ids: Ints  # (w) object
    surfaces: Longs  # (w, 2) smooth surface on both sides


@dataclass(frozen=True, slots=True, eq=False)
class Sharp:
    """All edges of a scene, those that face each other, and the corners where they meet."""

    edges: Edges
    pairs: double.Pairs
    corners: corner.Corners


@dataclass(frozen=True, slots=True, eq=False)
class OutlineSet:
    """Edges as one wavelength has them: sides of thin plates are no faces."""

    edges: Edges
    transmissive: Bools  # (w) rim of a thin body: only its first face counts
    pairs: double.Pairs
    both: Bools  # (p) the wave runs over both sides
    bare: Bools  # (p) of a sheet, which a wave from behind meets too
    strong: Floats  # (p) strength of the wave across over that of an edge by itself, at most
    closed: Bools  # (p) of thin bodies with free edges all around
    corners: corner.Corners
    corners_bare: Bools  # (c) of a sheet, which a wave from behind meets too


def sharp_edges(scene: Scene, still: Raycaster) -> Sharp:
    """All edges of the scene's conductors that stand free.

    Args:
        scene: what there is.
        still: rays over all that does not move.
    """
    conducts = np.array([o.material.conductor for o in scene.objects], bool)
    moves = np.array([o.motion is not None for o in scene.objects], bool)
    owner = scene.face_object
    if not len(scene.faces) or not conducts.any():
        return nowhere()
    found = [_free(_edges(scene, conducts[owner] & ~moves[owner]), still)]
    for index in np.flatnonzero(conducts & moves):
        mine = owner == index
        thing = replace(scene.objects[index], motion=None)
        alone = Scene(scene.vertices, scene.faces[mine], np.zeros(mine.sum(), np.int32), (thing,))
        edges = _free(_edges(alone, np.ones(len(alone.faces), bool)), Raycaster(alone))
        found.append(replace(edges, object_ids=np.full(len(edges), index, np.int32)))
    pairs, corners = double.Pairs.joined([_pairs(e) for e in found]), [_corners(e) for e in found]
    return Sharp(Edges.joined(found), pairs, corner.Corners.joined(corners))


def nowhere() -> Sharp:
    """No edges at all."""
    return Sharp(_none(), _pairs(_none()), _corners(_none()))


def _pairs(edges: Edges) -> double.Pairs:
    return double.facing_pairs(*(getattr(edges, f.name) for f in fields(edges)))


def _corners(edges: Edges) -> corner.Corners:
    return corner.face_corners(*(getattr(edges, f.name) for f in fields(edges)))


def outlines_of(sharp: Sharp, wavelength_m: float) -> OutlineSet:
    """The edges that count at a wavelength [m], the wide face first where the other is the side of a thin plate."""
    edges = sharp.edges
    wide = edges.widths >= NARROW * wavelength_m
    kept = np.asarray(wide.any(1))
    held, wide = edges.take(kept), wide[kept]
    order = np.where(wide[:, :1], [[0, 1]], [[1, 0]])
    row = np.arange(len(held))[:, None]
    held = replace(held, inward=held.inward[row, order], normals=held.normals[row, order],
                   widths=held.widths[row, order])  # fmt: skip
    pairs, both, bare, closed = double.at_wavelength(sharp.pairs, NARROW * wavelength_m)
    gaps_m = np.linalg.norm(pairs.gaps, axis=1)
    return OutlineSet(
        held, np.asarray(~wide.all(1)), pairs, both, bare, 4 * np.sqrt(wavelength_m / gaps_m) / (2 * np.pi),
        closed, *corner.at_wavelength(sharp.corners, NARROW * wavelength_m),
    )  # fmt: skip


@lru_cache(maxsize=8)
def outward(edges: Edges) -> Floats:
    """Unit vectors (w, 3) from edges into the middle of their open sides."""
    half = (edges.angles * np.pi / 2)[:, None]
    return np.asarray(np.cos(half) * edges.inward[:, 0] + np.sin(half) * edges.normals[:, 0])


@lru_cache(maxsize=8)
def equal_factors(edges: Edges) -> Floats:
    """Factors (w) of 1 for the strengths of edges."""
    return np.ones(len(edges))


def _none() -> Edges:
    triple, pair = np.zeros((0, 3)), np.zeros((0, 2, 3))
    return Edges(triple, triple, np.zeros(0), pair, pair, np.zeros((0, 2)), np.zeros(0, np.int32),
                 np.zeros((0, 2), np.int64))  # fmt: skip


def _edges(scene: Scene, chosen: Bools) -> Edges:
    """Edges where the chosen faces end or turn, whether or not anything touches them."""
    corners = scene.vertices[scene.faces[chosen]]
    normals, area = face_normals(corners)
    held = area > 1e-12
    corners, normals, object_ids = corners[held], normals[held], scene.face_object[chosen][held]
    if not len(corners):
        return _none()
    ids, tri = welded(corners), np.repeat(np.arange(len(corners)), 3)
    order, first, count = half_edges(ids)
    inward = _inward(corners, normals)
    limits = creases(scene.objects)
    a, b = order[first[count == 2]], order[first[count == 2] + 1]
    even = goes_on(corners, a, b, object_ids, limits)
    crease = np.radians(limits.deg[object_ids[tri]])
    pairs = _wedges(np.stack([a, b], 1)[~even], order, first, count, inward, crease)
    if not len(pairs):
        return _none()
    smooth = linked(tri[a[even]], tri[b[even]], len(corners))
    lead = pairs[:, 0]
    a, b = corners.reshape(-1, 3)[lead], corners.reshape(-1, 3)[lead - lead % 3 + (lead + 1) % 3]
    into = inward[pairs]
    n1, n2, angle = _open(into, normals[tri[lead]])
    surfaces = smooth[tri[pairs]]
    widths = _widths(corners, smooth, a, into, surfaces)
    found = Edges(a, b, angle, into, np.stack([n1, n2], 1), widths, object_ids[tri[lead]], surfaces)
    return _joined(found, np.stack([ids, np.roll(ids, -1, 1)], -1).reshape(-1, 2)[lead])


def _joined(edges: Edges, ids: Longs) -> Edges:
    """Join edges that continue each other along one line, by ids (w, 2) of their corners; the first of each stays.

    A mesh may cut a straight edge into any number of parts. Each part alone would end in two waves of its own.
    """
    line = linked(*_continued(edges, ids), len(edges))
    total = int(line.max()) + 1
    lead = np.full(total, len(edges))
    np.minimum.at(lead, line, np.arange(len(edges)))
    points, of = np.stack([edges.starts, edges.ends], 1).reshape(-1, 3), np.repeat(line, 2)
    places = np.einsum("ni,ni->n", points, (edges.ends - edges.starts)[lead[of]])
    order = np.lexsort((places, of))
    begin = np.searchsorted(of[order], np.arange(total + 1))
    low, high = points[order[begin[:-1]]], points[order[begin[1:] - 1]]
    chord = high - low
    square = np.maximum((chord**2).sum(1), 1e-300)
    bent = np.zeros(total)
    np.maximum.at(bent, of, np.linalg.norm(np.cross(points - low[of], chord[of]), axis=1) / square[of])
    whole = bent < _STRAIGHT_RAD
    starts, ends = edges.starts.copy(), edges.ends.copy()
    starts[lead[whole]], ends[lead[whole]] = low[whole], high[whole]
    kept = ~whole[line] | (lead[line] == np.arange(len(edges)))
    return replace(edges, starts=starts, ends=ends).take(kept)


def _continued(edges: Edges, ids: Longs) -> tuple[Longs, Longs]:
    """Links between edges of the same two surfaces that meet at a corner and hardly turn there."""
    swapped = edges.surfaces[:, 0] > edges.surfaces[:, 1]
    sides = np.where(swapped[:, None], edges.surfaces[:, ::-1], edges.surfaces)
    inward = np.where(swapped[:, None, None], edges.inward[:, ::-1], edges.inward)
    at, of = ids.reshape(-1), np.repeat(np.arange(len(edges)), 2)
    order = np.lexsort((of, sides[of, 1], sides[of, 0], at))
    at, of = at[order], of[order]
    a, b = of[:-1], of[1:]
    alike = (at[:-1] == at[1:]) & (sides[a] == sides[b]).all(1)
    alike &= np.einsum("nfi,nfi->nf", inward[a], inward[b]).min(1) > np.cos(_STRAIGHT_RAD)
    return a[alike], b[alike]


def _inward(corners: Floats, normals: Floats) -> Floats:
    """Of every half edge: the unit vector in its triangle, across it and away from it (3 f, 3)."""
    along = np.roll(corners, -1, 1) - corners
    out = np.cross(normals[:, None], along)
    out /= np.maximum(np.linalg.norm(out, axis=2, keepdims=True), 1e-300)
    return np.asarray(out.reshape(-1, 3))


def _wedges(folded: Longs, order: Longs, first: Longs, count: Longs, inward: Floats, crease: Floats) -> Longs:
    """Half edges (w, 2) of the two faces that bound the open side of each edge; twice the same at a rim.

    `folded` (n, 2) are those where just two faces meet in a crease; where more do, the open side has a bend (h) [rad].
    """
    alone = order[first[count == 1]]
    out = [np.stack([alone, alone], 1), folded]
    for start, many in zip(first[count > 2], count[count > 2], strict=True):
        halves = order[start : start + many]
        into = inward[halves]
        axis = np.linalg.svd(into)[2][-1]
        side = np.cross(axis, into[0])
        angle = np.arctan2(into @ side, into @ into[0])
        rank = np.argsort(angle)
        gap = np.diff(np.r_[angle[rank], angle[rank[0]] + 2 * np.pi])
        widest = int(gap.argmax())
        if gap[widest] > np.pi + crease[halves[0]]:
            out.append(halves[rank[[widest, (widest + 1) % many]]][None])
    wedges = np.concatenate(out).astype(np.int64)
    return wedges[np.argsort(wedges.min(1))]  # in an order that does not depend on coordinates


def _open(into: Floats, normal: Floats) -> tuple[Floats, Floats, Floats]:
    """Normals of both faces into the open side, and its angle over pi, from the faces' directions (w, 2, 3)."""
    x1, x2 = into[:, 0], into[:, 1]
    cosine = np.clip(np.einsum("ni,ni->n", x1, x2), -1, 1)
    away1, away2 = cosine[:, None] * x1 - x2, cosine[:, None] * x2 - x1
    size = np.linalg.norm(away1, axis=1)
    flat = size < 1e-6
    n1 = np.where(flat[:, None], normal, away1 / np.maximum(size, 1e-300)[:, None])
    n2 = np.where(flat[:, None], -normal, away2 / np.maximum(size, 1e-300)[:, None])
    return n1, n2, np.asarray(2 - np.where(flat, 0.0, np.arccos(cosine)) / np.pi)


def _widths(corners: Floats, smooth: Longs, a: Floats, into: Floats, piece: Longs) -> Floats:
    """How far the surfaces on both sides reach across the edge (w, 2) [m]."""
    out = np.zeros(piece.shape)
    rank = np.argsort(smooth, kind="stable")
    bound = np.searchsorted(smooth[rank], np.arange(smooth.max() + 2))
    for p in np.unique(piece):
        points = corners[rank[bound[p] : bound[p + 1]]].reshape(-1, 3)
        if len(points) > _FEW:
            points = np.unique(points, axis=0)
        for side in range(2):
            mine = np.flatnonzero(piece[:, side] == p)
            for e in mine:
                out[e, side] = ((points - a[e]) @ into[e, side]).max()
    return out


def _free(edges: Edges, rays: Raycaster) -> Edges:
    """The parts of edges around which nothing stands in the open side."""
    if not len(edges):
        return edges
    length = np.linalg.norm(edges.ends - edges.starts, axis=1)
    parts = np.maximum(np.ceil(length / _STEP_M - 1e-6), 1).astype(
        int
    )  # lengths are mostly whole steps, but for rounding
    of = np.repeat(np.arange(len(edges)), parts)
    step = np.arange(len(of)) - np.repeat(np.cumsum(parts) - parts, parts)
    share = (step + 0.49) / parts[of]  # just off the middle, in whose plane other bodies often end
    middle = edges.starts[of] + share[:, None] * (edges.ends - edges.starts)[of]
    open_ = _circled(edges.take(of), middle, rays)
    return _strung(edges, of, step, parts, open_)


def _circled(edges: Edges, middle: Floats, rays: Raycaster) -> Bools:
    """Whether an arc from face to face about each point meets nothing."""
    steps = 11  # odd, so that no chord ends half way round, where surfaces through the edge mostly lie
    share = np.linspace(0, 1, steps + 1)
    turn = 0.12 + share * (edges.angles[:, None] * np.pi - 0.24)
    x, n = edges.inward[:, 0], edges.normals[:, 0]
    arc = middle[:, None] + _AROUND_M * (np.cos(turn)[..., None] * x[:, None] + np.sin(turn)[..., None] * n[:, None])
    clear = rays.visible(arc[:, :-1].reshape(-1, 3), arc[:, 1:].reshape(-1, 3), slack_m=0.0)
    return np.asarray(clear.reshape(-1, steps).all(1))


def _strung(edges: Edges, of: Longs, step: Longs, parts: Longs, open_: Bools) -> Edges:
    """Neighbouring open parts of an edge as one."""
    begins = open_ & ~np.r_[False, open_[:-1] & (of[1:] == of[:-1])]
    stops = open_ & ~np.r_[open_[1:] & (of[1:] == of[:-1]), False]
    whole = edges.take(of[begins])
    along = edges.ends[of[begins]] - edges.starts[of[begins]]
    low, high = step[begins] / parts[of[begins]], (step[stops] + 1) / parts[of[stops]]
    return replace(whole, starts=whole.starts + low[:, None] * along, ends=whole.starts + high[:, None] * along)
