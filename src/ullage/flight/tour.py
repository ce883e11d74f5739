"""Plan a default flight: through the free space of any world, near what there is to see, clear of everything.

At a few heights the world is drawn on a lattice: every surface and wire within the height that the vehicle needs. Cells
that keep the clearance are free. Connected free cells are one space. Enclosed spaces are preferred to the open air
around things, and the inside of a solid does not count. The flight visits places far apart in the best space by
shortest paths.
"""

from __future__ import annotations

import math
import warnings
from collections.abc import Callable, Iterator
from dataclasses import dataclass

import numpy as np
from scipy.ndimage import distance_transform_edt, label

from ullage.arrays import Bools, Floats, Longs
from ullage.errors import InputError, UllageWarning
from ullage.flight.airframe import airframe
from ullage.flight.missions import Waypoints
from ullage.flight.obstacles import Solids, bodies
from ullage.flight.random_flights import LATTICE_M, lattice_graph, visit_far_places
from ullage.world.raycast import Raycaster
from ullage.world.scene import Scene

CLEARANCES_M = (0.8, 0.6, 0.45)  # to the side; the first that leaves room to fly is taken
HEADROOM_M = 0.25  # above and below the vehicle
REACH_M = 5.0  # objects within this distance are worth a visit
SIGHT_M = 9.0  # a floor or roof within this distance is seen
AROUND_M = 2.5  # room about the world's box
WINDOW_M = 60.0  # longest edge of the area that is searched
LENGTH_M = (12.0, 30.0)  # least and greatest length of a flight
LENGTH_SHARE = 3.0  # length of a flight through a space over the square root of its area
LEAST_AREA_M2 = 1.0
ENOUGH_AREA_M2 = 30.0  # a larger space is not better
HULL = 0.9  # share of the world's box that a closed surface spans, if one flies inside it
SHARES = {0.5: 1.0, 0.35: 0.8, 0.65: 0.8, 0.2: 0.5, 0.8: 0.5}  # of the world's height, and how good a flight there is
ABOVE_M = {1.5: 0.6, 3.0: 0.4}  # the same over its lowest point, as for a flat world
FLAT_M, FLAT_WORTH = 0.05, 0.2  # a world no higher is flat, and better flown over than around
LARGE_M = 1000.0  # a world this large may be one in millimetres
MOMENTS = 12  # at which moving things are drawn
RAYS = 400  # points of a space from which its walls are sought


@dataclass(frozen=True, slots=True, eq=False)
class Level:
    """The lattice at one height."""

    z_m: float
    worth: float  # of a flight at this height, 0 to 1
    corner_m: Floats  # (2) centre of the first cell
    gap_m: Floats  # (ny, nx) to the nearest surface at this height, level

    def points(self, cells: Longs) -> Floats:
        """Centres (n, 3) of cells (n, 2) [m]."""
        xy = self.corner_m + LATTICE_M * cells[:, ::-1]
        return np.column_stack([xy, np.full(len(cells), self.z_m)])


@dataclass(frozen=True, slots=True, eq=False)
class Space:
    """Connected free cells of one level."""

    level: Level
    cells: Bools  # (ny, nx)
    score: float


def tour(scene: Scene, *, vehicle: str = "hector", length_m: float | None = None, speed_m_s: float = 0.5) -> Waypoints:
    """Visit places far apart in the free space of a world, at one height.

    Args:
        scene: the world.
        vehicle: name of what flies, for its size.
        length_m: greatest length of the flight [m]; None: 12 to 30 m, by the size of the space.
        speed_m_s: [m/s].

    Raises:
        InputError: the world is empty, or leaves no room to fly near its surfaces.
    """
    if not len(scene.faces) and not len(scene.wires):
        allowed = "a world with collision shapes, or -o world.geometry=visual"
        raise InputError(
            "the world holds no shapes, so there is nothing to fly past", where=scene.name, allowed=allowed
        )
    size = np.ptp(scene.bounds, axis=0)
    if size.max() > LARGE_M:
        what = f"{scene.name} is {_edges(size)} m large; is it in millimetres? ullage reads metres"
        warnings.warn(what, UllageWarning, stacklevel=2)
    half_height = airframe(vehicle).half_height_m + HEADROOM_M
    world = _World(scene)
    there = list(_moments(scene))
    levels = [_level(scene.bounds, there, z, worth, half_height) for z, worth in _heights(scene).items()]
    for clearance in CLEARANCES_M:
        if spaces := [space for level in levels for space in _spaces(world, level, clearance)]:
            return Waypoints(_route(max(spaces, key=lambda space: space.score), length_m), speed_m_s)
    raise InputError(
        f"no free space to fly in: the world is {_edges(size)} m", where=scene.name,
        allowed=f"a world in metres with {2 * CLEARANCES_M[-1]:g} m between its surfaces, or -o flight.waypoints=[...]",
    )  # fmt: skip


def _edges(size: Floats) -> str:
    return " x ".join(f"{edge:.3g}" for edge in size)


def _heights(scene: Scene) -> dict[float, float]:
    """Heights to fly at [m], and how good each is."""
    low, high = scene.bounds[:, 2]
    at_best = 1.0 if high - low > FLAT_M else FLAT_WORTH
    within = {low + share * (high - low): at_best * good for share, good in SHARES.items()}
    return {low + above: good for above, good in ABOVE_M.items()} | within


def level_at(scene: Scene, z_m: float, *, vehicle: str = "hector") -> Level:
    """Draw all that a vehicle at a height could touch, and measure how far each cell is from it.

    Args:
        scene: the world.
        z_m: height of the flight [m].
        vehicle: name of what flies, for its size.
    """
    return _level(scene.bounds, list(_moments(scene)), z_m, 1.0, airframe(vehicle).half_height_m)


def _level(box: Floats, there: list[Floats], z_m: float, worth: float, half_height_m: float) -> Level:
    """Draw all that a vehicle at this height could touch, and measure how far each cell is from it."""
    from PIL import Image, ImageDraw

    slab = (z_m - half_height_m, z_m + half_height_m)
    parts = [_seen_from_above(shapes, slab) for shapes in there]
    dots = np.concatenate([some for some, _ in parts])
    outlines = [outline for _, some in parts for outline in some]
    low, high = _window(box, np.concatenate([dots, *(outline.mean(0, keepdims=True) for outline in outlines)]))
    dots = np.concatenate([dots, *outlines])  # an upright line is one point, which no pen draws
    count = np.maximum(np.ceil((high - low) / LATTICE_M).astype(int), 1) + 1
    canvas = Image.new("1", tuple(count.tolist()))
    pen = ImageDraw.Draw(canvas)
    for outline in outlines:
        pixels = np.rint((outline - low) / LATTICE_M)
        if (pixels.max(0) >= 0).all() and (pixels.min(0) < count).all():
            around = [tuple(pixel) for pixel in np.clip(pixels, -1e6, 1e6).tolist()]
            pen.polygon(around, fill=1, outline=1)
            pen.line(around, fill=1)
    taken = np.array(canvas)
    cells = np.rint((dots - low) / LATTICE_M).astype(int)
    x, y = cells[((cells >= 0) & (cells < count)).all(1)].T
    taken[y, x] = True
    gap = distance_transform_edt(~taken) * LATTICE_M if taken.any() else np.full(taken.shape, math.inf)
    return Level(z_m, worth, low, gap)


def _moments(scene: Scene) -> Iterator[Floats]:
    """Faces (f, 3, 3), then wires (w, 2, 3) [m]: all at the start, then what moves at later times."""
    yield scene.corners()
    yield scene.wire_ends()
    motions = [thing.motion for thing in scene.objects if thing.motion is not None]
    if motions:
        moving = np.array([thing.motion is not None for thing in scene.objects], bool)
        first, last = min(int(m.t_ns[0]) for m in motions), max(int(m.t_ns[-1]) for m in motions)
        for t_ns in np.linspace(first, last, MOMENTS).astype(np.int64)[1:].tolist():
            yield scene.corners(t_ns)[moving[scene.face_object]]
            yield scene.wire_ends(t_ns)[moving[scene.wires.object_id]]


def _seen_from_above(shapes: Floats, slab: tuple[float, float]) -> tuple[Floats, list[Floats]]:
    """Cut faces or wires (n, k, 3) between two heights: corners of small ones (d, 2), outlines of others."""
    low, high = shapes.min(1), shapes.max(1)
    met = (high[:, 2] >= slab[0]) & (low[:, 2] <= slab[1])
    small = met & (high - low < LATTICE_M / 2).all(1)
    whole = met & ~small & (low[:, 2] >= slab[0]) & (high[:, 2] <= slab[1])
    outlines = [*shapes[whole][..., :2], *(_clipped(shape, slab) for shape in shapes[met & ~small & ~whole])]
    return shapes[small].reshape(-1, 3)[:, :2], [outline for outline in outlines if len(outline)]


def _clipped(shape: Floats, slab: tuple[float, float]) -> Floats:
    """Corners (k, 2) of a flat convex shape (n, 3) cut off below and above two heights [SutherlandHodgman1974]."""
    for sign, height in ((1.0, slab[0]), (-1.0, -slab[1])):
        over = sign * shape[:, 2] - height
        kept = []
        for k in range(len(shape)):
            a, b = over[k - 1], over[k]
            if (a < 0) != (b < 0):
                kept.append(shape[k - 1] + a / (a - b) * (shape[k] - shape[k - 1]))
            if b >= 0:
                kept.append(shape[k])
        if not kept:
            return np.zeros((0, 2))
        shape = np.array(kept)
    return shape[:, :2]


def _window(box: Floats, there: Floats) -> tuple[Floats, Floats]:
    """The corners (2) of the area that is searched [m]: the world's box and some room, or a part about its middle."""
    low, high = box[:, :2] + np.array([[-AROUND_M], [AROUND_M]])
    middle = np.clip(np.median(there, axis=0), low, high) if len(there) else (low + high) / 2
    return np.maximum(low, middle - WINDOW_M / 2), np.minimum(high, middle + WINDOW_M / 2)


def _spaces(world: _World, level: Level, clearance_m: float) -> list[Space]:
    """Return the spaces at one height that are large enough, near a surface, and outside solids."""
    near = level.gap_m <= REACH_M
    beside = bool(near.any())
    if not beside:  # no surface at this height: those in sight are above or below
        rows, columns = (np.abs(np.arange(n) - n // 2) * LATTICE_M < REACH_M / 2 for n in near.shape)
        near = rows[:, None] & columns
    part, count = label(near & (level.gap_m >= clearance_m + LATTICE_M), np.ones((3, 3)))
    out = []
    for k in range(1, count + 1):
        cells = part == k
        area = float(cells.sum()) * LATTICE_M**2
        points = level.points(np.argwhere(cells))
        seen = area >= LEAST_AREA_M2 and (beside or world.sees_up_or_down(points))
        if seen and not world.solid(points[np.argmax(level.gap_m[cells])]):
            score = level.worth * min(area, ENOUGH_AREA_M2) * (0.1 + world.enclosure(points) ** 3)
            out.append(Space(level, cells, score))
    return out


class _World:
    """A scene, the solids in it, and rays through it."""

    def __init__(self, scene: Scene) -> None:
        self.box = scene.bounds
        self.solids = Solids(bodies(scene)[0])
        self.caster = Raycaster(scene)

    def solid(self, point: Floats) -> bool:
        """Whether a point (3) lies in a closed surface other than a hull that holds the whole world."""
        sizes = [self.solids.size_m(number) for number, _ in self.solids.holding(point)]
        return any((size < HULL * np.ptp(self.box, axis=0)).any() for size in sizes)

    def sees_up_or_down(self, points: Floats) -> bool:
        """Whether a floor or roof is in sight from any of the points (n, 3)."""
        rays = np.repeat([[0.0, 0.0, -1.0], [0.0, 0.0, 1.0]], len(points), 0)
        return bool((self.caster.hits(np.tile(points, (2, 1)), rays)[1] <= SIGHT_M).any())

    def enclosure(self, points: Floats) -> float:
        """Return the share of horizontal and upward directions with a surface, over points (n, 3) of a space."""
        some = points[:: -(-len(points) // RAYS)]
        turn = np.arange(8) * np.pi / 4
        level = np.stack([np.cos(turn), np.sin(turn), 0 * turn], 1)
        up = np.array([[0.0, 0.0, 1.0]])
        rays = np.concatenate([level, (level + up) / math.sqrt(2), up])
        face, _ = self.caster.hits(np.repeat(some, len(rays), 0), np.tile(rays, (len(some), 1)))
        return float((face >= 0).mean())


def _route(space: Space, length_m: float | None) -> Floats:
    """Return waypoints (n, 3) through a space [m]: shortest paths between far places, as straight segments."""
    if length_m is None:
        length_m = float(np.clip(LENGTH_SHARE * LATTICE_M * math.sqrt(space.cells.sum()), *LENGTH_M))
    cells, graph = np.argwhere(space.cells), lattice_graph(space.cells)

    def straight(nodes: Longs) -> list[int]:
        on = cells[nodes]
        return straightened(len(on), lambda i, j: bool(space.cells[between(on[i], on[j])].all()))

    points = space.level.points(cells)
    legs = visit_far_places(graph, points, np.random.default_rng(0), length_m=length_m)
    kept = [legs[0]]
    for leg in legs[1:]:
        whole = np.concatenate([kept[-1][-1:], leg])
        kept.append(whole[straight(whole)[1:]])
    return _cut(points[np.concatenate(kept)], length_m)


def _cut(points: Floats, length_m: float) -> Floats:
    """The line of points (n, 3) up to a length [m]."""
    along = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(points, axis=0), axis=1))])
    end = min(length_m, along[-1])
    last = np.array([np.interp(end, along, points[:, k]) for k in range(3)])
    return np.concatenate([points[along < end - 1e-6], last[None]])


def straightened(count: int, joined: Callable[[int, int], bool]) -> list[int]:
    """Return indices of the cells of a path to keep, whose next one is the farthest that is joined by a segment."""
    kept = [0]
    while kept[-1] < count - 1:
        reach = kept[-1] + 1
        while reach + 1 < count and joined(kept[-1], reach + 1):
            reach += 1
        kept.append(reach)
    return kept


def between(a: Longs, b: Longs) -> tuple[Longs, Longs]:
    """Return rows and columns of the cells that the straight line between two cells crosses."""
    on = np.rint(np.linspace(a, b, 2 * int(np.abs(b - a).max()) + 1)).astype(int)
    return on[:, 0], on[:, 1]
