"""Draw random worlds by kind and seed: rooms, halls, tanks and hoppers with the objects in them.

Each kind is one builder. It draws sizes, materials and objects, and states where a drone has room to fly. Thresholds
may be tuned on the kinds in `TUNING` only. The kinds in `TESTING` are kept apart, so that a method is judged on worlds
that it was not made for.
"""

from __future__ import annotations

import difflib
import itertools
import zlib
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike
from shapely import LineString, MultiLineString, Point, Polygon, affinity, box, get_parts, union_all
from shapely.geometry.polygon import orient

from ullage.arrays import Floats
from ullage.config import split_source
from ullage.errors import InputError
from ullage.world import shapes
from ullage.world.enclosures import Tunnel, WebTank, bent_line, tunnel_parts, web_tank_parts
from ullage.world.load import load_scene
from ullage.world.materials import material
from ullage.world.scene import Scene
from ullage.world.section import section, wire_section
from ullage.world.shapes import Shape
from ullage.world.solids import Part, Rod, Solid, block, clean, flat, join, moved, scene_of, turned_over

TUNING = ("room", "corridor", "tank", "machines", "shelves")
"""Kinds on which thresholds may be chosen."""
TESTING = ("polygon", "pillars", "hopper", "lying-tank", "office", "open", "web-frames", "tunnel")
"""Kinds on which methods are judged."""
KINDS = (*TUNING, *TESTING)

WALLS = ("concrete", "brick", "steel", "plasterboard", "wood")
TANK_WALLS = ("steel", "concrete")
MARGIN_M = 0.3  # above and below the heights of flight in which objects count as obstacles
THIN_M = 0.02  # half width that surfaces of a world file get when room to fly is sought
SEGMENT_M = 0.1  # chord of a facet of a round wall; flat facets this narrow still act as a curved mirror


@dataclass(slots=True, eq=False)
class Plan:
    """A world while it is drawn, and where a drone may fly in it."""

    kind: str
    seed: int
    rng: np.random.Generator
    base: Scene | None = None  # the world of a file, to which objects are added
    footprint: Any = None  # shapely polygon: the level area that the walls leave open [m]
    band_m: tuple[float, float] = (0.0, 0.0)  # least and greatest height of flight [m]
    parts: list[Solid] = field(default_factory=list)
    obstacles: list[tuple[Any, float, float]] = field(default_factory=list)  # outline, bottom and top [m]

    def add(self, part: Solid, outline: Any, bottom_m: float, top_m: float) -> None:
        """Add an object that blocks flight between two heights."""
        self.parts.append(part)
        self.obstacles.append((outline, bottom_m, top_m))

    def pick(self, choices: Sequence[str]) -> str:
        """Draw one of several names."""
        return choices[int(self.rng.integers(len(choices)))]

    @property
    def open_area(self) -> Any:
        """Return the footprint without the obstacles at the heights of flight, a shapely geometry."""
        low, high = self.band_m[0] - MARGIN_M, self.band_m[1] + MARGIN_M
        out = self.footprint
        for outline, bottom, top in self.obstacles:
            if bottom < high and top > low:
                out = out - outline
        return out

    @property
    def scene(self) -> Scene:
        """Return the world."""
        name = f"{Path(self.kind).stem}-{self.seed}"
        added = scene_of(self.parts, name=name)
        return added if self.base is None else Scene.union([self.base, added], name=name)


def random(kind: str, seed: int) -> Scene:
    """Draw a world of a kind; the same kind and seed always give the same world.

    Args:
        kind: one of `KINDS`, or a world file: its materials vary, and objects are added where there is room.
        seed: 0 or more.

    Raises:
        InputError: the kind is unknown, or the seed is not a whole number of 0 or more.
    """
    return plan(kind, seed).scene


def plan(kind: str, seed: int) -> Plan:
    """Draw a world of a kind, or a variation of a world file, together with its room to fly.

    Raises:
        InputError: the kind is unknown, the file cannot be read, or the seed is not a whole number of 0 or more.
    """
    path = Path(split_source(kind)[0])
    if path.suffix and path.exists():
        return _planned(kind, seed, path.stat().st_mtime_ns)
    return _planned(kind, seed, 0)


@lru_cache(maxsize=8)
def _planned(kind: str, seed: int, mtime_ns: int) -> Plan:
    """Return `plan`'s result from a cache; `mtime_ns` gives a changed file a new key."""
    if kind not in KINDS and not mtime_ns:
        near = difflib.get_close_matches(str(kind), KINDS, 1, 0.4)
        hint = f"; did you mean {near[0]!r}?" if near else ""
        raise InputError(
            f"no kind of world {kind!r}{hint}", where="worlds", allowed=f"{', '.join(KINDS)}, or a world file"
        )
    if isinstance(seed, bool) or not isinstance(seed, (int, np.integer)) or seed < 0:
        raise InputError(f"seed is {seed!r}", where="worlds", allowed="a whole number, 0 or more")
    out = Plan(kind, int(seed), np.random.default_rng([int(seed), zlib.crc32(Path(kind).name.encode())]))
    _BUILDERS.get(kind, _of_file)(out)
    return out


def _shell(made: Plan, footprint: Any, height_m: float, *, skip: Sequence[int] = (), ceiling: bool = True) -> None:
    """Add floor, walls along the outline of the footprint (which turns left) but those of `skip`, and a ceiling."""
    made.footprint = footprint
    wall = made.pick(WALLS)
    corners = np.asarray(footprint.exterior.coords)
    for k, (a, b) in enumerate(itertools.pairwise(corners)):
        if k in skip:
            continue
        made_of = wall if made.rng.random() < 0.8 else made.pick(WALLS)
        upright = np.array([[*a, 0], [*b, 0], [*b, height_m], [*a, height_m]])
        made.parts.append(Part(f"wall_{k + 1}", made_of, (upright, np.array([[0, 2, 1], [0, 3, 2]], np.int32))))
    made.parts.append(Part("floor", "concrete", _level(footprint, 0.0)))
    if ceiling:
        made_of = made.pick(("concrete", "steel", "wood"))
        made.parts.append(Part("ceiling", made_of, turned_over(_level(footprint, height_m))))


def _level(footprint: Any, z_m: float) -> Shape:
    return clean(flat(footprint, lambda xy: np.column_stack([xy, np.full(len(xy), z_m)])))


def _heights(made: Plan, height_m: float) -> None:
    """Set the heights of flight of a room: about the middle, over at most half of the height."""
    low = made.rng.uniform(0.35, 0.5) * height_m
    made.band_m = (float(low), float(max(low, min(low + made.rng.uniform(0.2, 0.45) * height_m, height_m - 0.7))))


def _rectangle(x_m: float, y_m: float) -> Any:
    return box(-x_m / 2, -y_m / 2, x_m / 2, y_m / 2)


def _room(made: Plan) -> None:
    """A box room with up to two free-standing plates."""
    x, y, z = made.rng.uniform((4.5, 4.0, 2.6), (12.0, 9.0, 4.5))
    _shell(made, _rectangle(x, y), z)
    _heights(made, z)
    for k in range(made.rng.integers(3)):
        size = made.rng.uniform((0.02, 0.5, 1.0), (0.06, 1.5, 2.2))
        _stand(made, f"plate_{k + 1}", made.pick(("steel", "wood", "glass")), size, made.rng.uniform(0, 0.5))


def _corridor(made: Plan) -> None:
    """A straight or bent corridor with recesses."""
    rng = made.rng
    length, width, height = rng.uniform(10, 22), rng.uniform(1.9, 3.2), rng.uniform(2.4, 3.2)
    parts = [box(0, 0, length, width)]
    if rng.random() < 0.6:
        up = rng.uniform(5, 10)
        parts.append(
            box(length - width, 0, length, up) if rng.random() < 0.5 else box(length - width, -up, length, width)
        )
    for _ in range(rng.integers(1, 4)):
        at, wide, deep = rng.uniform(0.5, length - width - 1.5), rng.uniform(0.9, 1.6), rng.uniform(0.15, 0.6)
        parts.append(box(at, width, at + wide, width + deep) if rng.random() < 0.5 else box(at, -deep, at + wide, 0))
    _shell(made, _left(union_all(parts)), height)
    _heights(made, height)


def _left(polygon: Any) -> Any:
    """Return the polygon counter-clockwise and without redundant corners."""
    return orient(polygon.simplify(1e-6))


def _polygon(made: Plan) -> None:
    """A room with five to eight corners and no right angles."""
    rng = made.rng
    while True:
        count = rng.integers(5, 9)
        turn = 2 * np.pi * (np.arange(count) + rng.uniform(-0.3, 0.3, count)) / count
        radius = rng.uniform(2.8, 6.5, count)
        corners = np.stack([radius * np.cos(turn), radius * np.sin(turn)], 1)
        outline = Polygon(corners)
        if outline.buffer(-1.0).area > 6.0 and outline.buffer(-0.6).geom_type == "Polygon":
            break
    height = rng.uniform(2.6, 5.0)
    _shell(made, _left(outline), height)
    _heights(made, height)


def _pillars(made: Plan) -> None:
    """A hall with square and round pillars."""
    rng = made.rng
    x, y, z = rng.uniform((10.0, 8.0, 4.0), (18.0, 13.0, 7.0))
    _shell(made, _rectangle(x, y), z)
    _heights(made, z)
    for k in range(rng.integers(3, 9)):
        half = rng.uniform(0.1, 0.4)
        at = _spot(made, half + 0.1, apart_m=1.4)
        if at is None:
            continue
        made_of = made.pick(("concrete", "steel", "brick"))
        if rng.random() < 0.5:
            body: Solid = Rod(f"pillar_{k + 1}", made_of, (*at, 0.002), (*at, z - 0.002), half)
        else:
            body = Part(f"pillar_{k + 1}", made_of, moved(block((-half, -half, 0), (half, half, z)), (*at, 0),
                                                        yaw_deg=rng.uniform(0, 90)))  # fmt: skip
        made.add(body, _disc(at, 1.42 * half), 0.0, z)


def _hopper(made: Plan) -> None:
    """A hold whose sides slope from a small floor to a knee and are upright above it."""
    rng = made.rng
    floor = rng.uniform((2.5, 2.0), (6.0, 5.0))
    rise, slope = rng.uniform(1.5, 3.0), np.radians(rng.uniform(35, 60, 2))
    reach = rise / np.tan(slope)
    top, high = floor + 2 * reach, rise + rng.uniform(1.5, 4.0)
    made_of = made.pick(TANK_WALLS)
    rings = [_corners(size, z) for size, z in ((floor, 0.0), (top, rise), (top, high))]
    for k in range(4):
        j = (k + 1) % 4
        for name, low, upper in (("slope", rings[0], rings[1]), ("wall", rings[1], rings[2])):
            sheet = np.array([low[k], low[j], upper[j], upper[k]])
            made.parts.append(Part(f"{name}_{k + 1}", made_of, (sheet, np.array([[0, 2, 1], [0, 3, 2]], np.int32))))
    made.parts.append(Part("floor", made_of, _level(_rectangle(*floor), 0.0)))
    made.parts.append(Part("deck", made_of, turned_over(_level(_rectangle(*top), high))))
    least = float(rng.uniform(0.6, 1.0)) * float(rise)
    made.band_m = (least, max(least, min(least + 0.4 * float(high), float(high) - 0.8)))
    made.footprint = _rectangle(*(floor + 2 * reach * (max(least - MARGIN_M, 0.0) / rise)))


def _corners(size_m: ArrayLike, z_m: float) -> Floats:
    x, y = np.asarray(size_m, float) / 2
    return np.array([[-x, -y, z_m], [x, -y, z_m], [x, y, z_m], [-x, y, z_m]])


def _tank(made: Plan) -> None:
    """An upright round tank, with or without a central column."""
    rng = made.rng
    radius, height, made_of = rng.uniform(2.4, 6.0), rng.uniform(3.0, 7.0), made.pick(TANK_WALLS)
    body = moved(shapes.cylinder(radius, height, segment_m=SEGMENT_M), (0, 0, height / 2))
    made.parts.append(Part("tank", made_of, turned_over(body)))
    made.footprint = _disc((0.0, 0.0), radius)
    _heights(made, height)
    if radius > 4 and rng.random() < 0.4:
        column = rng.uniform(0.1, 0.4)
        body = moved(shapes.cylinder(column, height - 0.01, segment_m=0.05), (0, 0, height / 2))
        made.add(Part("column", made_of, body), _disc((0.0, 0.0), column), 0.0, height)


def _lying_tank(made: Plan) -> None:
    """A lying round tank with flat or round ends."""
    rng = made.rng
    radius, length, made_of = rng.uniform(1.7, 3.2), rng.uniform(6.0, 13.0), made.pick(TANK_WALLS)
    if rng.random() < 0.6:
        body = shapes.cylinder(radius, length, segment_m=SEGMENT_M)
    else:
        body = shapes.capsule(radius, length, segment_m=2 * SEGMENT_M)
    body = moved(moved(body, pitch_deg=90.0), (0, 0, radius))
    made.parts.append(Part("tank", made_of, turned_over(body)))
    off = rng.uniform(0.1, 0.4) * radius
    made.band_m = (radius - off, radius + off)
    half = np.sqrt(radius**2 - min(off + MARGIN_M, 0.9 * radius) ** 2)
    made.footprint = _rectangle(length, 2 * half)


def _web_frames(made: Plan) -> None:
    """A tank whose web frames leave openings that are wide enough to fly through."""
    rng = made.rng
    spacing, width, height = rng.uniform((2.6, 4.2, 3.6), (3.8, 6.0, 5.6))
    tank = WebTank(
        int(rng.integers(3, 6)), spacing, width, height, tuple(rng.uniform((1.7, 1.7), (2.1, 2.2))),
        spacing_m=rng.uniform(0.65, 0.9), depth_m=rng.uniform(0.15, 0.3),
    )  # fmt: skip
    made.parts += web_tank_parts(tank)
    room = tank.opening_m[1] / 2 - 2 * MARGIN_M
    made.band_m = (height / 2 - room, height / 2 + room)
    made.footprint = _rectangle(tank.length_m, width - 2 * tank.depth_m)
    webs = union_all([box(x - tank.face_m / 2, -width / 2, x + tank.face_m / 2, width / 2) for x in tank.webs_m])
    made.obstacles.append((webs - _rectangle(tank.length_m, tank.opening_m[0]), 0.0, height))


def _tunnel(made: Plan) -> None:
    """A round tunnel with one bend, a floor and a channel in it."""
    rng = made.rng
    radius, floor = rng.uniform(1.7, 2.6), rng.uniform(0.2, 0.35)
    bend, before, after = rng.choice([-1, 1]) * np.radians(rng.uniform(25, 90)), *rng.uniform(4.0, 9.0, 2)
    line = bent_line(before, rng.uniform(2.0, 3.0) * radius, bend, after)
    channel = tuple(rng.uniform((0.3, 0.2), (0.5, 0.5)) * (radius, floor * radius))
    one = Tunnel(line, radius, floor * radius, channel, 2 * SEGMENT_M, made.pick(("concrete", "brick", "steel")))
    made.parts += tunnel_parts(one)
    off = rng.uniform(0.05, 0.2) * radius
    made.band_m = (radius - off, radius + off)
    made.footprint = LineString(line).buffer(np.sqrt(radius**2 - (off + MARGIN_M) ** 2), cap_style="flat")


def _machines(made: Plan) -> None:
    """A plant room with machines, vessels and pipes."""
    rng = made.rng
    x, y, z = rng.uniform((7.0, 6.0, 3.5), (14.0, 11.0, 6.0))
    _shell(made, _rectangle(x, y), z)
    _heights(made, z)
    for k in range(rng.integers(3, 8)):
        if rng.random() < 0.6:
            size = rng.uniform((0.5, 0.5, 0.8), (2.0, 1.5, 0.8 * z))
            _stand(made, f"machine_{k + 1}", "steel", size, 0.0)
            continue
        radius, top = rng.uniform(0.2, 0.7), rng.uniform(0.4, 0.9) * z
        at = _spot(made, radius + 0.05)
        if at is not None:
            made.add(Rod(f"vessel_{k + 1}", "steel", (*at, 0.01), (*at, top), radius), _disc(at, radius), 0.0, top)
    for k in range(rng.integers(2, 7)):
        radius, height = rng.uniform(0.02, 0.15), rng.uniform(0.3, 0.95) * z
        along_x, side = rng.random() < 0.5, rng.choice([-1.0, 1.0])
        off = side * ((y if along_x else x) / 2 - radius - rng.uniform(0.05, 0.6))
        ends = ((-x / 2 + 0.02, off), (x / 2 - 0.02, off)) if along_x else ((off, -y / 2 + 0.02), (off, y / 2 - 0.02))
        pipe = Rod(f"pipe_{k + 1}", "steel", (*ends[0], height), (*ends[1], height), radius)
        made.add(pipe, LineString(ends).buffer(radius), height - radius, height + radius)


def _shelves(made: Plan) -> None:
    """A store with rows of shelving and boxes on the boards."""
    rng = made.rng
    x, y, z = rng.uniform((8.0, 7.0, 3.0), (14.0, 11.0, 5.0))
    _shell(made, _rectangle(x, y), z)
    _heights(made, z)
    deep, top = rng.uniform(0.5, 0.9), rng.uniform(0.6, 0.9) * z
    row, number = -y / 2 + deep / 2 + 0.05, 0
    while row < y / 2 - deep / 2:
        number += 1
        _rack(made, number, row, rng.uniform(0.45, 0.7) * x, deep, top)
        row += deep + rng.uniform(1.7, 2.6)


def _rack(made: Plan, number: int, y_m: float, length_m: float, deep_m: float, top_m: float) -> None:
    """One row of shelving along x: uprights, boards, and boxes on some of them."""
    rng = made.rng
    left = rng.uniform(-0.05, 0.05) * length_m - length_m / 2
    frame, boards, goods = [], [], []
    for px in np.linspace(left, left + length_m, max(2, round(length_m / 1.8) + 1)):
        sides = (y_m - deep_m / 2, y_m + deep_m / 2)
        frame += [block((px - 0.025, py - 0.025, 0.0), (px + 0.025, py + 0.025, top_m)) for py in sides]
    for level in np.arange(0.15, top_m, rng.uniform(0.5, 0.9)):
        boards.append(
            block((left, y_m - deep_m / 2 + 0.03, level), (left + length_m, y_m + deep_m / 2 - 0.03, level + 0.02))
        )
        at = left + rng.uniform(0, 0.6)
        while at < left + length_m - 0.7:
            wide, tall = rng.uniform(0.25, 0.6), rng.uniform(0.15, 0.42)
            if rng.random() < 0.6:
                inset = rng.uniform(0.04, 0.15) * deep_m
                goods.append(block((at, y_m - deep_m / 2 + inset + 0.03, level + 0.021),
                                   (at + wide, y_m + deep_m / 2 - inset - 0.03, level + 0.021 + tall)))  # fmt: skip
            at += wide + rng.uniform(0.02, 0.5)
    whole = box(left - 0.03, y_m - deep_m / 2 - 0.03, left + length_m + 0.03, y_m + deep_m / 2 + 0.03)
    made.add(Part(f"rack_{number}", "steel", join(*frame)), whole, 0.0, top_m)
    made.parts.append(Part(f"boards_{number}", made.pick(("steel", "chipboard")), join(*boards)))
    if goods:
        made.parts.append(Part(f"goods_{number}", made.pick(("wood", "plastic", "steel")), join(*goods)))


def _office(made: Plan) -> None:
    """A furnished office: desks, cabinets and screens between them."""
    rng = made.rng
    x, y, z = rng.uniform((6.0, 5.0, 2.5), (11.0, 8.0, 3.2))
    _shell(made, _rectangle(x, y), z)
    low = rng.uniform(1.2, 1.5)
    made.band_m = (low, min(low + rng.uniform(0.1, 0.5), z - 0.6))
    for k in range(rng.integers(3, 8)):
        size = rng.uniform((1.2, 0.7, 0.7), (1.8, 0.9, 0.8))
        _stand(made, f"desk_{k + 1}", "chipboard", size, 0.0, shape=_desk)
    for k in range(rng.integers(1, 5)):
        _stand(
            made, f"cabinet_{k + 1}", made.pick(("steel", "wood")), rng.uniform((0.8, 0.4, 1.0), (1.2, 0.6, 2.0)), 0.0
        )
    for k in range(rng.integers(0, 3)):
        _stand(made, f"screen_{k + 1}", made.pick(("plasterboard", "glass")), (rng.uniform(1.0, 2.0), 0.05, 1.6), 0.0)


def _desk(size: Floats) -> Shape:
    """Return a desk's top on four legs, which end at z = 0."""
    x, y, z = size
    legs = [
        block((a - 0.03, b - 0.03, 0), (a + 0.03, b + 0.03, z - 0.03))
        for a in (-x / 2 + 0.05, x / 2 - 0.05)
        for b in (-y / 2 + 0.05, y / 2 - 0.05)
    ]
    return join(block((-x / 2, -y / 2, z - 0.025), (x / 2, y / 2, z)), *legs)


def _open(made: Plan) -> None:
    """A shelter that is open on one or two sides, with or without a roof."""
    rng = made.rng
    x, y, z = rng.uniform((7.0, 6.0, 3.0), (14.0, 11.0, 6.0))
    missing = rng.choice(4, rng.integers(1, 3), replace=False)
    _shell(made, _left(_rectangle(x, y)), z, skip=tuple(int(k) for k in missing), ceiling=bool(rng.random() < 0.5))
    _heights(made, z)
    for k in range(rng.integers(1, 4)):
        _stand(made, f"crate_{k + 1}", made.pick(("steel", "wood")), rng.uniform((0.6, 0.6, 1.0), (2.0, 1.5, 2.5)), 0.0)


def _stand(
    made: Plan,
    name: str,
    made_of: str,
    size: ArrayLike,
    bottom_m: float,
    *,
    shape: Callable[[Floats], Shape] | None = None,
) -> None:
    """Place an object of a size (3) [m] at a free place with a random heading; leave it out if there is none."""
    size = np.asarray(size, float)
    at = _spot(made, float(np.hypot(size[0], size[1])) / 2 + 0.05)
    if at is None:
        return
    yaw = made.rng.choice([0.0, 90.0, made.rng.uniform(0, 180)])
    mesh = block((*(-size[:2] / 2), 0.0), (*(size[:2] / 2), size[2])) if shape is None else shape(size)
    outline = affinity.translate(affinity.rotate(_rectangle(size[0], size[1]), yaw), *at)
    bottom = bottom_m + 0.001
    made.add(Part(name, made_of, moved(mesh, (*at, bottom), yaw_deg=yaw)), outline, bottom, bottom + size[2])


def _spot(made: Plan, radius_m: float, *, apart_m: float = 0.3) -> tuple[float, float] | None:
    """Draw a place whose disc lies within the walls and clear of all objects, or None after 60 draws."""
    low_x, low_y, high_x, high_y = made.footprint.bounds
    for _ in range(60):
        at = made.rng.uniform((low_x, low_y), (high_x, high_y))
        disc = Point(at).buffer(radius_m)
        clear = all(outline.distance(disc) > apart_m for outline, _, _ in made.obstacles)
        if clear and made.footprint.contains(disc):
            return float(at[0]), float(at[1])
    return None


def _of_file(made: Plan) -> None:
    """Vary a world file: change some materials and add up to three objects."""
    scene, rng = load_scene(made.kind), made.rng
    objects = [
        replace(thing, material=material(made.pick(WALLS))) if rng.random() < 0.3 else thing for thing in scene.objects
    ]
    made.base = replace(scene, objects=tuple(objects))
    low, high = scene.bounds[:, 2]
    bottom = low + rng.uniform(0.25, 0.45) * (high - low)
    made.band_m = (float(bottom), float(bottom + 0.2 * (high - low)))
    made.footprint = _inside(scene, made.band_m)
    for k in range(rng.integers(4)):
        size = rng.uniform((0.3, 0.3, 0.5), (1.5, 1.2, 0.6 * (high - low)))
        _stand(made, f"added_{k + 1}", made.pick(("steel", "wood", "plastic")), size, float(low))


def _inside(scene: Scene, band_m: tuple[float, float]) -> Any:
    """Return the largest horizontal area that no surface crosses at the heights of flight, a shapely polygon."""
    heights = np.linspace(band_m[0] - MARGIN_M, band_m[1] + MARGIN_M, 5)
    cuts = [MultiLineString(list(section(scene, float(z)))).buffer(THIN_M) for z in heights]
    cuts += [_disc(at, THIN_M) for z in heights for at in wire_section(scene, float(z), slab_m=MARGIN_M)]
    (x0, y0, _), (x1, y1, _) = scene.bounds
    parts = get_parts(box(x0, y0, x1, y1) - union_all(cuts))
    if not len(parts):
        raise InputError("the world leaves no room to fly", where=scene.name)
    return max(parts, key=lambda part: float(part.area))


def _disc(at: Sequence[float], radius_m: float) -> Any:
    return Point(*at).buffer(radius_m, quad_segs=32)


_BUILDERS: dict[str, Callable[[Plan], None]] = {
    "room": _room,
    "corridor": _corridor,
    "tank": _tank,
    "machines": _machines,
    "shelves": _shelves,
    "polygon": _polygon,
    "pillars": _pillars,
    "hopper": _hopper,
    "lying-tank": _lying_tank,
    "office": _office,
    "open": _open,
    "web-frames": _web_frames,
    "tunnel": _tunnel,
}
