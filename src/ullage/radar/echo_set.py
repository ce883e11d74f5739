"""What echoes have been laid on a radar's delay grids, and where they came from."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, fields, replace
from typing import Any, ClassVar, Self

import numpy as np

from ullage.arrays import Bools, Complexes, Floats, Ints, Longs
from ullage.kernels.facets import EchoSums, Transmission

Again = Callable[[Complexes, Complexes], None]
Places = Callable[[], Floats]
Put = Callable[[Transmission, EchoSums], None]


class OnObjects:
    """Base of dataclasses of things (n) on objects, in the frames of these; `object_ids` (n) are among the fields."""

    __slots__ = ()
    POINTS: ClassVar[tuple[str, ...]] = ()
    """Names of arrays (n, ..., 3) of places [m]."""
    DIRECTIONS: ClassVar[tuple[str, ...]] = ()
    """Names of arrays (n, ..., 3) of directions, which turn with the objects and are not shifted."""

    def placed(self, poses: Floats | None) -> Self:
        """Place them in the world where the objects have these poses (o, 4, 4); None: nothing moves."""
        if poses is None:
            return self
        of: Ints = self.object_ids  # type: ignore[attr-defined]
        turn, shift = poses[of, :3, :3], poses[of, :3, 3]
        now = {name: np.einsum("nij,n...j->n...i", turn, getattr(self, name)) for name in self.POINTS + self.DIRECTIONS}
        return replace(self, **now | {name: now[name] + shift for name in self.POINTS})  # type: ignore[type-var]


class Rows(OnObjects):
    """Base of dataclasses that hold one row of each array for each of several things."""

    __slots__ = ()

    def __len__(self) -> int:
        return len(self.object_ids)  # type: ignore[attr-defined]

    def take(self, index: Bools | Longs) -> Self:
        """Select some of them."""
        return type(self)(*(getattr(self, f.name)[index] for f in fields(self)))  # type: ignore[arg-type]

    @classmethod
    def joined(cls, parts: Sequence[Self]) -> Self:
        """Join those of several bodies."""
        return cls(*(np.concatenate([getattr(p, f.name) for p in parts]) for f in fields(cls)))  # type: ignore[arg-type]


@dataclass(frozen=True, slots=True, eq=False)
class EchoSet:
    """Echoes laid down, for those who want to know where they came from."""

    object_ids: Ints  # (m) object
    points: Floats | Places  # (m, 3) [m], or what gives them: most frames are never explained
    echo: Complexes  # (m) at the carrier
    delay_s: Floats  # (m)
    again: Again  # lays them once more, each times a factor (m), on other grids (3, g)
    via: Longs | None = None  # (m, d) objects that mirror on the way, -1 for none; None: none at all
    before: Longs | None = None  # (m) how many of them before the object; None: all
    rays: Bools | None = None  # (m) true for a mirror point, false for what its rim adds; None: neither

    @property
    def places(self) -> Floats:
        """Where each echo came from (m, 3) [m]."""
        return self.points() if callable(self.points) else self.points


def centroids(triangles: Floats) -> Floats:
    """Centres (n, 3) of triangles (n, 3, 3); numpy's mean takes five times as long over so short an axis."""
    return np.asarray((triangles[:, 0] + triangles[:, 1] + triangles[:, 2]) / 3)


def echo_set(
    put: Put, between: Transmission, grids: Complexes, object_ids: Ints, points: Floats | Places, **more: Any
) -> EchoSet:
    """Add echoes (m) to the delay grids, and keep what made them.

    Args:
        put: calls the kernel that adds the echoes.
        between: what lies between the radar and each of them.
        grids: (3, g) delay grids, added to.
        object_ids: (m) object of each.
        points: (m, 3) where each comes from [m], or what gives that.
        **more: further fields of `EchoSet`.
    """
    many = len(between.factor)
    sums = EchoSums(grids, np.empty(many, complex), np.empty(many))
    put(between, sums)

    def again(factors: Complexes, others: Complexes) -> None:
        put(between._replace(factor=between.factor * factors),
            EchoSums(others, np.empty(many, complex), np.empty(many)))  # fmt: skip

    return EchoSet(object_ids, points, sums.echo, sums.delay_s, again, **more)
