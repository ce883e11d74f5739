"""Round walls that are flown along: pieces of them that were told as flat ones touch one cylinder.

Along its axis a lying tank or a round tunnel bows no ranges, so each leg hears walls as flat as any. But a piece that
legs beside it hear elsewhere is another piece: all normals n meet on the axis, and each foot f = c + R n. The feet of a
flat wall have one normal and lie apart; those of several, as of a room, meet no common axis unless the drone flies in
it, which tells nothing.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ullage.arrays import Bools, Floats
from ullage.kernels.rolls import LEG, NORMAL, PLACE, RANGE, TRACK
from ullage.processing.mapper_bows import Hollow

ALONG, FLOWN_ALONG = 0.2, 0.95  # of the track in normals, at most; of the axis, at least
LEAST_TURN, LEAST_SPREAD = float(np.cos(np.radians(10.0))), 0.2
FITS_M, FITS_NORMAL = 0.06, 0.15  # of a foot in its normal's way; of the normal, which legs far apart tell in the mean
SQUARE = 0.8  # of what lies along two ways at right angles, as a room's walls do
LEAST_OFF_M, LEAST_LEGS, LEAST_PIECES, LEAST_SHARE, LEAST_APART = 0.25, 3, 6, 0.7, 0.5
MOST_TRIED = 12  # pieces that a circle is laid through with one
BESIDE = float(np.cos(np.radians(15.0)))


@dataclass(frozen=True, slots=True, eq=False)
class Pieces:
    """Pieces of wall that stretches were told, seen along an axis."""

    foot: Floats  # (m, 2) [m]
    n: Floats  # (m, 2) unit vectors to them
    reach: Floats  # (m) [m]
    leg: Floats  # (m) number of the leg
    asked: Bools  # (m) which count

    def on(self, centre: Floats, radius: float) -> Bools:
        """Which lie on a circle where it has their normals (m)."""
        off = self.foot - centre - radius * self.n
        along, aside = np.sum(off * self.n, axis=1), off[:, 0] * self.n[:, 1] - off[:, 1] * self.n[:, 0]
        near = (abs(along) < FITS_M) & (abs(aside) < FITS_M + FITS_NORMAL * abs(radius - self.reach))
        return np.asarray(self.asked & near)

    def is_round(self, on: Bools, radius: float) -> bool:
        """Whether those on a circle (m) are enough, heard from beside its centre, and of no walls at right angles."""
        apart = on & (abs(radius - self.reach) > LEAST_OFF_M)
        claimed = self.asked & ((self.n @ self.n[on].T).max(axis=1, initial=-1.0) > BESIDE)
        spread = np.linalg.eigvalsh(self.n[on].T @ self.n[on] / max(on.sum(), 1))[0]
        legs, share = len(np.unique(self.leg[apart])), on.sum() / max(claimed.sum(), 1)
        enough = (
            legs >= LEAST_LEGS and apart.sum() >= max(LEAST_PIECES, LEAST_APART * on.sum()) and share >= LEAST_SHARE
        )
        square = abs(np.mean((self.n[apart] @ [1.0, 1.0j]) ** 4)) if apart.any() else 1.0
        return bool(enough and spread >= LEAST_SPREAD**2 and square <= SQUARE)


def barrel_of(me: Floats, others: Floats) -> tuple[Hollow, Bools] | None:
    """The round wall that a stretch's piece and others touch, and which of them do (m).

    Args:
        me: the stretch (22), its normal known.
        others: those around (m, 22), itself among them.
    """
    normal, at = others[:, NORMAL : NORMAL + 3], others[:, PLACE : PLACE + 3] - me[PLACE : PLACE + 3]
    asked = normal.any(axis=1) & (abs(normal @ me[TRACK : TRACK + 3]) < ALONG)
    if abs(me[NORMAL : NORMAL + 3] @ me[TRACK : TRACK + 3]) > ALONG or len(np.unique(others[asked, LEG])) < LEAST_LEGS:
        return None
    axis = np.linalg.eigh(normal[asked].T @ normal[asked])[1][:, 0]
    if abs(axis @ me[TRACK : TRACK + 3]) < FLOWN_ALONG:
        return None
    across = np.linalg.svd(axis[None])[2][1:]
    n, foot = normal @ across.T, (at + others[:, RANGE, None] * normal) @ across.T
    n /= np.maximum(np.linalg.norm(n, axis=1), 1e-9)[:, None]
    found = _circle(me, Pieces(foot, n, others[:, RANGE], others[:, LEG], asked), across)
    if found is None:
        return None
    centre, radius, on = found
    return Hollow(me[PLACE : PLACE + 3] + centre @ across, axis, radius, int(on.sum())), on


def _circle(me: Floats, pieces: Pieces, across: Floats) -> tuple[Floats, float, Bools] | None:
    """Centre (2), radius and pieces (m) of the circle that a stretch (22) and most of the others touch.

    Tried are those through the stretch's piece, seen along `across` (2, 3), and one of the others.
    """
    mine = me[NORMAL : NORMAL + 3] @ across.T
    mine /= np.linalg.norm(mine)
    best = np.zeros(len(pieces.foot), bool)
    turned = np.flatnonzero(pieces.asked & (abs(pieces.n @ mine) < LEAST_TURN))
    for k in turned[:: 1 + len(turned) // MOST_TRIED]:
        through = _touched(np.array([me[RANGE] * mine, pieces.foot[k]]), np.array([mine, pieces.n[k]]))
        on = pieces.on(*through)
        best = on if on.sum() > best.sum() else best
    if best.sum() < LEAST_LEGS:
        return None
    centre, radius = _touched(pieces.foot[best], pieces.n[best])
    on = pieces.on(centre, radius)
    return (centre, radius, on) if radius > 0 and pieces.is_round(on, radius) else None


def _touched(foot: Floats, n: Floats) -> tuple[Floats, float]:
    """Centre (2) and radius of the circle that has these feet (m, 2) in these ways (m, 2)."""
    rows = np.concatenate([np.column_stack([np.tile(np.eye(2)[d], (len(n), 1)), n[:, d]]) for d in (0, 1)])
    out = np.linalg.lstsq(rows, np.concatenate([foot[:, 0], foot[:, 1]]), rcond=None)[0]
    return out[:2], float(out[2])
