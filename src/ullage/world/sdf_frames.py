"""Resolve the frames of an SDF world: the graph of `relative_to`, `attached_to` and `placement_frame`."""

from __future__ import annotations

from collections.abc import Iterator
from itertools import count

import numpy as np

from ullage.arrays import Floats
from ullage.geometry import invert
from ullage.world.sdf_parse import Place, Pose
from ullage.world.sdf_tree import Frame, Scope


class ScopeFrames:
    """The frames of one scope and, by name, of the scopes in it.

    Args:
        scope: the world or model.
        around: the frames of the scope that holds it; None: it is the outermost.
    """

    def __init__(self, scope: Scope, around: ScopeFrames | None = None) -> None:
        self.scope = scope
        self.around = around
        self.names: dict[str, Frame | Scope] = {}
        named: list[Frame | Scope] = [*scope.models, *scope.links, *scope.frames, *scope.joints]
        for thing in named:
            self._add(thing)
        self.inner = {model.name: ScopeFrames(model, self) for model in scope.models}
        self._home: dict[str, ScopeFrames] = {}
        for inner in self.inner.values():
            if inner.scope.merged:
                self._home |= {name: inner for name in (*inner.names, *inner._home) if name not in self.names}
        self._solved: dict[str, Floats] = {scope.own_frame: np.eye(4), "": np.eye(4)}
        self._attached: set[str] = set()
        for frame in scope.frames:
            self._check_attached(frame)

    def _add(self, thing: Frame | Scope) -> None:
        if thing.name in self.names:
            thing.node.place.warn(f"the name {thing.name!r} is used twice in {self.scope.name!r}", kind="name twice")
            names = (f"{thing.name}_{number}" for number in count(1))
            thing.name = next(name for name in names if name not in self.names)
        self.names[thing.name] = thing

    def parts(self) -> Iterator[ScopeFrames]:
        """This scope, and those that are merged into it."""
        yield self
        for inner in self.inner.values():
            if inner.scope.merged:
                yield from inner.parts()

    def world_from_scope(self) -> Floats:
        """The transform (4, 4) from this scope to the outermost one."""
        if self.around is None:
            return np.eye(4)
        return self.around.world_from_scope() @ self.around.scope_from(self.scope.name, at=self.scope.node.place)

    def scope_from_pose(self, pose: Pose, usual: str, *, at: Place) -> Floats:
        """Return the transform of an element with this pose, which without `relative_to` is in the frame `usual`."""
        return self.scope_from(pose.relative_to or usual, at=pose.place or at) @ pose.matrix

    def scope_from(self, name: str, *, at: Place) -> Floats:
        """The transform (4, 4) from a named frame, `a::b` for frame b of model a, to this scope.

        Raises:
            InputError: no such frame, or the poses go in a circle.
        """
        chain: dict[str, Floats] = {}
        while name not in self._solved:
            if name in chain:
                ring = list(chain)
                at.refuse("the poses go in a circle: " + " -> ".join([*ring[ring.index(name) :], name]))
            parent, chain[name], at = self._step(name, at)
            name = parent
        here = self._solved[name]
        for one, matrix in reversed(chain.items()):
            here = here @ matrix
            self._solved[one] = here
        return here

    def _step(self, name: str, at: Place) -> tuple[str, Floats, Place]:
        """Return the parent frame of a frame's pose, the transform to it, and its place in the file."""
        thing = self.names.get(name)
        if thing is None:
            return self._outside(name, at)
        place = thing.pose.place or thing.node.place
        usual, matrix = "", thing.pose.matrix
        if isinstance(thing, Frame):
            usual = thing.base
        elif thing.placement_frame:
            matrix = matrix @ invert(self.inner[name].scope_from(thing.placement_frame, at=place))
        return thing.pose.relative_to or usual, matrix, place

    def _outside(self, name: str, at: Place) -> tuple[str, Floats, Place]:
        model, _, rest = name.partition("::")
        while model not in self._home and rest:  # up to SDF 1.7 a model's own name may hold the ::
            if model in self.inner:
                return model, self.inner[model].scope_from(rest, at=at), at
            more, _, rest = rest.partition("::")
            model = f"{model}::{more}"
        if model in self._home:
            inner = self._home[model]
            return inner.scope.name, inner.scope_from(name, at=at), at
        known = [self.scope.own_frame, *self.names, *self._home]
        at.refuse(
            f"no frame {name!r} in {self.scope.name!r}", allowed=", ".join(known[:12]) + ", ..." * (len(known) > 12)
        )

    def _check_attached(self, frame: Frame) -> None:
        seen = {frame.name: None}
        at = frame
        while at.base and isinstance(following := self.names.get(at.base), Frame) and following.node.tag == "frame":
            if following.name in self._attached:
                break
            if following.name in seen:
                frame.node.place.refuse("the frames are attached in a circle: " + " -> ".join([*seen, following.name]))
            seen[following.name] = None
            at = following
        else:
            if at.base:
                self.scope_from(at.base, at=at.node.place)
        self._attached |= set(seen)
