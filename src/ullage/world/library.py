"""The worlds that come with ullage: where their files are, where a drone starts, how far it may go, what it flies."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from ullage.world.scene import Scene

WORLDS_DIR = Path(__file__).parents[1] / "worlds"
"""Where the shipped .sdf files and their meshes lie."""


@dataclass(frozen=True, slots=True)
class World:
    """One shipped world and how to fly it."""

    name: str
    title: str
    start: tuple[float, float, float, float]  # x, y, z [m], yaw [deg]
    path_xyzyaw: tuple[tuple[float, float, float, float], ...]  # waypoints x, y, z [m], yaw [deg]
    bounds: tuple[tuple[float, float, float], tuple[float, float, float]]  # corners of the box to fly in [m]
    floor_m: float = 0.0  # height of the floor [m]

    @property
    def path(self) -> Path:
        """The world's .sdf file."""
        return WORLDS_DIR / f"{self.name}.sdf"

    def scene(self) -> Scene:
        """The world, loaded."""
        from ullage.world.load import load_scene

        return load_scene(self.path)


WORLDS: dict[str, World] = {}
