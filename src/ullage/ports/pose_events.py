"""Events of an external simulator: poses of the model that carries the radars, poses of other models, notices."""

from __future__ import annotations

import time
from abc import ABC, abstractmethod
from bisect import bisect_left
from collections import deque
from collections.abc import Iterable, Mapping, Sequence
from contextlib import nullcontext
from dataclasses import dataclass, field
from typing import Any, Protocol

import numpy as np

from ullage.arrays import Floats
from ullage.data import Frames, Trajectory
from ullage.geometry import matrix_quat, rotations
from ullage.ports.intake import PATIENCE_S, Counters, Place, checked_pose
from ullage.world.moving import LiveMotion
from ullage.world.scene import Scene

Quat = tuple[float, float, float, float]
Pose = tuple[tuple[float, float, float], Quat]
"""Position [m] and attitude xyzw in the world."""
KEPT_NS = 30_000_000_000
POSE_GAP_NS = 1_000_000_000
"""Between two poses farther apart than this nothing is guessed."""


@dataclass(frozen=True, slots=True)
class ModelPose:
    """Pose of the model that carries the radars, at one time."""

    t_ns: int
    position: tuple[float, float, float]
    quat_xyzw: Quat


@dataclass(frozen=True, slots=True)
class BodyState:
    """Pose and motion of a vehicle: world ENU, body FLU."""

    t_ns: int
    position: Floats  # (3) [m]
    quat_xyzw: Floats  # (4) world_from_body
    velocity: Floats  # (3) world [m/s]
    spin: Floats  # (3) body [rad/s]


def path_along(states: Iterable[BodyState]) -> Trajectory:
    """Return the trajectory of states with rising times."""
    rows = [(one.t_ns, one.position, one.quat_xyzw, one.velocity, one.spin) for one in states]
    return Trajectory(*(np.array(column) for column in zip(*rows, strict=True)))


TimedPose = tuple[int, Floats, Floats]
"""Time [ns], position (3) [m] and quaternion xyzw (4)."""


def path_through(before: TimedPose | None, poses: Sequence[TimedPose]) -> Trajectory:
    """Return the path of poses with rising times; for its velocities the pose before them counts too, if known."""
    rows = poses if before is None else [before, *poses]
    path = Trajectory(*(np.array(column) for column in zip(*rows, strict=True)))
    return path if before is None else path[1:]


class PoseTrack:
    """Poses of one thing in the last half minute; between two, along a straight line and the great arc of attitudes.

    Args:
        gap_ns: between two poses farther apart nothing is guessed [ns].
        fixed: the last pose holds for ever.
    """

    def __init__(self, *, gap_ns: int = POSE_GAP_NS, fixed: bool = False) -> None:
        self.fixed, self._gap_ns = fixed, gap_ns
        self._t_ns: deque[int] = deque()
        self._poses: deque[tuple[Floats, Floats]] = deque()  # position (3) [m], quaternion xyzw (4)

    def add(self, t_ns: int, position: Floats, quat_xyzw: Floats) -> bool:
        """Add a pose, also a late one; return whether the clock stepped back, which clears all earlier poses."""
        jumped = bool(self._t_ns) and t_ns < self._t_ns[-1] - self._gap_ns
        if jumped or self.fixed:
            self._t_ns.clear()
            self._poses.clear()
        behind = bool(self._t_ns) and t_ns <= self._t_ns[-1]
        row = bisect_left(self._t_ns, t_ns) if behind else len(self._t_ns)
        if not behind or self._t_ns[row] != t_ns:
            self._t_ns.insert(row, t_ns)
            self._poses.insert(row, (position, quat_xyzw))
        while self._t_ns[-1] - self._t_ns[0] > KEPT_NS:
            self._t_ns.popleft()
            self._poses.popleft()
        return jumped

    def at(self, t_ns: int) -> Place[tuple[Floats, Floats]]:
        """Return position (3) [m] and quaternion xyzw (4) at a time, once a pose at or after it is known."""
        if self.fixed:
            return Place("known", self._poses[-1])
        row = bisect_left(self._t_ns, t_ns)
        if row == len(self._t_ns):
            return Place("wait")
        if self._t_ns[row] == t_ns:
            return Place("known", self._poses[row])
        if row == 0 or self._t_ns[row] - self._t_ns[row - 1] > self._gap_ns:
            return Place("never")
        share = (t_ns - self._t_ns[row - 1]) / (self._t_ns[row] - self._t_ns[row - 1])
        (a, turn_a), (b, turn_b) = self._poses[row - 1], self._poses[row]
        before, after = rotations().from_quat(turn_a), rotations().from_quat(turn_b)
        turn = before * rotations().from_rotvec(share * (before.inv() * after).as_rotvec())
        return Place("known", (a + share * (b - a), turn.as_quat()))

    def path(self) -> Trajectory | None:
        """Return the path through all poses; None where there is none yet."""
        rows = [(t_ns, *pose) for t_ns, pose in zip(self._t_ns, self._poses, strict=True)]
        return path_through(None, rows) if rows else None


@dataclass(frozen=True, slots=True)
class OtherModels:
    """Poses of other models at one time; a model that is not named keeps its last pose."""

    t_ns: int
    poses: Mapping[str, Pose] = field(default_factory=dict)  # by name
    gone: frozenset[str] = frozenset()
    new: frozenset[str] = frozenset()  # models that the world did not have at the start


@dataclass(frozen=True, slots=True)
class Notice:
    """A line for the user, for example that the server has gone or the model is missing."""

    text: str


class Feed(Protocol):
    """Gives the poses of the model or the scans of its rays; poses of other models at the same time come first."""

    def next(self, timeout_s: float) -> Any:
        """Return the next pose, scan, change of other models or notice, or None if none came within the timeout."""

    @property
    def behind_s(self) -> float:
        """How long the oldest event waits already [s]."""

    def give(self, chunk: dict[str, Frames], offset_ns: int) -> None:
        """Publish frames; their time minus the offset is the simulator's time."""

    def close(self) -> None:
        """Close the sockets."""


class EventFeed(ABC):
    """A feed that reads the events of a peer; one event may give several results or none.

    Args:
        peer: a node, link or process on the simulator's network, which `wait`s for events.
        patience_s: after how long a silence that is reported [s].
    """

    def __init__(self, peer: Any, *, patience_s: float = PATIENCE_S) -> None:
        self._source = peer
        self.counters: Counters = peer.counters
        self._ready: deque[Any] = deque()
        self._patience_s, self._last_s, self._logged_s = patience_s, time.monotonic(), 0.0

    def next(self, timeout_s: float) -> Any:
        """Return the next pose, scan or notice, or None if none came within the timeout."""
        end = time.monotonic() + timeout_s
        while not self._ready:
            event = self._source.wait(max(0.0, end - time.monotonic()))
            if event is None:
                return self._on_silence() if timeout_s else None
            topic, last = getattr(event, "topic", ""), None
            with self.counters.reading(topic) if topic else nullcontext():
                last = self._take(event)
            if last is not None:
                self._ready.append(last)
        return self._ready.popleft()

    @property
    def behind_s(self) -> float:
        """How long the oldest event waits already [s]."""
        waits_s: float = self._source.events.behind_s
        return waits_s

    def give(self, chunk: dict[str, Frames], offset_ns: int) -> None:  # noqa: B027 (most peers want none)
        """Publish frames, where the peer wants some."""

    def close(self) -> None:
        """Close the sockets."""
        self._source.close()

    def _valid_poses(self, topic: str, poses: Mapping[str, Any]) -> dict[str, Pose]:
        """Return the poses of other models by name, and count those that are not valid."""
        out = {}
        for name, one in poses.items():
            pose = pose_of(one)
            wrong = checked_pose(*pose)
            if isinstance(wrong, str):
                self.counters.drop(topic, "bad", f"{name}: {wrong}")
            else:
                out[name] = pose
        return out

    @abstractmethod
    def _take(self, event: Any) -> Any:
        """Return the last result of an event, or None; append earlier results to `_ready`."""

    def _on_silence(self) -> Notice | None:
        """Return a notice, if one is due, after nothing of use came for a while (since `_last_s`)."""
        now = time.monotonic()
        if now - max(self._last_s, self._logged_s) < self._patience_s:
            return None
        self._logged_s = now
        return Notice(self._silence())

    @abstractmethod
    def _silence(self) -> str:
        """Return a line on what is missing, after a silence."""


def pose_of(message: Any) -> Pose:
    """Return the pose in a message of either Gazebo; a missing attitude is the identity."""
    at, turn = message.position, message.orientation
    quat = (turn.x, turn.y, turn.z, turn.w)
    return (at.x, at.y, at.z), quat if any(quat) else (0.0, 0.0, 0.0, 1.0)


def stamp_ns(message: Any) -> int:
    """Return the time in a message of either Gazebo [ns]."""
    return int(message.sec) * 10**9 + int(message.nsec)


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
