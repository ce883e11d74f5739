"""How far a wall goes on about the foot of the perpendicular, heard from how steady its echo's level is.

An edge at Fresnel parameter v > 1 off the foot makes the level of a mirror echo ripple by 0.225 / v as the foot moves:
Cornu's spiral winds about its end with a radius of 1 / (pi sqrt(2) v) [BornWolf1999]. The gain of the antenna is
divided out first. A slow polynomial then takes what is left of slow change.
"""

from __future__ import annotations

import math

import numpy as np

from ullage.antenna import BoresightPattern
from ullage.arrays import Floats

RIPPLE, LEAST_RIM, UNTOLD_RIM, MOST_RIM = 0.225, 0.8, 1.2, 4.0
RIPPLES_HEARD, KEPT = 1.5, 0.8  # of the rim: what is taken for slow hides some of the ripple
LEAST_ECHOES = 9
HALF_WAY, LEAST_SCATTER_M = 0.5, 0.002  # of the bend that an edge's ranges have; of ranges
SLOW = 4  # order of the polynomial that is slow change


def rim_of(level: Floats, *, least: float, most: float, slow: int = 2) -> float:
    """Fresnel parameter of the nearest straight edge that a steady level (n) of a mirror echo leaves room for.

    Between `least` and `most`; what a polynomial of order `slow` follows is no ripple.
    """
    log_level = np.log(np.maximum(level, 1e-30))
    basis = np.vander(np.linspace(-1, 1, len(level)), slow + 1)
    ripple = float(abs(log_level - basis @ np.linalg.lstsq(basis, log_level, rcond=None)[0]).max())
    return float(np.clip(RIPPLE / max(ripple, 1e-6), least, most))


def rim_along(rows: Floats, way: Floats, wavelength_m: float, pattern: BoresightPattern) -> float:
    """The same for a run of echoes on a plane, which must have gone far enough to hear such an edge.

    Args:
        rows: position x, y, range [m], height and boresight x, y of each echo (n, 6).
        way: (2) unit vector to the wall.
        wavelength_m: of the carrier [m].
        pattern: of the sensor's antenna.
    """
    if len(rows) < LEAST_ECHOES:
        return LEAST_RIM
    most = most_by_bend(rows, way)
    ahead = rows[:, 4:] @ way / np.maximum(np.hypot(rows[:, 4], rows[:, 5]), 1e-9)
    level = rows[:, 3] * rows[:, 2] * pattern.two_way_loss(ahead)
    rim = KEPT * rim_of(level, least=LEAST_RIM / KEPT, most=MOST_RIM / KEPT, slow=SLOW)
    reach = float(rows[:, 2].mean())
    aside = float(np.ptp(rows[:, 0] * -way[1] + rows[:, 1] * way[0]))
    closer = float(np.ptp(rows[:, 2]))
    # an edge h off has the phase 2 pi h^2 / (wavelength r) against the foot: turns of it while the drone flies
    turns = rim * aside / math.sqrt(wavelength_m * reach) + 0.25 * rim**2 * closer / reach
    return min(rim if turns > RIPPLES_HEARD else LEAST_RIM, most)


def most_by_bend(rows: Floats, way: Floats) -> float:
    """The most that a run's reflector may be drawn by its ranges: little where they bend as about an edge.

    Along a wall, range and way to it add up to one number; about an upright edge, or the fold of a corner, the sum
    bends by one over the range.
    """
    aside = rows[:, 0] * -way[1] + rows[:, 1] * way[0]
    basis = np.vander(aside - aside.mean(), 3)
    total = rows[:, 2] + rows[:, :2] @ way
    inverse = np.linalg.pinv(basis.T @ basis, rcond=1e-9)
    fit = inverse @ basis.T @ total
    scatter = max(float(np.std(total - basis @ fit)), LEAST_SCATTER_M)
    doubt = 2 * 2 * scatter * math.sqrt(max(float(inverse[0, 0]), 0.0))
    half_way, bend = HALF_WAY / float(rows[:, 2].mean()), abs(2 * float(fit[0]))
    if bend + doubt < half_way:
        return MOST_RIM
    return UNTOLD_RIM if bend - doubt < half_way else LEAST_RIM
