"""Narrow spaces of steel and concrete from a few numbers: a tank with web frames, and a tunnel along a bent line."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from shapely import LineString, Point, Polygon, box

from ullage.arrays import Floats
from ullage.world.hold import quad
from ullage.world.shapes import Shape
from ullage.world.solids import Part, Skin, clean, flat, join, loft, turned_over


@dataclass(frozen=True, slots=True)
class WebTank:
    """The numbers of a tank with transverse web frames; x runs forward, y to port, z up from the bottom [m].

    Webs stand every few frame spaces and carry a large opening to pass through, a manhole at the foot of 0.6 x 0.8 m,
    the least that [SOLAS-II-1-3-6] allows, and round lightening holes.
    """

    bays: int = 5
    web_spacing_m: float = 3.2
    width_m: float = 4.8
    height_m: float = 5.6
    opening_m: tuple[float, float] = (1.8, 2.0)  # width and height of the openings to fly through, amid the webs
    spacing_m: float = 0.8  # of the longitudinals
    depth_m: float = 0.25  # of the longitudinals
    flange_m: float = 0.09  # width of the longitudinals' flanges
    face_m: float = 0.15  # width of the face plate round an opening
    made_of: str = "steel"

    @property
    def length_m(self) -> float:
        """Distance between the bulkheads."""
        return self.bays * self.web_spacing_m

    @property
    def webs_m(self) -> Floats:
        """Positions of the webs along x."""
        return np.asarray(self.web_spacing_m * np.arange(1, self.bays) - self.length_m / 2, np.float64)

    @property
    def opening(self) -> Any:
        """Outline (y, z) of an opening to fly through, its corners rounded: a shapely polygon."""
        wide, high = self.opening_m
        round_m = 0.2 * min(wide, high)
        inner = box(round_m - wide / 2, (self.height_m - high) / 2 + round_m,
                    wide / 2 - round_m, (self.height_m + high) / 2 - round_m)  # fmt: skip
        return inner.buffer(round_m, quad_segs=4)

    @property
    def web(self) -> Any:
        """Outline (y, z) of a web with its openings: a shapely polygon."""
        side = (self.opening_m[0] + self.width_m) / 4  # middle of the plate beside an opening
        size = min(0.3, 0.3 * (self.width_m - self.opening_m[0]) / 2)
        low, high = self.depth_m + 0.65, self.height_m - self.depth_m - 0.65
        manhole = LineString([(side, low - 0.1), (side, low + 0.1)]).buffer(0.3, quad_segs=4)
        light = [Point(y, z).buffer(size, quad_segs=4) for y, z in ((-side, low), (-side, high), (side, high))]
        plate = box(-self.width_m / 2, 0, self.width_m / 2, self.height_m) - self.opening - manhole
        for hole in light:
            plate = plate - hole
        return plate


def web_tank_parts(tank: WebTank) -> list[Part]:
    """Plating with longitudinals, and webs with stiffeners beside their openings."""
    x, y, z = tank.length_m / 2, tank.width_m / 2, tank.height_m
    plates: dict[str, list[tuple[float, float, float]]] = {
        "bottom": [(-x, -y, 0), (x, -y, 0), (x, y, 0), (-x, y, 0)],
        "top": [(-x, y, z), (x, y, z), (x, -y, z), (-x, -y, z)],
        "shell": [(x, -y, 0), (-x, -y, 0), (-x, -y, z), (x, -y, z)],
        "inner_hull": [(-x, y, 0), (x, y, 0), (x, y, z), (-x, y, z)],
        "bulkhead_aft": [(-x, -y, 0), (-x, y, 0), (-x, y, z), (-x, -y, z)],
        "bulkhead_forward": [(x, y, 0), (x, -y, 0), (x, -y, z), (x, y, z)],
    }
    out = [Part(name, tank.made_of, quad(corners)) for name, corners in plates.items()]
    for name, side in (("shell", -1), ("inner_hull", 1)):
        bars = [_longitudinal(tank, (side * y, at), (-side, 0)) for at in _between(z, tank.spacing_m)]
        out.append(Part(f"longitudinals_{name}", tank.made_of, clean(join(*bars))))
    for name, level, up in (("bottom", 0.0, 1), ("top", z, -1)):
        bars = [_longitudinal(tank, (at - y, level), (0, up)) for at in _between(2 * y, tank.spacing_m)]
        out.append(Part(f"longitudinals_{name}", tank.made_of, clean(join(*bars))))
    return out + [Part(f"web_{k + 1}", tank.made_of, _web(tank, at)) for k, at in enumerate(tank.webs_m)]


def _between(length_m: float, spacing_m: float) -> Floats:
    """Even positions between 0 and a length, near a spacing."""
    count = round(length_m / spacing_m)
    return np.asarray(length_m / count * np.arange(1, count))


def _longitudinal(tank: WebTank, at: tuple[float, float], inward: tuple[int, int]) -> Shape:
    """A stiffener of T section along the tank, its foot at (y, z)."""
    x, foot, out, half = tank.length_m / 2, np.array(at), np.array(inward), tank.flange_m / 2
    head, aside = foot + tank.depth_m * out, half * np.abs(out[::-1])
    sheets = [(foot, head), (head - aside, head), (head, head + aside)]
    return join(*(quad([(-x, *a), (x, *a), (x, *b), (-x, *b)]) for a, b in sheets))


def _web(tank: WebTank, x_m: float) -> Shape:
    """The plate, a face plate round its opening, and flat bars upright on it."""
    rim = np.asarray(tank.opening.exterior.coords)[:-1]
    ring = [np.column_stack([np.full(len(rim), x_m + dx), rim]) for dx in (-tank.face_m / 2, 0, tank.face_m / 2)]
    plate = flat(tank.web, lambda yz: np.column_stack([np.full(len(yz), x_m), yz]))
    at, low, high = tank.opening_m[0] / 2 + 0.1, tank.depth_m, tank.height_m - tank.depth_m
    bars = [quad([(x_m, y, low), (x_m + tank.face_m, y, low), (x_m + tank.face_m, y, high), (x_m, y, high)])
            for y in (-at, at)]  # fmt: skip
    return clean(join(plate, loft(ring, caps=False), *bars))


@dataclass(frozen=True, slots=True, eq=False)
class Tunnel:
    """The numbers of a round tunnel with a flat floor and a channel in it; its invert is at z = 0 [m]."""

    line: Floats  # of its middle in plan (k, 2), from its start to its end [m]
    radius_m: float = 1.8
    floor_m: float = 0.6  # height of the floor
    channel_m: tuple[float, float] = (0.8, 0.4)  # width and depth of the channel
    segment_m: float = 0.2  # longest chord of a facet
    made_of: str = "concrete"

    def across(self, section: Floats) -> Floats:
        """Points (k, m, 3) of a section (m, 2), to the left and up, at each point of the line [m]."""
        legs = np.diff(self.line, axis=0)
        left = np.stack([-legs[:, 1], legs[:, 0]], axis=1) / np.linalg.norm(legs, axis=1, keepdims=True)
        mitre = np.concatenate([left[:1], left[:-1] + left[1:], left[-1:]])
        mitre[1:-1] *= 2 / np.sum(mitre[1:-1] ** 2, axis=1, keepdims=True)
        level = self.line[:, None] + section[None, :, :1] * mitre[:, None]
        return np.concatenate([level, np.broadcast_to(section[None, :, 1:], (*level.shape[:2], 1))], axis=2)

    def skin(self, section: Floats) -> Skin:
        """A sheet over a section (m, 2): u runs along the line, v along the section, both from 0 [m]."""
        u, v = (np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(line, axis=0), axis=1))])
                for line in (self.line, section))  # fmt: skip
        return Skin(u, v, self.across(section))

    @property
    def arch(self) -> Floats:
        """The wall's section (m, 2) from the left foot over the crown to the right one [m]."""
        foot = math.asin(self.floor_m / self.radius_m - 1)
        count = 2 * math.ceil((math.pi - 2 * foot) * self.radius_m / self.segment_m / 2)
        turn = np.linspace(foot, math.pi - foot, count + 1)
        return np.asarray([0, self.radius_m] + self.radius_m * np.stack([np.cos(turn), np.sin(turn)], axis=1))

    @property
    def bed(self) -> Floats:
        """The floor's section (m, 2) from the right foot through the channel to the left one [m]."""
        foot, (wide, deep) = self.arch[-1][0], self.channel_m
        half = [(-abs(foot), self.floor_m), (-wide / 2, self.floor_m), (-wide / 2, self.floor_m - deep)]
        return np.array([*half, *((-y, z) for y, z in half[::-1])])


def bent_line(before_m: float, radius_m: float, bend_rad: float, after_m: float) -> Floats:
    """Points (k, 2) of a line along x, then through a bend to the left (above zero) or right, then straight [m].

    Args:
        before_m: length before the bend [m].
        radius_m: of the bend [m].
        bend_rad: how far it turns [rad].
        after_m: length after it [m].
    """
    turn = np.linspace(0, bend_rad, math.ceil(abs(bend_rad) / math.radians(5)) + 1)
    arc = radius_m * np.stack([np.sin(np.abs(turn)), np.sign(bend_rad) * (1 - np.cos(turn))], axis=1)
    end = arc[-1] + after_m * np.array([math.cos(bend_rad), math.sin(bend_rad)])
    return np.asarray(np.concatenate([[[-before_m, 0.0]], arc, end[None]]) + np.array([before_m, 0.0]), np.float64)


def tunnel_parts(made: Tunnel, openings: Sequence[Any] = ()) -> list[Part]:
    """The wall with openings, the floor with its channel, and the walls that close both ends.

    Args:
        made: its numbers.
        openings: shapely polygons in the coordinates of the wall's `Skin`.
    """
    whole = Polygon(np.concatenate([made.arch, made.bed[1:-1]]))
    out = [Part("wall", made.made_of, made.skin(made.arch).mesh(openings)),
           Part("floor", made.made_of, made.skin(made.bed).mesh())]  # fmt: skip
    for name, k in (("start", 0), ("end", -1)):
        middle, left = made.line[k], made.across(np.array([[1.0, 0.0]]))[k, 0, :2] - made.line[k]
        place = lambda yz, at=middle, to=left: np.column_stack([at + yz[:, :1] * to, yz[:, 1]])  # noqa: E731
        sheet = clean(flat(whole, place), decimals=6)  # coarser ones bend slivers of an oblique plane
        out.append(Part(f"{name}_wall", made.made_of, sheet if k else turned_over(sheet)))
    return out
