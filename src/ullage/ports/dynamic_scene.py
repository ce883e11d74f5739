"""The scene around the radars, updated by a simulator: models that move, leave and come back."""

from __future__ import annotations

import numpy as np

from ullage.arrays import Floats
from ullage.geometry import matrix_quat
from ullage.ports.pose_events import OtherModels, Pose
from ullage.world.moving import LiveMotion
from ullage.world.scene import Scene

MOVED_M, TURNED_RAD = 1e-3, 1e-3
"""A model that is closer than this to its pose in the world file is still: a box at rest trembles by less."""


class DynamicScene:
    """A scene whose models begin to move, leave and come back.

    A model belongs to the still part of the scene until a pose differs from the one in the world file.

    Args:
        scene: the world at the start.
    """

    def __init__(self, scene: Scene) -> None:
        self.scene = self._initial = scene
        self._homes = {name: _pose_of(home) for name, home in scene.models.items() if scene.has(name)}
        self._moving: dict[str, LiveMotion] = {}
        self._gone: set[str] = set()
        self._met: set[str] = set()  # new models that were reported
        self._now_ns: int | None = None  # all poses up to this time are known

    def changed_by(self, others: OtherModels) -> bool:
        """Whether these poses change the scene or give something to report."""
        return bool(self._starting(others) or self._going(others) or self._coming(others) or others.new - self._met)

    def change(self, others: OtherModels) -> list[str]:
        """Apply a change and return lines that report it."""
        starting, going, coming = self._starting(others), self._going(others), self._coming(others)
        new, self._met = sorted(others.new - self._met), self._met | others.new
        lines = [f"{name!r} is new: what the world did not have at the start is not seen" for name in new]
        lines += [f"{name!r} has gone from the world" for name in going]
        lines += [f"{name!r} is back in the world" for name in coming]
        for name in going:
            self._moving.pop(name, None)
        self._gone = (self._gone | set(going)) - set(coming)
        for name in starting:
            appears = name in coming or self._now_ns is None  # it does not glide there
            motion = self._moving[name] = LiveMotion(*(others.poses[name] if appears else self._homes[name]))
            if self._now_ns is not None:
                motion.stand_until(self._now_ns)
            lines.append(f"{name!r} {'is not where the world has it' if appears else 'moves'}: it is followed")
        self.scene = self._initial
        for name, motion in self._moving.items():
            self.scene = self.scene.driven(name, motion)
        for name in self._gone:
            self.scene = self.scene.without(name)
        return lines

    def see(self, others: OtherModels, offset_ns: int) -> None:
        """Add the poses of moving models; `offset_ns` is added to their time."""
        for name in self._moving.keys() & others.poses.keys():
            self._moving[name].see(others.t_ns + offset_ns, *others.poses[name])

    def stand_until(self, t_ns: int) -> None:
        """Declare that all poses up to a time [ns] are known."""
        self._now_ns = t_ns
        for motion in self._moving.values():
            motion.stand_until(t_ns)

    def forget(self, t_ns: int) -> None:
        """Drop motion before this time [ns], which nobody needs any more."""
        for motion in self._moving.values():
            motion.forget(t_ns)

    def _starting(self, others: OtherModels) -> list[str]:
        return [
            name for name, pose in others.poses.items()
            if name in self._homes and name not in self._moving and _apart(pose, self._homes[name])
        ]  # fmt: skip

    def _going(self, others: OtherModels) -> list[str]:
        return sorted(name for name in others.gone if name in self._homes and name not in self._gone)

    def _coming(self, others: OtherModels) -> list[str]:
        return sorted(self._gone & others.poses.keys())


def _pose_of(world_from_model: Floats) -> Pose:
    x, y, z = world_from_model[:3, 3].tolist()
    a, b, c, d = matrix_quat(world_from_model[:3, :3]).tolist()
    return (x, y, z), (a, b, c, d)


def _apart(one: Pose, other: Pose) -> bool:
    turn = 2 * np.arccos(min(abs(float(np.dot(one[1], other[1]))), 1.0))
    return bool(np.linalg.norm(np.subtract(one[0], other[0])) > MOVED_M or turn > TURNED_RAD)
