"""The body that carries the radars, as they see it: propellers that turn, and boxes that hide what is behind them.

Both are objects of the scene whose poses follow those of the radar, so that every mechanism of the physical echoes
takes them as it takes any other thing that moves. A blade is a flat strip: in the far field its echo is that of a
rotating line [Chen2011, ch. 3] by the width of the strip. Boxes reflect nothing; the echoes of a body that stand still
before its radar are part of the instrument's own response (`NoiseSpec.direct_path`).
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import lru_cache
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ullage.arrays import Bools, Floats, Longs
from ullage.data import Trajectory
from ullage.geometry import invert
from ullage.specs import BodySpec, BoxSpec, RadarSpec, RotorSpec
from ullage.world.materials import Material
from ullage.world.scene import Scene

BLACK = Material(name="black", a=1.0, source="opaque, without an echo")
HUB = 0.1
"""Share of a rotor's radius that the hub takes, where blades begin."""
_ALWAYS_NS = np.array([-(2**62), 2**62])


@dataclass(frozen=True, slots=True, eq=False)
class OnBody:
    """Motion of a part of the body, in the body's frame: it turns evenly about the body's z axis through a place."""

    place: Floats  # (3) [m]
    rate_hz: float = 0.0  # counter-clockwise as seen from above
    yaw_rad: float = 0.0  # at the time 0

    @property
    def t_ns(self) -> Longs:
        """Times that it is known at."""
        return _ALWAYS_NS

    def at(self, t_ns: ArrayLike) -> Trajectory:
        """Return body_from_part at times (m) [ns]."""
        times = np.atleast_1d(np.asarray(t_ns, np.int64))
        half = np.pi * np.mod(times * 1e-9 * self.rate_hz, 1.0) + self.yaw_rad / 2
        still = np.zeros((len(times), 3))
        quat = np.stack([still[:, 0], still[:, 0], np.sin(half), np.cos(half)], 1)
        return Trajectory(times, still + self.place, quat, still, still + np.array([0, 0, 2 * np.pi * self.rate_hz]))


def of_body(scene: Scene) -> Bools:
    """Return which objects (o) are parts of the body that carries the radars."""
    return np.array([isinstance(thing.motion, OnBody) for thing in scene.objects], bool)


def carried(poses: Floats, own: Bools, path: Trajectory, spec: RadarSpec) -> Floats:
    """Bring the parts of the body to where it is.

    Args:
        poses: of the objects (n, o, 4, 4), those of parts in the body's frame.
        own: which objects (o) are parts.
        path: of the sensor (n).
        spec: the radar, whose mount gives the body's pose.

    Returns:
        The poses in the world.
    """
    if not own.any():
        return poses
    body = path.world_from_body @ invert(spec.mount.body_from_sensor())
    out = poses.copy()
    out[:, own] = body[:, None] @ poses[:, own]
    return out


@lru_cache(maxsize=4)  # a scene is prepared once for all flights in it
def with_body(scene: Scene, body: BodySpec | None) -> Scene:
    """Return the scene with the parts of a body.

    Raises:
        InputError: there is no such material.
    """
    if body is None:
        return scene
    rotors = [_rotor(rotor, f"own rotor {k}") for k, rotor in enumerate(body.rotors, 1)]
    boxes = [_box(box, f"own box {k}") for k, box in enumerate(body.boxes, 1)]
    return Scene.union([scene, *rotors, *boxes], name=scene.name)


def _rotor(rotor: RotorSpec, name: str) -> Scene:
    """Blades about the origin, the first along x; their leading edges are the higher ones."""
    angle = 2 * np.pi * np.arange(rotor.blades) / rotor.blades
    none, pitch = np.zeros(rotor.blades), np.radians(rotor.pitch_deg)
    along = np.stack([np.cos(angle), np.sin(angle), none], 1)
    ahead = np.copysign(1.0, rotor.rate_hz) * np.stack([-np.sin(angle), np.cos(angle), none], 1)
    chord = rotor.chord_m / 2 * (np.cos(pitch) * ahead + np.sin(pitch) * np.array([0, 0, 1.0]))
    near, far = HUB * rotor.radius_m * along, rotor.radius_m * along
    vertices = np.stack([near - chord, far - chord, far + chord, near + chord], 1).reshape(-1, 3)
    faces = (4 * np.arange(rotor.blades)[:, None, None] + [[0, 1, 2], [0, 2, 3]]).reshape(-1, 3)
    motion = OnBody(np.array(rotor.position_m), rotor.rate_hz, np.radians(rotor.yaw_deg))
    return _part(vertices, faces, name, rotor.material, motion)


def _box(box: BoxSpec, name: str) -> Scene:
    corners = np.array([[x, y, z] for x in (-0.5, 0.5) for y in (-0.5, 0.5) for z in (-0.5, 0.5)]) * box.size_m
    sides = np.array([[0, 1, 3, 2], [4, 6, 7, 5], [0, 4, 5, 1], [2, 3, 7, 6], [0, 2, 6, 4], [1, 5, 7, 3]])
    faces = sides[:, [[0, 1, 2], [0, 2, 3]]].reshape(-1, 3)
    motion = OnBody(np.array(box.position_m), yaw_rad=np.radians(box.yaw_deg))
    return _part(corners, faces, name, BLACK, motion)


def _part(vertices: Floats, faces: NDArray[Any], name: str, material: str | Material, motion: OnBody) -> Scene:
    made = Scene.of_mesh(vertices, faces.astype(np.int32), name=name, material=material)
    return replace(made, objects=(replace(made.objects[0], motion=motion, smooth="no"),))
