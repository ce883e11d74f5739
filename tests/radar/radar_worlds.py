"""Poses and worlds that several files of this room's tests share."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import ArrayLike

import ullage as ul
from ullage.radar.quadrics import Quadric
from ullage.world import scenes
from ullage.world.materials import Material
from ullage.world.scene import Scene

BLACK = Material(name="black", a=1.0)
"""Opaque, and reflects nothing."""


def db(ratio) -> float:
    return float(20 * np.log10(abs(ratio)))


def at(*position: float, roll_deg: float = 0.0) -> ul.Trajectory:
    """One pose, turned about its boresight along x."""
    half = np.deg2rad(roll_deg) / 2
    return replace(ul.Trajectory.stationary(position), quat_xyzw=np.array([[np.sin(half), 0, 0, np.cos(half)]]))


def sheet(corner: ArrayLike, u: ArrayLike, v: ArrayLike, name: str, material: Material | None = None) -> Scene:
    """A parallelogram with two sides from a corner."""
    corner, u, v = (np.array(x, float) for x in (corner, u, v))
    vertices = np.array([corner, corner + u, corner + u + v, corner + v])
    flat = replace(scenes.plate(1, 1, 1, name=name), vertices=vertices)
    return replace(flat, objects=(replace(flat.objects[0], material=material or flat.objects[0].material),))


def body(centre, radius: float, *, ball: bool, axis=(0, 0, 1.0), object_id: int = 0) -> Quadric:
    """A ball, or a drum of 18 m along an axis."""
    up = np.array(axis) / np.linalg.norm(axis)
    side = np.cross(up, [0.3, 0.5, 0.7])
    side /= np.linalg.norm(side)
    axes = np.array([side, np.cross(up, side), up])
    return Quadric(np.array(centre, float), axes, radius, -9.0, 9.0, 0.0, 0.05, object_id, is_sphere=ball)


def onto(one: Quadric, point: np.ndarray) -> np.ndarray:
    """A point (3) brought to the surface of a body, drums going on for ever."""
    away = point - one.centre
    along = 0.0 if one.is_sphere else away @ one.axes[2] * one.axes[2]
    return one.centre + along + one.radius * (away - along) / np.linalg.norm(away - along)


def dished(
    radius: float, crown: float, knuckle: float, half: float, *, steps: tuple[int, int], around: int = 64
) -> tuple[np.ndarray, np.ndarray]:
    """A cylinder, closed at both ends by part of a large ball that goes over into it by part of a torus.

    Args:
        radius: of the cylinder [m].
        crown: radius of the balls [m].
        knuckle: radius of the torus' tube [m].
        half: half the length of the cylinder [m].
        steps: points along a crown, and along a knuckle.
        around: points around the axis.
    """
    lean = np.arcsin((radius - knuckle) / (crown - knuckle))
    one, other = np.linspace(0, lean, steps[0]), np.linspace(lean, np.pi / 2, steps[1])[1:]
    sunk = np.sqrt((crown - knuckle) ** 2 - (radius - knuckle) ** 2)
    middle = np.stack([crown * np.sin(one), crown * np.cos(one) - sunk + half], 1)
    bend = np.stack([radius - knuckle + knuckle * np.sin(other), knuckle * np.cos(other) + half], 1)
    head = np.concatenate([middle, bend])
    profile = np.concatenate([head, head[::-1] * [1, -1]])
    turn = np.arange(around) * 2 * np.pi / around
    rings = profile[:, None, :1] * np.stack([np.cos(turn), np.sin(turn)], -1)
    points = np.concatenate([rings, np.broadcast_to(profile[:, None, 1:], (len(profile), around, 1))], 2)
    k, j = np.meshgrid(np.arange(len(profile) - 1), np.arange(around), indexing="ij")
    a, b = k * around + j, k * around + (j + 1) % around
    faces = np.concatenate([np.stack([a, a + around, b], -1), np.stack([b, a + around, b + around], -1)])
    return points.reshape(-1, 3), faces.reshape(-1, 3)
