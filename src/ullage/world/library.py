"""Shipped worlds: their files, and the start, bounds and missions of flights in them.

`python tools/write_worlds.py` of the repository writes the files.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from ullage.world.scene import Scene

WORLDS_DIR = Path(__file__).parents[1] / "worlds"
"""Where the shipped .sdf files and their meshes lie."""

Waypoint = tuple[float, float, float, float]  # x, y, z [m], yaw [deg]
Corner = tuple[float, float, float]


@dataclass(frozen=True, slots=True)
class World:
    """Shipped world with a flight that keeps 0.8 m from every surface."""

    name: str
    title: str
    path_xyzyaw: tuple[Waypoint, ...]  # waypoints x, y, z [m], yaw [deg]
    bounds: tuple[Corner, Corner]  # corners of the box to fly in [m]
    floor_m: float = 0.0  # height of the floor [m]

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


_ROOM_BOX = ((-3.2, -2.2, 0.8), (3.2, 2.2, 2.2))
_STRAFE = ((-2.2, -1.9, 1.1, 0.0), (-2.2, 1.9, 1.1, 0.0))
_ROUND = (
    (-2.8, -1.9, 1.1, 0.0), (0.2, -1.9, 1.1, 0.0), (0.2, -1.9, 1.1, 90.0), (0.2, 1.9, 1.1, 90.0),
    (0.2, 1.9, 1.1, 180.0), (-2.8, 1.9, 1.1, 180.0), (-2.8, 1.9, 1.1, 270.0), (-2.8, -1.9, 1.1, 270.0),
)  # fmt: skip
_HALL = (
    (-3.4, -2.0, 1.1, 0.0), (3.4, -2.0, 1.1, 0.0), (3.4, -2.0, 1.1, 90.0), (3.4, 1.6, 1.1, 90.0),
    (3.4, 1.6, 1.1, 180.0), (-3.4, 1.6, 1.1, 180.0), (-3.4, 1.6, 1.1, 270.0), (-3.4, 0.1, 1.1, 270.0),
)  # fmt: skip
_HOLD = (
    (-11.5, -7.0, 4.0, 0.0), (11.0, -7.0, 4.0, 0.0), (11.0, -7.0, 4.0, 90.0), (11.0, 7.0, 4.0, 90.0),
    (11.0, 7.0, 4.0, 180.0), (-11.5, 7.0, 4.0, 180.0), (-11.5, 7.0, 4.0, 270.0), (-11.5, -6.0, 4.0, 270.0),
)  # fmt: skip

WORLDS: dict[str, World] = {
    world.name: world
    for world in (
        World("ntnu-room", "Motion-capture room at NTNU, 8 x 6 x 3 m, with a door and windows", _ROUND, _ROOM_BOX),
        World("ntnu-plate", "The room with a steel plate in its middle", _STRAFE, _ROOM_BOX),
        World("ntnu-plate45", "The room with the plate turned by 45 deg", _STRAFE, _ROOM_BOX),
        World("ntnu-pole", "The room with a square steel pole on a wooden box", _STRAFE, _ROOM_BOX),
        World("ntnu-wire", "The room with a steel wire against a plastic half-pipe", _STRAFE, _ROOM_BOX),
        World("ntnu-mapping", "The room with a plate toward one end, for mapping", _ROUND, _ROOM_BOX),
        World(
            "cluttered-room",
            "Hall of 12 x 10 m with car, postbox, stop sign, person, robot, control panel and dumpster",
            _HALL,
            ((-5.2, -4.2, 0.8), (5.2, 4.2, 3.2)),
        ),
        World(
            "cargo-hold",
            "Bulk carrier's hold, 30 x 20 x 12 m, with frames, slopes, corrugated bulkheads, ladders, pipes, a wire",
            _HOLD,
            ((-13.0, -8.8, 0.8), (12.0, 8.8, 11.0)),
        ),
    )
}
