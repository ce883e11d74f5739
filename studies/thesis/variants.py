"""Make single changes of a world or of its radars, for controlled experiments."""

from __future__ import annotations

from typing import Any

import numpy as np

from ullage.specs import Rig
from ullage.world.scene import Scene, Wires

WALLS = ("wall_north", "wall_south", "wall_east", "wall_west")
OPENINGS = ("door", "window_1", "window_2", "window_3", "window_1_frame", "window_2_frame", "window_3_frame")


def alone(scene: Scene, name: str) -> Scene:
    """Return one object of a scene alone."""
    index = scene.object(name)
    wires, mine = scene.wires, scene.wires.object_id == index
    kept = Wires(wires.start[mine], wires.end[mine], wires.radius_m[mine], np.zeros(int(mine.sum()), np.int32))
    faces = scene.faces[scene.face_object == index]
    return Scene(scene.vertices, faces, np.zeros(len(faces), np.int32), (scene.objects[index],), kept, name)


def without_object(scene: Scene, name: str) -> Scene:
    """Return a scene without one object that has faces."""
    kept = scene.face_object != scene.object(name)
    return Scene(scene.vertices, scene.faces[kept], scene.face_object[kept], scene.objects, scene.wires, scene.name)


def without_models(scene: Scene, *names: str) -> Scene:
    """Return the scene without some of its models."""
    for name in names:
        scene = scene.without(name)
    return scene


def with_ray_settings(rig: Rig, **changes: Any) -> Rig:
    """Return the rig with other settings of the ray model in every radar."""
    return Rig(sensors={name: one.but(thesis=one.thesis.but(**changes)) for name, one in rig.sensors.items()})
