"""The world around the radars as a simulator goes on to tell it: what moves, goes and comes back."""

from __future__ import annotations

import numpy as np

from ullage.arrays import Floats
from ullage.geometry import matrix_quat
from ullage.ports.pose_events import Others, Pose
from ullage.world.moving import LiveMotion
from ullage.world.scene import Scene

MOVED_M, TURNED_RAD = 1e-3, 1e-3
"""Nearer to where the world's file has it, a model stands still: a box at rest trembles by less."""


class Surroundings:
    """A scene whose models begin to move, go and come back.

    A model is a part of the still world until it is first seen elsewhere than there.

    Args:
        scene: the world as it was told at the start.
    """

    def __init__(self, scene: Scene) -> None:
        self.scene = self._whole = scene
        self._homes = {name: _pose_of(home) for name, home in scene.models.items() if scene.has(name)}
        self._moving: dict[str, LiveMotion] = {}
        self._gone: set[str] = set()
        self._met: set[str] = set()  # what is new, and was said
        self._now_ns: int | None = None  # until when everything was told

    def changed_by(self, told: Others) -> bool:
        """Whether the scene is another one after this, or something is to be said."""
        return bool(self._starting(told) or self._going(told) or self._coming(told) or told.new - self._met)

    def change(self, told: Others) -> list[str]:
        """Take a change in; what a person should know of it."""
        starting, going, coming = self._starting(told), self._going(told), self._coming(told)
        new, self._met = sorted(told.new - self._met), self._met | told.new
        said = [f"{name!r} is new: what the world did not have at the start is not seen" for name in new]
        said += [f"{name!r} has gone from the world" for name in going]
        said += [f"{name!r} is back in the world" for name in coming]
        for name in going:
            self._moving.pop(name, None)
        self._gone = (self._gone | set(going)) - set(coming)
        for name in starting:
            appears = name in coming or self._now_ns is None  # it does not glide there
            motion = self._moving[name] = LiveMotion(*(told.poses[name] if appears else self._homes[name]))
            if self._now_ns is not None:
                motion.stand_until(self._now_ns)
            said.append(f"{name!r} {'is not where the world has it' if appears else 'moves'}: it is followed")
        self.scene = self._whole
        for name, motion in self._moving.items():
            self.scene = self.scene.driven(name, motion)
        for name in self._gone:
            self.scene = self.scene.without(name)
        return said

    def see(self, told: Others, offset_ns: int) -> None:
        """Take the poses of what moves; to their time is added `offset_ns`."""
        for name in self._moving.keys() & told.poses.keys():
            self._moving[name].see(told.t_ns + offset_ns, *told.poses[name])

    def stand_until(self, t_ns: int) -> None:
        """Everything has been told up to a time [ns]."""
        self._now_ns = t_ns
        for motion in self._moving.values():
            motion.stand_until(t_ns)

    def forget(self, t_ns: int) -> None:
        """Nothing before this time is asked for any more [ns]."""
        for motion in self._moving.values():
            motion.forget(t_ns)

    def _starting(self, told: Others) -> list[str]:
        return [
            name for name, pose in told.poses.items()
            if name in self._homes and name not in self._moving and _apart(pose, self._homes[name])
        ]  # fmt: skip

    def _going(self, told: Others) -> list[str]:
        return sorted(name for name in told.gone if name in self._homes and name not in self._gone)

    def _coming(self, told: Others) -> list[str]:
        return sorted(self._gone & told.poses.keys())


def _pose_of(world_from_model: Floats) -> Pose:
    x, y, z = world_from_model[:3, 3].tolist()
    a, b, c, d = matrix_quat(world_from_model[:3, :3]).tolist()
    return (x, y, z), (a, b, c, d)


def _apart(one: Pose, other: Pose) -> bool:
    turn = 2 * np.arccos(min(abs(float(np.dot(one[1], other[1]))), 1.0))
    return bool(np.linalg.norm(np.subtract(one[0], other[0])) > MOVED_M or turn > TURNED_RAD)
