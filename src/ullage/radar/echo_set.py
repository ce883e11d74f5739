"""What echoes have been laid on a radar's delay grids, and where they came from."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

from ullage.arrays import Bools, Complexes, Floats, Ints, Longs

Again = Callable[[Complexes, Complexes], None]
Places = Callable[[], Floats]


@dataclass(frozen=True, slots=True, eq=False)
class EchoSet:
    """Echoes laid down, for those who want to know where they came from."""

    object_ids: Ints  # (m) object
    points: Floats | Places  # (m, 3) [m], or what gives them: most frames are never explained
    echo: Complexes  # (m) at the carrier
    delay_s: Floats  # (m)
    again: Again  # lays them once more, each times a factor (m), on other grids (3, g)
    via: Longs | None = None  # (m, 2) objects that mirror on the way, -1 for none; None: none at all
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
    put: Callable[..., None], transmission: Complexes, grids: Complexes, object_ids: Ints, points: Floats | Places,
    **more: Any,
) -> EchoSet:  # fmt: skip
    """Lays echoes (m) with factors of what stands before them by `put`, told both, the grids, echoes and delays.

    What `more` there is to tell of them is as in `EchoSet`.
    """
    many = len(transmission)
    echo, delay = np.empty(many, complex), np.empty(many)
    put(transmission, grids, echo, delay)

    def again(factors: Complexes, others: Complexes) -> None:
        put(transmission * factors, others, np.empty(many, complex), np.empty(many))

    return EchoSet(object_ids, points, echo, delay, again, **more)
