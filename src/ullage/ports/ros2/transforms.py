"""Keep the tree of frames of reference from /tf and odometry, and interpolate transforms at past times."""

from __future__ import annotations

from bisect import bisect_left
from collections import deque
from dataclasses import dataclass, field
from typing import Literal, NamedTuple

import numpy as np

from ullage.arrays import Floats
from ullage.geometry import quat_matrix, rotations

KEPT_NS = 30_000_000_000
GAP_NS = 1_000_000_000
"""Between two poses farther apart than this nothing is guessed."""

Status = Literal["ok", "wait", "lost", "unknown"]
"""Known; not yet, a later pose must come first; no more, or in a gap; the frames are not joined."""


class Answer(NamedTuple):
    """Transform at a time, if it is known."""

    status: Status
    matrix: Floats | None = None  # (4, 4) target_from_source
    what: str = ""  # the root that the frame descends from, if the transform is not known


@dataclass
class Edge:
    """Pose of a frame in its parent over time."""

    parent: str
    fixed: bool = False
    t_ns: deque[int] = field(default_factory=deque)
    poses: deque[tuple[Floats, Floats]] = field(default_factory=deque)  # position (3) [m], quaternion xyzw (4)

    def add(self, t_ns: int, position: Floats, quat_xyzw: Floats) -> bool:
        """Add a pose; return whether the clock stepped back, which clears all earlier poses."""
        jumped = bool(self.t_ns) and t_ns < self.t_ns[-1] - GAP_NS
        if jumped or self.fixed:
            self.t_ns.clear()
            self.poses.clear()
        if self.t_ns and t_ns <= self.t_ns[-1]:
            self._slip_in(t_ns, position, quat_xyzw)
        else:
            self.t_ns.append(t_ns)
            self.poses.append((position, quat_xyzw))
        while self.t_ns[-1] - self.t_ns[0] > KEPT_NS:
            self.t_ns.popleft()
            self.poses.popleft()
        return jumped

    def _slip_in(self, t_ns: int, position: Floats, quat_xyzw: Floats) -> None:
        """Insert a late pose."""
        row = bisect_left(self.t_ns, t_ns)
        if self.t_ns[row] != t_ns:
            self.t_ns.insert(row, t_ns)
            self.poses.insert(row, (position, quat_xyzw))

    def at(self, t_ns: int) -> tuple[Status, Floats | None]:
        """Interpolate parent_from_child (4, 4) at a time: linear in position, along the great arc in attitude."""
        if self.fixed:
            return "ok", _matrix(*self.poses[-1])
        if t_ns > self.t_ns[-1]:
            return "wait", None
        row = bisect_left(self.t_ns, t_ns)
        if self.t_ns[row] == t_ns:
            return "ok", _matrix(*self.poses[row])
        if row == 0 or self.t_ns[row] - self.t_ns[row - 1] > GAP_NS:
            return "lost", None
        share = (t_ns - self.t_ns[row - 1]) / (self.t_ns[row] - self.t_ns[row - 1])
        (a, turn_a), (b, turn_b) = self.poses[row - 1], self.poses[row]
        before, after = rotations().from_quat(turn_a), rotations().from_quat(turn_b)
        turn = before * rotations().from_rotvec(share * (before.inv() * after).as_rotvec())
        return "ok", _matrix(a + share * (b - a), turn.as_quat())


class Transforms:
    """Tree of frames of reference."""

    def __init__(self) -> None:
        self._edges: dict[str, Edge] = {}

    def add(
        self, parent: str, child: str, t_ns: int, position: Floats, quat_xyzw: Floats, *, fixed: bool = False
    ) -> bool:
        """Add one transform, parent from child; return whether its clock stepped back."""
        edge = self._edges.get(child)
        if edge is None or edge.parent != parent or edge.fixed != fixed:
            edge = self._edges[child] = Edge(parent, fixed)
        return edge.add(t_ns, position, quat_xyzw)

    def forget(self, child: str) -> None:
        """Drop the poses of a frame, for example after a step of its clock."""
        self._edges.pop(child, None)

    def root(self, name: str) -> str:
        """Return the root of the tree that contains this frame."""
        seen = {name}
        while name in self._edges and self._edges[name].parent not in seen:
            name = self._edges[name].parent
            seen.add(name)
        return name

    def moves(self, name: str) -> bool:
        """Return whether any transform between a frame and its root is not fixed."""
        seen: set[str] = set()
        while name in self._edges and name not in seen:
            if not self._edges[name].fixed:
                return True
            seen.add(name)
            name = self._edges[name].parent
        return False

    def knows(self, name: str) -> bool:
        """Return whether a frame descends from another."""
        return name in self._edges

    def at(self, target: str, source: str, t_ns: int) -> Answer:
        """Find target_from_source at a time, for a target above the source in the tree."""
        out, name, seen = np.eye(4), source, {source}
        waits = ""
        while name != target:
            edge = self._edges.get(name)
            if edge is None or edge.parent in seen:
                return Answer("unknown", what=f"{name} is not joined to {target}")
            status, matrix = edge.at(t_ns)
            if status == "lost":
                return Answer("lost", what=f"{edge.parent} to {name}")
            if matrix is None:
                waits = f"{edge.parent} to {name}"
            else:
                out = matrix @ out
            name = edge.parent
            seen.add(name)
        return Answer("wait", what=waits) if waits else Answer("ok", out)


def _matrix(position: Floats, quat_xyzw: Floats) -> Floats:
    out = np.eye(4)
    out[:3, :3], out[:3, 3] = quat_matrix(quat_xyzw), position
    return out
