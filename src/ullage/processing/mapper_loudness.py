"""Which echoes are too faint for a wall in some way: those of edges, and of the grain of a surface.

A smooth wall is a mirror, weaker by its reflection alone: the faintest building material of [ITU-R-P2040], ceiling
board of permittivity 1.48, by 20 dB, wood by 15, concrete by 8. A straight edge diffracts [Keller1962]: at range R it
is weaker than a mirror by sqrt(2 / R) / (2 sqrt(2 pi k)) times 1 to 2, for the X4 some 27 to 33 dB at 1 m and 32 to 38
at 3 m.
"""

from __future__ import annotations

import math

import numpy as np

from ullage.arrays import Bools, Floats
from ullage.processing.mapper_echoes import Echo

FAINTEST_DB, FOCUS_DB = -24.0, 10.0  # between the faintest wall and the strongest edge; a focus is no sharper
EDGE_DB, NEAR_ZONES = 6.0, 2.0  # at an edge under what is beside it; how far beside, so that other walls do not count


def level_db(strength_m: float, mirror_m: float) -> float:
    """Level of an echo against a perfect mirror's before an antenna of 0 dBi [dB]; infinite where that is not known.

    Args:
        strength_m: amplitude times range of the echo [m].
        mirror_m: that of the mirror, infinite where it is not known [m].
    """
    return 20 * math.log10(max(strength_m, 1e-30) / mirror_m) if math.isfinite(mirror_m) else math.inf


def too_faint(echoes: list[Echo], way: Floats, radius_m: float = math.inf) -> bool:
    """Whether the echoes of one reflector are fainter than those of any wall in a way (3) would be.

    A hollow wall of radius R focuses: at range r its echo is that of a flat one times |1 - r / R| to the power -1/2.
    """
    off, pattern = angle_off(echoes[-1], way), echoes[-1].pattern
    if off > pattern.main_lobe_rad:
        return False
    bend = abs(1 - echoes[-1].range_m / radius_m)
    focus = min(-10 * math.log10(max(bend, 1e-9)), FOCUS_DB)
    wall = 2 * pattern.least_gain_dbi(off) + focus + FAINTEST_DB
    return bool(np.median([e.level_db for e in echoes]) < wall)


def facing_db(echo: Echo, way: Floats) -> float:
    """Level of an echo against a perfect mirror's in a way (3) [dB]; not a number where that is not known."""
    off = angle_off(echo, way)
    if off > echo.pattern.main_lobe_rad or not math.isfinite(echo.level_db):
        return math.nan
    return echo.level_db - 2 * float(echo.pattern.gain_dbi(off))


def angle_off(echo: Echo, direction: Floats) -> float:
    """Angle of a direction (3) off the boresight that an echo was received with [rad]."""
    return math.acos(min(max(float(direction @ echo.ahead), -1.0), 1.0))


def fallen(feet: list[Echo], echoes: list[Echo], way: Floats, zone: float) -> Bools:
    """Which feet (f) of a reflector have half the level of others near by, or less: they lie past its edge.

    A half-plane whose edge is at the foot mirrors half the wave, 6 dB less; beyond it the level falls on
    [BornWolf1999]. So are those that are fainter than any wall.

    Args:
        feet: echoes asked about.
        echoes: of the reflector.
        way: to it (3).
        zone: half width of the first Fresnel zone over the root of the range [m^0.5].
    """
    mine, level = (np.array([facing_db(e, way) for e in some]) for some in (feet, echoes))
    at, all_at = (np.array([e.position + e.range_m * way for e in some]) for some in (feet, echoes))
    near = np.linalg.norm(at[:, None] - all_at, axis=2) < NEAR_ZONES * zone * np.sqrt([[e.range_m] for e in feet])
    most = np.where(near & np.isfinite(level), level, -np.inf).max(axis=1)
    return np.asarray(mine < np.maximum(most - EDGE_DB, FAINTEST_DB))
