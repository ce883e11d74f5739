"""The worlds that come with ullage: where their files are, where a drone starts, how far it may go, what it flies.

`python -m ullage.world.library` writes the files anew, each byte as it was.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from ullage.errors import UllageError
from ullage.world.scene import Scene

WORLDS_DIR = Path(__file__).parents[1] / "worlds"
"""Where the shipped .sdf files and their meshes lie."""

Waypoint = tuple[float, float, float, float]  # x, y, z [m], yaw [deg]
Corner = tuple[float, float, float]


@dataclass(frozen=True, slots=True)
class World:
    """One shipped world and how to fly it: its path keeps 0.8 m from everything."""

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
        """Where the drone starts: x, y, z [m], yaw [deg]."""
        return self.path_xyzyaw[0]

    def scene(self) -> Scene:
        """The world, loaded."""
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


def regenerated() -> dict[str, str]:
    """The text of every shipped file, by its path under `WORLDS_DIR`.

    Raises:
        UllageError: two worlds want different meshes under one name.
    """
    from ullage.world.sdf_write import world_files
    from ullage.world.shipped import BUILDERS

    files: dict[str, str] = {}
    for name, build in BUILDERS.items():
        for path, text in world_files(name, WORLDS[name].title, build()).items():
            if files.setdefault(path, text) != text:
                raise UllageError(f"{name} wants another {path} than a world before it")
    return files


if __name__ == "__main__":
    from ullage.world.sdf_write import write_worlds

    write_worlds(WORLDS_DIR, regenerated())
