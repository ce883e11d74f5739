"""What compiles the kernels for round bodies and walls: each runs its kernel once on next to nothing."""

from __future__ import annotations

import numpy as np


def pairs() -> None:
    """The kernel of `round_pairs`, on no bodies at all."""
    from ullage.radar.round_pairs import Bodies, paths_over

    none, rows = np.zeros(0), np.zeros((0, 3))
    bodies = Bodies(rows, np.zeros((0, 3, 3)), none, np.zeros((0, 2)), none > 0, none, none.astype(np.int32))
    paths_over(np.zeros(3), np.zeros(3), bodies, bodies)


def chains() -> None:
    """The kernel of `wall_bodies`, on one drum in a wall."""
    from ullage.radar.rounds import Round
    from ullage.radar.wall_bodies import WALL_FIRST, lines_over

    wall, drum = (Round(np.zeros(3), np.eye(3), radius, -1.0, 1.0, 0.0, 0.1, 0) for radius in (2.0, 0.3))
    lines_over(wall, drum, np.ones((2, 3)), WALL_FIRST)
