"""Where silence ends in a volume: at walls that are known, and at those that what is heard may have come from.

A smooth wall answers from the foot of the perpendicular alone. That it is silent beside that says nothing of it, so how
far it goes on is not heard but held open: as far again as it is known, and where it is heard now, all across the beam.
"""

from __future__ import annotations

import numpy as np

from ullage.arrays import Floats, Longs
from ullage.processing.mapper_bows import bow_of, hollow_of
from ullage.processing.mapper_echoes import Echo

BEYOND_M, LEVEL_M, SHADE_SLOPE = 1.0, 12.0, 0.6
FITS_M, FITS_COSINE, EXPLAINED = 0.04, 0.08, 3.0
RING_STEP, RING_TRUST, BOWED = np.radians(15.0), 0.4, 26


def sheets_of(levels: list[tuple[int, float]], position: Floats) -> Floats:
    """Walls (p, 8) that are floor (-1) and ceiling (1) at these heights around a place [m]."""
    return np.array([[0, 0, sign, sign * z, *position[:2], z, LEVEL_M] for sign, z in levels]).reshape(-1, 8)


def further(walls: Floats) -> Floats:
    """Known walls (p, 8) out to as far again: of what goes on unseen, so much more is as likely as not."""
    out = walls.copy()
    out[:, 7] = 2 * out[:, 7] - BEYOND_M
    return out


def across_beam(echo: Echo, way: Floats) -> Floats:
    """The part (8) of a wall in some way (3) that may lie in the beam of an echo off it."""
    foot = echo.position + echo.range_m * way
    return np.array([*way, way @ foot, *foot, max(BEYOND_M, SHADE_SLOPE * echo.range_m)])


def explained_by(echoes: list[Echo], walls: Floats) -> Longs:
    """Which of these walls (p, 8) echoes (e) may be off, wherever on them, by range, bearing and loudness; -1: none."""
    if not echoes or not len(walls):
        return np.full(len(echoes), -1)
    at, track = np.array([e.position for e in echoes]), np.array([e.track for e in echoes])
    reach, cosine, sigma = np.array([(e.range_m, e.cosine, e.sigma) for e in echoes]).T[:, :, None]
    miss = abs(walls[:, 3] - at @ walls[:, :3].T - reach) / FITS_M
    turn = abs(track @ walls[:, :3].T - cosine) / (FITS_COSINE + sigma)
    loud = np.array([e.ahead for e in echoes]) @ walls[:, :3].T < np.array([e.within for e in echoes])[:, None]
    fits = np.where(loud, np.inf, np.hypot(miss, turn))
    return np.asarray(np.where(fits.min(axis=1) < EXPLAINED, fits.argmin(axis=1), -1))


def screens_of(echoes: list[Echo], ahead: Floats, least: float) -> Floats:
    """Walls (p, 8) that echoes of an open direction may have come from: one for each stretch of the ring in the beam.

    Each has normal and distance, centre and radius as `EchoTracks.walls` [m].
    """
    last = echoes[-1]
    if np.mean([e.trust for e in echoes]) < RING_TRUST:
        return np.zeros((0, 8))
    cosine = float(np.clip(last.cosine, -1, 1))
    level = np.cross(last.track, [0.0, 0.0, 1.0])
    level /= max(float(np.linalg.norm(level)), 1e-9)
    turn = np.arange(-np.pi, np.pi - 1e-9, RING_STEP)[:, None]
    round_ = np.cos(turn) * level + np.sin(turn) * np.cross(level, last.track)
    normal = cosine * last.track + np.sqrt(1 - cosine**2) * round_
    normal = normal[normal @ ahead > least]
    foot = 0.5 * (last.position + echoes[0].position) + 0.5 * (last.range_m + echoes[0].range_m) * normal
    far = np.sum(normal * (last.position + last.range_m * normal), axis=1)
    half = 0.5 * np.linalg.norm(last.position - echoes[0].position) + max(BEYOND_M, SHADE_SLOPE * last.range_m)
    flat = np.column_stack([normal, far, foot, np.full(len(normal), half)])
    return np.concatenate([flat, *_beside(echoes, normal)])


def _beside(echoes: list[Echo], ways: Floats) -> list[Floats]:
    """Planes (6, 8) that touch hollow walls beside where ways (w, 3) meet them, for those that bow ranges so."""
    bow = bow_of(echoes[-BOWED:])
    if bow is None:
        return []
    out = []
    for way in ways[bow.bent(ways)]:
        hollow = hollow_of(bow, way, np.cross(way, bow.track))
        if hollow.radius_m > 0:
            planes = hollow.tangents(way, echoes[-1].position)
            out.append(np.column_stack([planes, np.full(len(planes), BEYOND_M)]))
    return out
