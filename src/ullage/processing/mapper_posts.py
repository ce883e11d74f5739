"""Pillars, poles and upright edges told by ranges alone: circles that are heard from outside.

What stands upright and is no thicker than a pillar is heard from every side at its distance less its radius. Its
ranges are those of a round wall of a radius below nothing, and are sought as such: no radius, of a wire or of the edge
of a wall, is one of these. A straight leg alone hears it as it would a wall that bends, and tells nothing.
"""

from __future__ import annotations

import numpy as np

from ullage.arrays import Floats
from ullage.kernels.rolls import NORMAL, PLACE
from ullage.processing.mapper_bows import Hollow
from ullage.processing.mapper_echoes import SpecularPoint
from ullage.processing.mapper_shells import (
    CLOSE_M,
    FITS_M,
    MOST_CHANCE,
    NEAR_M,
    POST_M,
    RIVAL,
    RIVAL_M,
    Heard,
    by_chance,
    circles_through,
    refined,
)

UP, ACROSS = np.array([0.0, 0.0, 1.0]), np.eye(2, 3)
RADIUS_M = (-0.5, 0.05)
LEAST_ASKED, LEAST_ON, LEAST_LEGS, LEAST_SPREAD = 6, 6, 3, 0.2


def post_of(me: Floats, others: Floats) -> tuple[Hollow, Floats] | None:
    """The upright post that a stretch and others of open direction hear, and the ways to it (m, 3), zeros where not.

    Args:
        me: the stretch (22).
        others: those around (m, 22), itself among them.
    """
    here = me[PLACE : PLACE + 3]
    mine, heard = Heard.of(me[None], here, UP, ACROSS), Heard.of(others, here, UP, ACROSS)
    asked = heard.only(heard.askable() & ~others[:, NORMAL : NORMAL + 3].any(axis=1))
    if not mine.askable()[0] or len(asked.reach) < LEAST_ASKED:
        return None
    some = asked.only(asked.differing())
    circles = circles_through(some, float(mine.reach[0]), RADIUS_M)
    circles = circles[mine.sides(circles)[0][:, 0] < NEAR_M]
    circle = _best(circles, some) if len(circles) else None
    if circle is None:
        return None
    miss, _, out = heard.sides(circle[None])
    on = miss[0] < FITS_M
    return Hollow(here + circle[:2] @ ACROSS, UP, float(circle[2]), post=True), -(out[0] @ ACROSS) * on[:, None]


def _best(circles: Floats, some: Heard) -> Floats | None:
    """The circle (3) that most ranges lie on, if it stands.

    Several legs must hear it, from ways that spread: from one side a bent wall is heard alike. What others explain
    as well, as its mirror image in a leg, leaves it open.
    """
    fits = some.sides(circles)[0] < NEAR_M
    best = int(np.argmax(fits.sum(axis=1)))
    rivals = np.linalg.norm(circles[:, :2] - circles[best, :2], axis=1) > RIVAL_M
    if (fits[rivals] & fits[best]).sum(axis=1).max(initial=0) > RIVAL * fits[best].sum():
        return None
    circle, _ = refined(circles[best], some)
    miss, _, out = (part[0] for part in some.sides(circle[None]))
    on = miss < FITS_M
    if on.sum() < LEAST_ON or len(np.unique(some.leg[on])) < LEAST_LEGS or circle[2] > POST_M:
        return None
    spread = float(np.sqrt(np.linalg.eigvalsh(out[on].T @ out[on] / on.sum())[0]))
    close = float(np.sqrt(np.mean(miss[on] ** 2))) < CLOSE_M
    stands = spread > LEAST_SPREAD and close and by_chance(on, some, len(circles)) < MOST_CHANCE
    return circle if stands else None


def along_post(foot: SpecularPoint, half_m: float, step_m: float) -> Floats:
    """Places (n, 3) on a post on which one echo of it stands, half a length to either side of its foot [m]."""
    if foot.post is None:
        return foot.at[None]
    count = int(half_m / step_m)
    return np.asarray(foot.at + step_m * np.arange(-count, count + 1)[:, None] * foot.post)
