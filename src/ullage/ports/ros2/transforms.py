"""Keep the tree of frames of reference from /tf and odometry, and interpolate transforms at past times."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ullage.arrays import Floats
from ullage.geometry import quat_matrix
from ullage.ports.intake import Place
from ullage.ports.pose_events import PoseTrack


@dataclass(frozen=True, slots=True)
class Edge:
    """Poses of a frame in its parent."""

    parent: str
    track: PoseTrack


class Transforms:
    """Tree of frames of reference."""

    def __init__(self) -> None:
        self._edges: dict[str, Edge] = {}

    def add(
        self, parent: str, child: str, t_ns: int, position: Floats, quat_xyzw: Floats, *, fixed: bool = False
    ) -> bool:
        """Add one transform, parent from child; return whether its clock stepped back."""
        edge = self._edges.get(child)
        if edge is None or edge.parent != parent or edge.track.fixed != fixed:
            edge = self._edges[child] = Edge(parent, PoseTrack(fixed=fixed))
        return edge.track.add(t_ns, position, quat_xyzw)

    def forget(self, child: str) -> None:
        """Drop the poses of a frame, for example after a step of its clock."""
        self._edges.pop(child, None)

    def above(self, name: str) -> list[str]:
        """Return a frame and those that it descends from, up to the root of its tree."""
        out = [name]
        while name in self._edges and self._edges[name].parent not in out:
            name = self._edges[name].parent
            out.append(name)
        return out

    def moves(self, name: str) -> bool:
        """Return whether any transform between a frame and its root is not fixed."""
        return any(not self._edges[one].track.fixed for one in self.above(name) if one in self._edges)

    def knows(self, name: str) -> bool:
        """Return whether a frame descends from another."""
        return name in self._edges

    def at(self, target: str, source: str, t_ns: int) -> Place[Floats]:
        """Find target_from_source (4, 4) at a time, for a target above the source in the tree."""
        out, waits, chain = np.eye(4), "", self.above(source)
        for name in chain[: chain.index(target)] if target in chain else chain:
            edge = self._edges.get(name)
            if edge is None or (name == chain[-1] != target):
                return Place("wait", missing=f"{name} is not joined to {target}")
            found, link = edge.track.at(t_ns), f"{edge.parent} to {name}"
            if found.status == "never":
                return Place("never", missing=link)
            if found.pose is None:
                waits = link
            else:
                matrix = np.eye(4)
                matrix[:3, 3], matrix[:3, :3] = found.pose[0], quat_matrix(found.pose[1])
                out = matrix @ out
        return Place("wait", missing=waits) if waits else Place("known", out)
