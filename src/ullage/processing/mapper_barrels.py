"""Round walls that are flown along: pieces of them that were told as flat ones touch one cylinder.

Along its axis a lying tank or a round tunnel bows no ranges, so each leg hears walls as flat as any. But a piece that
legs beside it hear elsewhere is another piece: all normals n meet on the axis, and each foot f = c + R n. The feet of a
flat wall have one normal and lie apart; those of several, as of a room, meet no common axis unless the drone flies in
it, which tells nothing.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from ullage.kernels.rolls import LEG, NORMAL, PLACE, RANGE, TRACK
from ullage.processing.mapper_bows import Hollow

Floats = NDArray[np.float64]

ALONG, FLOWN_ALONG = 0.2, 0.95  # of the track in normals, at most; of the axis, at least
LEAST_TURN, LEAST_SPREAD = float(np.cos(np.radians(10.0))), 0.2
FITS_M, FITS_NORMAL = 0.06, 0.15  # of a foot in its normal's way; of the normal, which legs far apart tell in the mean
SQUARE = 0.8  # of what lies along two ways at right angles, as a room's walls do
LEAST_OFF_M, LEAST_LEGS, LEAST_PIECES, LEAST_SHARE, LEAST_APART = 0.25, 3, 6, 0.7, 0.5
MOST_TRIED = 12  # pieces that a circle is laid through with one
BESIDE = float(np.cos(np.radians(15.0)))


def barrel_of(me: Floats, others: Floats) -> tuple[Hollow, NDArray[np.bool_]] | None:
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
    n, foot, reach = normal @ across.T, (at + others[:, RANGE, None] * normal) @ across.T, others[:, RANGE]
    n /= np.maximum(np.linalg.norm(n, axis=1), 1e-9)[:, None]
    mine = me[NORMAL : NORMAL + 3] @ across.T
    mine /= np.linalg.norm(mine)
    best = np.zeros(len(others), bool)
    turned = np.flatnonzero(asked & (abs(n @ mine) < LEAST_TURN))
    for k in turned[:: 1 + len(turned) // MOST_TRIED]:
        on = asked & _touches(*_touched(np.array([me[RANGE] * mine, foot[k]]), np.array([mine, n[k]])), foot, n, reach)
        best = on if on.sum() > best.sum() else best
    if best.sum() < LEAST_LEGS:
        return None
    centre, radius = _touched(foot[best], n[best])
    on = asked & _touches(centre, radius, foot, n, reach)
    apart = on & (abs(radius - reach) > LEAST_OFF_M)
    claimed = asked & ((n @ n[on].T).max(axis=1, initial=-1.0) > BESIDE)
    spread = np.linalg.eigvalsh(n[on].T @ n[on] / max(on.sum(), 1))[0]
    legs, share = len(np.unique(others[apart, LEG])), on.sum() / max(claimed.sum(), 1)
    enough = legs >= LEAST_LEGS and apart.sum() >= max(LEAST_PIECES, LEAST_APART * on.sum()) and share >= LEAST_SHARE
    square = abs(np.mean((n[apart] @ [1.0, 1.0j]) ** 4)) if apart.any() else 1.0
    if not enough or spread < LEAST_SPREAD**2 or square > SQUARE or radius <= 0:
        return None
    return Hollow(me[PLACE : PLACE + 3] + centre @ across, axis, float(radius), int(on.sum())), on


def _touched(foot: Floats, n: Floats) -> tuple[Floats, float]:
    """Centre (2) and radius of the circle that has these feet (m, 2) in these ways (m, 2)."""
    rows = np.concatenate([np.column_stack([np.tile(np.eye(2)[d], (len(n), 1)), n[:, d]]) for d in (0, 1)])
    out = np.linalg.lstsq(rows, np.concatenate([foot[:, 0], foot[:, 1]]), rcond=None)[0]
    return out[:2], float(out[2])


def _touches(centre: Floats, radius: float, foot: Floats, n: Floats, reach: Floats) -> NDArray[np.bool_]:
    """Whether feet (m, 2) lie on a circle where it has their normals."""
    off = foot - centre - radius * n
    along, aside = np.sum(off * n, axis=1), off[:, 0] * n[:, 1] - off[:, 1] * n[:, 0]
    return np.asarray((abs(along) < FITS_M) & (abs(aside) < FITS_M + FITS_NORMAL * abs(radius - reach)))
