"""Shipped worlds: their files, and a flight in each.

`python tools/write_worlds.py` of the repository writes the files.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from itertools import pairwise
from pathlib import Path
from typing import Any

from ullage.world.scene import Scene

WORLDS_DIR = Path(__file__).parents[1] / "worlds"
"""Where the shipped .sdf files and their meshes lie."""

Waypoint = tuple[float, float, float, float]  # x, y, z [m], yaw [deg]


@dataclass(frozen=True, slots=True)
class World:
    """Shipped world with a flight that keeps 0.8 m from every surface."""

    name: str
    title: str
    path_xyzyaw: tuple[Waypoint, ...]  # waypoints x, y, z [m], yaw [deg]
    view: Mapping[str, Any] = field(compare=False)  # arguments with which `ullage.view.world_picture` shows it

    @property
    def path(self) -> Path:
        """The world's .sdf file."""
        return WORLDS_DIR / f"{self.name}.sdf"

    @property
    def start(self) -> Waypoint:
        """Start of the drone: x, y, z [m], yaw [deg]."""
        return self.path_xyzyaw[0]

    def scene(self) -> Scene:
        """Load the world."""
        from ullage.world.load import load_scene

        return load_scene(self.path)


_STRAFE = ((-2.2, -1.9, 1.1, 0.0), (-2.2, 1.9, 1.1, 0.0))


def _round(west: float, east: float, south: float, north: float, end: float, *, z: float) -> tuple[Waypoint, ...]:
    """Waypoints from the south-west corner of a rectangle to the left round it, and south until y = `end` [m]."""
    corners = ((west, south), (east, south), (east, north), (west, north), (west, end))
    return tuple((x, y, z, 90.0 * k) for k, side in enumerate(pairwise(corners)) for x, y in side)


_ROUND = _round(-2.8, 0.2, -1.9, 1.9, -1.9, z=1.1)
_HALL = _round(-3.4, 3.4, -2.0, 1.6, 0.1, z=1.1)
_HOLD = _round(-11.5, 11.0, -7.0, 7.0, -6.0, z=4.0)
_WEBS = tuple((3.2 * k - 6.4, y, 2.8, 0.0) for k in range(5) for y in (0.0, 1.2, -1.2, 0.0))
_TANK = _round(-3.6, 3.8, -1.05, 1.05, -0.9, z=2.0)
_RACK = _round(-6.4, 6.4, -2.9, 2.9, -1.9, z=2.6)
_SEWER = (
    (1.2, -0.6, 1.8, 0.0), (4.5, 0.6, 1.8, 0.0), (8.0, -0.6, 1.8, 0.0), (10.7, 1.3, 1.8, 30.0),
    (13.7, 2.7, 1.8, 60.0), (14.2, 5.9, 1.8, 60.0), (16.6, 7.7, 1.8, 60.0),
)  # fmt: skip
_SILO = tuple(
    (round(1.8 * math.cos(math.radians(a)), 3), round(1.8 * math.sin(math.radians(a)), 3), 7.0, a + 90.0)
    for a in range(-180, 181, 30)
)

_ROOM_VIEW = {"elevation_deg": 38, "azimuth_deg": -120, "cut_height_m": 2.55, "plan_height_m": 1.1}

WORLDS: dict[str, World] = {
    world.name: world
    for world in (
        World("ntnu-room", "Motion-capture room at NTNU, 8 x 6 x 3 m, with a door and windows", _ROUND, _ROOM_VIEW),
        World("ntnu-plate", "The room with a steel plate in its middle", _STRAFE, _ROOM_VIEW),
        World("ntnu-plate45", "The room with the plate turned by 45 deg", _STRAFE, _ROOM_VIEW),
        World("ntnu-pole", "The room with a square steel pole on a wooden box", _STRAFE, _ROOM_VIEW),
        World("ntnu-wire", "The room with a steel wire against a plastic half-pipe", _STRAFE, _ROOM_VIEW),
        World("ntnu-mapping", "The room with a plate toward one end, for mapping", _ROUND, _ROOM_VIEW),
        World(
            "cluttered-room",
            "Hall of 12 x 10 m with car, postbox, stop sign, person, robot, control panel and dumpster",
            _HALL,
            {"elevation_deg": 42, "azimuth_deg": -70, "cut_height_m": 3.2, "plan_height_m": 1.0},
        ),
        World(
            "cargo-hold",
            "Bulk carrier's hold, 30 x 20 x 12 m, with frames, slopes, corrugated bulkheads, ladders, pipes, a wire",
            _HOLD,
            {"elevation_deg": 17, "azimuth_deg": -163, "cut_side_m": (6.0, 0.0), "plan_height_m": 4.0},
        ),
        World(
            "ballast-tank",
            "Wing ballast tank, 16 x 4.8 x 5.6 m, with four web frames, openings, longitudinals",
            _WEBS,
            {"elevation_deg": 20, "azimuth_deg": -48, "cut_side_m": (2.6, 1.3), "plan_height_m": 2.8},
        ),
        World(
            "lying-tank",
            "Lying steel tank, 4 m wide and 11 m long, with manhole, ladder and dip pipe",
            _TANK,
            {"elevation_deg": 22, "azimuth_deg": -70, "cut_side_m": (0.0, 1.6), "plan_height_m": 2.0},
        ),
        World(
            "pipe-rack",
            "Hall of 16 x 9 x 6 m with eleven pipes on the two levels of a rack",
            _RACK,
            {"elevation_deg": 38, "azimuth_deg": -60, "cut_height_m": 5.9, "plan_height_m": 2.6},
        ),
        World(
            "sewer",
            "Bent concrete sewer, 3.6 m wide, with a channel, two inlets and a shaft",
            _SEWER,
            {"elevation_deg": 35, "azimuth_deg": -55, "cut_height_m": 2.5, "plan_height_m": 1.8},
        ),
        World(
            "silo",
            "Steel silo, 6 m wide and 11 m high, with hopper, ladder and fill pipe",
            _SILO,
            {"elevation_deg": 18, "azimuth_deg": -90, "cut_side_m": (0.0, 2.4), "plan_height_m": 7.0},
        ),
    )
}
