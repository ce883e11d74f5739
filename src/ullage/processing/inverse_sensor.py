"""Level and possible directions of a flat wall's echo through a sensor's antenna."""

from __future__ import annotations

import numpy as np

from ullage.antenna import BoresightPattern, boresight_pattern
from ullage.data import Frames
from ullage.specs import AntennaSpec

WIDEST_RAD = np.radians(33.5)  # half openings beyond it are treated as this
ECHO_CONE, SILENCE_CONE = 50.0 / 32.5, 40.0 / 32.5  # half openings within which echoes and silence count
TILT_RAD = np.radians(15.0)
SPARE_DB = 3.0


def mirror_m(frames: Frames) -> float:
    """Amplitude times range of a perfect mirror before an antenna of 0 dBi [m]; infinite where the unit hides it.

    An image: lambda / (8 pi R). Only frames in units of path gain have it.
    """
    return float(frames.spec.wavelength_m / (8 * np.pi)) if frames.unit == "path_gain" else float(np.inf)


def rim_mirror_m(frames: Frames) -> float:
    """Amplitude times range of a perfect mirror a quarter turn off boresight [m]; infinite where the unit hides it.

    The body may tilt the boresight by 15 deg towards it. Other echoes at its range may add 3 dB.
    """
    pattern = boresight_pattern(frames.spec.antenna)
    gain_dbi = float(np.interp(np.pi / 2 - TILT_RAD, pattern.angle_rad, pattern.greatest_dbi))
    return mirror_m(frames) * 10 ** (gain_dbi / 10 + SPARE_DB / 20)


def loudest_wall_m(frames: Frames) -> float:
    """Amplitude times range that no flat wall's echo exceeds [m]; infinite where the unit hides it.

    A perfect mirror in the direction of the greatest gain. Other echoes at its range may add 3 dB.
    """
    peak_dbi = boresight_pattern(frames.spec.antenna).peak_dbi
    return mirror_m(frames) * float(10 ** (peak_dbi / 10 + SPARE_DB / 20))


def least_cosine(strength: float, isotropic_m: float, pattern: BoresightPattern) -> float:
    """Cosine to boresight below which no flat surface could be so strong; -1 where any could, or none.

    An echo stronger than that of a perfect mirror at the peak gain is focused by a hollow surface, and may come from
    any direction.

    Args:
        strength: amplitude times range of an echo [m].
        isotropic_m: that of a perfect mirror before an antenna of 0 dBi, `mirror_m` [m].
        pattern: of the sensor's antenna.
    """
    if not np.isfinite(isotropic_m):
        return -1.0
    needed_dbi = 10 * np.log10(max(strength, 1e-30) / isotropic_m) - SPARE_DB
    return float(np.cos(pattern.farthest_rad(needed_dbi))) if needed_dbi <= pattern.peak_dbi else -1.0


def heard_deg(antenna: AntennaSpec) -> tuple[float, float]:
    """Half angles from boresight in which an echo is looked for, and in which silence counts [deg].

    1.54 and 1.23 half openings: 50 and 40 deg for the X4's 32.5, where a Gaussian lobe has fallen by 7.1 and by 4.5 dB
    one way. Half openings beyond 33.5 deg count as that.
    """
    half_deg = float(np.degrees(min(boresight_pattern(antenna).half_power_rad, WIDEST_RAD)))
    return ECHO_CONE * half_deg, SILENCE_CONE * half_deg
