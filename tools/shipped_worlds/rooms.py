"""Rooms with doors and windows, and the targets of the thesis' object experiments [Billdal2018, ch. 6].

Walls are sheets seen from within; an opening is a real gap whose reveal runs outward to a door or pane set back in it.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np

from ullage.arrays import Floats, Ints
from ullage.world.solids import Box, Part, Rod, Solid, clean, flat, join

GLASS_M, DOOR_M, PIPE_M = 0.006, 0.04, 0.004
"""Thickness of a pane, a door leaf and a half-pipe's wall [m]."""


@dataclass(frozen=True, slots=True)
class Opening:
    """A gap in a wall: a door when it reaches the floor, else a window with a frame of wood."""

    name: str
    middle_m: float  # along the wall from its middle, to the right seen from within
    width_m: float
    height_m: float
    sill_m: float = 0.0
    recess_m: float = 0.12  # from the wall's face out to the leaf or pane
    frame_m: float = 0.06


@dataclass(frozen=True, slots=True)
class Wall:
    """One wall seen from within: its name, its middle at the floor, its outward direction [deg] and its length."""

    name: str
    foot: tuple[float, float]
    outward_deg: float
    length_m: float
    openings: tuple[Opening, ...] = ()

    def place(self, points: Floats, *, depth_m: float = 0.0) -> Floats:
        """Points (n, 2), to the right and up on the wall seen from within, in the room (n, 3)."""
        turn = math.radians(self.outward_deg)
        out = np.array([math.cos(turn), math.sin(turn)])
        right = np.array([out[1], -out[0]])
        level = np.array(self.foot) + points[:, :1] * right + depth_m * out
        return np.column_stack([level, points[:, 1]])


def room_parts(size_m: tuple[float, float, float], openings: Mapping[str, tuple[Opening, ...]]) -> list[Part]:
    """Floor, ceiling, four walls and what closes their openings.

    Args:
        size_m: inner edges along x, y, z [m]; the floor is at z = 0, the middle at the origin.
        openings: by name of the wall: wall_north (+y), wall_south, wall_east (+x), wall_west.
    """
    x, y, z = size_m[0] / 2, size_m[1] / 2, size_m[2]
    at = {
        "wall_north": ((0.0, y), 90.0, 2 * x), "wall_south": ((0.0, -y), -90.0, 2 * x),
        "wall_east": ((x, 0.0), 0.0, 2 * y), "wall_west": ((-x, 0.0), 180.0, 2 * y),
    }  # fmt: skip
    out = [_level("floor", x, y, 0.0), _level("ceiling", x, y, z)]
    for name, (foot, outward, span) in at.items():
        out += wall_parts(Wall(name, foot, outward, span, openings.get(name, ())), z)
    return out


def _level(name: str, x: float, y: float, z: float) -> Part:
    corners = np.array([[-x, -y, z], [x, -y, z], [x, y, z], [-x, y, z]])
    faces = [[0, 1, 2], [0, 2, 3]] if z == 0 else [[0, 2, 1], [0, 3, 2]]
    return Part(name, "concrete", (corners, np.array(faces, np.int32)))


def wall_parts(wall: Wall, height_m: float) -> list[Part]:
    """The wall with its reveals, then the door leaves, frames and panes in it."""
    from shapely import box

    face = box(-wall.length_m / 2, 0, wall.length_m / 2, height_m)
    reveals, fillings = [], []
    for gap in wall.openings:
        hole = _hole(gap)
        face = face - hole
        reveals.append(_reveal(wall, gap))
        fillings += _filling(wall, gap)
    sheet = flat(face, wall.place)
    return [Part(wall.name, "concrete", clean(join(sheet, *reveals))), *fillings]


def _hole(gap: Opening) -> Any:
    from shapely import box

    half = gap.width_m / 2
    return box(gap.middle_m - half, gap.sill_m, gap.middle_m + half, gap.sill_m + gap.height_m)


def _reveal(wall: Wall, gap: Opening) -> tuple[Floats, Ints]:
    """The four inner sides of an opening, from the wall's face out to the recess."""
    ring = np.asarray(_hole(gap).exterior.coords)[:-1]
    near, far = wall.place(ring), wall.place(ring, depth_m=gap.recess_m)
    k = np.arange(4)
    j = (k + 1) % 4
    faces = np.concatenate([np.stack([k, j, j + 4], 1), np.stack([k, j + 4, k + 4], 1)])
    mesh = np.concatenate([near, far]), faces.astype(np.int32)
    middle = mesh[0].mean(0)
    corners = mesh[0][mesh[1]]
    normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    away = np.einsum("fi,fi->f", normal, corners.mean(1) - middle) > 0
    mesh[1][away] = mesh[1][away][:, ::-1]
    return mesh


def _filling(wall: Wall, gap: Opening) -> list[Part]:
    """A leaf of wood, or a pane of glass in a frame with a mullion."""
    from shapely import box

    hole = _hole(gap)
    back = partial(wall.place, depth_m=gap.recess_m)
    if gap.sill_m == 0:
        return [Part(gap.name, "wood", clean(flat(hole, back)), thickness_m=DOOR_M)]
    panes = hole.buffer(-gap.frame_m, join_style="mitre")
    x0, y0, x1, y1 = panes.bounds
    middle, half = (x0 + x1) / 2, gap.frame_m / 2
    panes = box(x0, y0, middle - half, y1) | box(middle + half, y0, x1, y1)
    frame = hole - panes
    return [
        Part(f"{gap.name}_frame", "wood", clean(flat(frame, back)), thickness_m=DOOR_M),
        Part(gap.name, "glass", clean(flat(panes, back)), thickness_m=GLASS_M),
    ]


def cameras(size_m: tuple[float, float, float]) -> list[Solid]:
    """The motion-capture cameras under the ceiling: one in each corner and one amid each long wall."""
    x, y, z = size_m[0] / 2 - 0.25, size_m[1] / 2 - 0.25, size_m[2] - 0.25
    spots = [(x, y), (-x, y), (-x, -y), (x, -y), (0, y), (0, -y)]
    out: list[Solid] = []
    for number, (a, b) in enumerate(spots, 1):
        out.append(Box(f"camera_{number}", "plastic", (a, b, z), (0.12, 0.12, 0.12)))
        out.append(Rod(f"bracket_{number}", "steel", (a, b, z + 0.06), (a, b, size_m[2] - 0.012), 0.012))
    return out


def plate_parts(width_m: float = 1.0, height_m: float = 1.0, *, middle_m: float = 1.1) -> list[Solid]:
    """A 3 mm steel plate that faces -x, on two wooden posts with feet behind it."""
    posts: list[Solid] = []
    for side, y in (("left", 0.35), ("right", -0.35)):
        top = middle_m + height_m / 2 - 0.1
        posts.append(Box(f"post_{side}", "wood", (0.0235, y, top / 2 + 0.02), (0.04, 0.06, top - 0.04)))
        posts.append(Box(f"foot_{side}", "wood", (0.0235, y, 0.02), (0.5, 0.06, 0.04)))
    return [Box("plate", "steel", (0.0, 0.0, middle_m), (0.003, width_m, height_m)), *posts]


def pole_parts() -> list[Solid]:
    """A square steel pole, 60 mm wide and 1.5 m long, upright on a wooden box, a plastic half-pipe behind it."""
    return [
        Box("box", "wood", (0.06, 0.0, 0.25), (0.5, 0.5, 0.5)),
        Box("pole", "steel", (0.0, 0.0, 1.25), (0.06, 0.06, 1.4995)),
        Part("half_pipe", "plastic", half_pipe(0.11, 0.5005, 1.7, middle=(0.0, 0.0)), thickness_m=PIPE_M),
    ]


def wire_parts() -> list[Solid]:
    """A 4 mm steel wire, upright before a plastic half-pipe that stands on the floor and bulges toward the radar."""
    turned = half_pipe(0.11, 0.0005, 2.0, middle=(0.11, 0.0), bulge_deg=180.0)
    wire = Rod("wire", "steel", (-0.004, 0.0, 0.02), (-0.004, 0.0, 1.98), 0.002)
    return [wire, Part("half_pipe", "plastic", turned, thickness_m=PIPE_M)]


def half_pipe(
    radius_m: float, low_m: float, high_m: float, *, middle: Sequence[float], bulge_deg: float = 0.0, sides: int = 24
) -> tuple[Floats, Ints]:
    """An upright half-pipe as a sheet; it bulges toward `bulge_deg` [deg] and is open on the other side."""
    turn = math.radians(bulge_deg) + np.linspace(-math.pi / 2, math.pi / 2, sides + 1)
    arc = np.array(middle) + radius_m * np.stack([np.cos(turn), np.sin(turn)], axis=1)
    vertices = np.concatenate([np.column_stack([arc, np.full(len(arc), z)]) for z in (low_m, high_m)])
    k, n = np.arange(sides), sides + 1
    faces = np.concatenate([np.stack([k, k + 1, k + 1 + n], 1), np.stack([k, k + 1 + n, k + n], 1)])
    return clean((vertices, faces.astype(np.int32)))
