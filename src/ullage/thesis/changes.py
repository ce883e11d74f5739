"""Single changes of a world or of its radars, for controlled experiments."""

from __future__ import annotations

from typing import Any

from ullage.specs import Rig
from ullage.world.scene import Scene

WALLS = ("wall_north", "wall_south", "wall_east", "wall_west")
OPENINGS = ("door", "window_1", "window_2", "window_3", "window_1_frame", "window_2_frame", "window_3_frame")


def less(scene: Scene, *names: str) -> Scene:
    """Return the scene without some of its models."""
    for name in names:
        scene = scene.without(name)
    return scene


def rays_of(rig: Rig, **changes: Any) -> Rig:
    """Return the rig with other settings of the ray model in every radar."""
    return Rig(sensors={name: one.but(thesis=one.thesis.but(**changes)) for name, one in rig.sensors.items()})
