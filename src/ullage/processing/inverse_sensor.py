"""What one range profile says: its noise, its first echo, and how well the antenna sees each direction."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from ullage.data import Frames
from ullage.processing.own_echo import DIRECT_PATH_M
from ullage.specs import AntennaSpec

Floats = NDArray[np.float64]
RAYLEIGH_MEDIAN = 1.1774
FALSE_ALARM_SIGMAS = 6.0
DYNAMIC = 10 ** (-40 / 20)
X4A02_DEG, WIDEST_DEG = 65.0, 67.0
RIM_DBI = -3.0
OFF_DEG, OFF_DBI = (
    np.array([0.0, 32.5, 47.5, 90.0]),
    np.array([6.0, 3.0, 0.0, -5.0]),
)  # of the X4's antenna [NoveldaX4A02]
SPARE_DB = 3.0


def noise_sigma(frames: Frames) -> Floats:
    """Noise of one component (n), from the quietest half of each profile's bins, in the frames' unit."""
    quiet = np.sort(frames.amplitude, axis=1)[:, : max(frames.samples.shape[1] // 2, 4)]
    return np.asarray(np.maximum(np.median(quiet, axis=1) / 0.7585, 1e-30), np.float64)


def blank_m(frames: Frames) -> float:
    """Range below which the direct path and the device itself speak [m]."""
    if frames.unit == "thesis":
        return frames.spec.thesis.min_range_m
    return max(DIRECT_PATH_M, float(frames.range_m[0]))


def echo_level(frames: Frames) -> NDArray[np.float32]:
    """Amplitude above which a bin holds an echo (n), in the frames' unit."""
    if frames.unit == "thesis":
        return np.full(len(frames), frames.spec.thesis.threshold, np.float32)
    strongest = frames.amplitude[:, frames.range_m >= blank_m(frames)].max(axis=1)
    return np.asarray(np.maximum(FALSE_ALARM_SIGMAS * noise_sigma(frames), DYNAMIC * strongest), np.float32)


def first_echo(frames: Frames, *, threshold: float | None = None) -> tuple[Floats, NDArray[np.bool_]]:
    """Range of the first peak over the threshold (n) [m], and whether there is one (n).

    Args:
        frames: one sensor's.
        threshold: in the frames' unit; None: 0.038 for the thesis' frames, else six times the noise.
    """
    amplitude = frames.amplitude.astype(np.float64)
    if threshold is not None or frames.unit == "thesis":
        level = np.full(len(frames), frames.spec.thesis.threshold if threshold is None else threshold)
    else:
        level = FALSE_ALARM_SIGMAS * noise_sigma(frames)
    peak = np.zeros(amplitude.shape, bool)
    peak[:, 1:-1] = (amplitude[:, 1:-1] >= amplitude[:, :-2]) & (amplitude[:, 1:-1] > amplitude[:, 2:])
    peak &= (amplitude >= level[:, None]) & (frames.range_m >= blank_m(frames))
    return frames.range_m[np.argmax(peak, axis=1)], np.asarray(peak.any(axis=1))


def mirror_m(frames: Frames) -> float:
    """Amplitude times range of a perfect mirror before an antenna of 0 dBi [m]; infinite where that is not known.

    An image: lambda / (8 pi R).
    """
    if frames.unit != "path_gain" or frames.spec.antenna.kind != "x4a02":
        return float(np.inf)
    return float(frames.spec.wavelength_m / (8 * np.pi))


def rim_mirror_m(frames: Frames) -> float:
    """Amplitude times range of a perfect mirror a quarter turn off boresight [m]; infinite where that is not known.

    The X4's antenna has no more than -5 dBi there; 2 dB are added for a body that tilts.
    """
    return mirror_m(frames) * 10 ** (RIM_DBI / 10)


def loudest_wall_m(frames: Frames) -> float:
    """Amplitude times range that no flat wall's echo exceeds [m]; infinite where that is not known.

    A perfect mirror straight ahead, with 3 dB for what else is heard at its range.
    """
    return mirror_m(frames) * float(10 ** (OFF_DBI[0] / 10 + SPARE_DB / 20))


def least_cosine(strength: float, isotropic_m: float) -> float:
    """Cosine to boresight below which no flat surface could be so loud; -1 where any could, or none.

    What is louder than a perfect mirror ahead is focused by a hollow surface, and may come from anywhere.

    Args:
        strength: amplitude times range of an echo [m].
        isotropic_m: that of a perfect mirror before an antenna of 0 dBi, `mirror_m` [m].
    """
    if not np.isfinite(isotropic_m):
        return -1.0
    needed = 10 * np.log10(max(strength, 1e-30) / isotropic_m) - SPARE_DB
    if not OFF_DBI[-1] < needed <= OFF_DBI[0]:
        return -1.0
    return float(np.cos(np.radians(np.interp(needed, OFF_DBI[::-1], OFF_DEG[::-1]))))


def heard_deg(antenna: AntennaSpec) -> tuple[float, float]:
    """Half angles from boresight in which an echo is looked for, and in which silence counts [deg].

    Where a Gaussian lobe of the antenna's -3 dB opening has fallen by 7.1 and by 4.5 dB one way: 50 and 40 deg for the
    X4's 65. Openings beyond 67 deg are taken as that; so is an antenna that sees all ways alike.
    """
    opening = X4A02_DEG if antenna.kind == "x4a02" else WIDEST_DEG
    if antenna.kind == "cosine":
        opening = min(float(np.sqrt(antenna.azimuth_deg * antenna.elevation_deg)), WIDEST_DEG)
    return 50.0 * opening / 65.0, 40.0 * opening / 65.0
