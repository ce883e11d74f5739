"""At which height the brightest point of a plane image really focuses, as far as the track can say."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ullage.data import Frames
from ullage.grids import Image
from ullage.processing.backprojection import oversampled, oversampling
from ullage.processing.baseband import to_baseband
from ullage.processing.sar import frame_weights

Floats = NDArray[np.float64]
_REACH_M = 2.5  # heights tried, either way [m]
_TURN_RAD = np.radians(2.0)  # between places tried
_ASIDE_M = np.linspace(-0.2, 0.2, 5)  # around each of them, along the track and in range [m]
_FLAT_DB = 1.0  # a point that loses less at all other heights has no known height
_POINTS, _APART_M, _LEAST_DB = 5, 0.5, -12.0  # strongest points that are tried, how far apart, how far below the peak


@dataclass(frozen=True, slots=True)
class FocusHeight:
    """Where a point of an image is sharpest, among the places of the same range."""

    point_m: Floats  # (3) in the plane [m]
    best_m: Floats  # (3) place of the best focus [m]
    gain_db: float  # amplitude gained there over the plane [dB]
    resolved: bool  # False: the track is too straight to tell heights apart


def focus_height(frames: Frames, image: Image) -> list[FocusHeight]:
    """Search the best focus of an image's strongest steady points over heights at constant range.

    On a straight track all places on a circle around it give the same echoes, so no height is better than another:
    `resolved` is then False.

    Args:
        frames: of the sensor that made the image, without its own echo.
        image: a plane with coherence.
    """
    profiles = _Profiles.of(frames)
    return [_best_height(profiles, point) for point in _strongest(image)]


def _strongest(image: Image) -> list[Floats]:
    """The strongest points (3) of an image, weighted by their coherence, each some way from the others."""
    strength = image.amplitude * np.sqrt(np.ones(image.grid.shape) if image.coherence is None else image.coherence)
    x, y = np.meshgrid(image.grid.x_m, image.grid.y_m)
    least, out = float(strength.max()) * 10 ** (_LEAST_DB / 20), list[Floats]()
    while len(out) < _POINTS and strength.max() > max(least, 0.0):
        row, column = np.unravel_index(int(np.argmax(strength)), strength.shape)
        out.append(np.array([x[row, column], y[row, column], image.grid.origin_m[2]]))
        strength = np.where(np.hypot(x - x[row, column], y - y[row, column]) < _APART_M, 0.0, strength)
    return out


def _best_height(profiles: _Profiles, point: Floats) -> FocusHeight:
    places, turn = _circle(profiles.path, point)
    level_db = 20 * np.log10(np.maximum(profiles.amplitude(places.reshape(-1, 3)), 1e-30)).reshape(len(turn), -1)
    best, here = level_db.max(axis=1), int(np.argmin(np.abs(turn)))
    top = int(np.argmax(best))
    other = np.linalg.norm(places[:, 0] - places[top, 0], axis=1) > _REACH_M / 5
    falls_db = float(best[top] - np.median(best[other])) if other.any() else 0.0
    place = places[top, int(np.argmax(level_db[top]))]
    return FocusHeight(point, place, float(best[top] - best[here]), falls_db > _FLAT_DB)


def _circle(path: Floats, point: Floats) -> tuple[Floats, Floats]:
    """Places (t, a, 3) on the circle around the track through a point, with some around each; their turn (t) [rad]."""
    middle = path.mean(axis=0)
    axis = np.linalg.svd(path - middle, full_matrices=False)[2][0]
    foot = middle + axis * ((point - middle) @ axis)
    radius = max(float(np.linalg.norm(point - foot)), 1e-6)
    out = (point - foot) / radius
    turn = np.arange(-np.pi, np.pi, _TURN_RAD)
    away = np.cos(turn)[:, None] * out + np.sin(turn)[:, None] * np.cross(axis, out)
    near = np.abs(foot[2] + radius * away[:, 2] - point[2]) <= _REACH_M
    near &= away[:, :2] @ out[:2] >= 0  # on the same side of the track
    away, turn = away[near], turn[near]
    along, outward = (a.reshape(-1, 1) for a in np.meshgrid(_ASIDE_M, 0.5 * _ASIDE_M))
    centre = foot + radius * away
    return centre[:, None] + along * axis + outward * away[:, None], turn


@dataclass(frozen=True, slots=True)
class _Profiles:
    """Profiles ready for coherent sums at single places."""

    fine: NDArray[np.complex64]  # (n, f)
    path: Floats  # (n, 3)
    weights: Floats  # (n)
    start_m: float
    per_m: float
    wave: float  # 4 pi over the wavelength [rad/m]

    @classmethod
    def of(cls, frames: Frames) -> _Profiles:
        bin_m = float(np.diff(frames.range_m).mean())
        factor = oversampling(frames.spec, bin_m)
        fine = oversampled(to_baseband(frames), factor)
        path, wave = frames.believed.position, 4 * np.pi / frames.spec.wavelength_m
        return cls(fine, path, frame_weights(frames), float(frames.range_m[0]), factor / bin_m, wave)

    def amplitude(self, places: Floats) -> Floats:
        """The coherent sum (m) at places (m, 3), each frame weighted by the distance moved."""
        total = np.zeros(len(places), np.complex128)
        for row, position, weight in zip(self.fine, self.path, self.weights, strict=True):
            distance = np.linalg.norm(places - position, axis=1)
            at = (distance - self.start_m) * self.per_m
            k = np.clip(at.astype(int), 0, len(row) - 2)
            value = row[k] + (at - k) * (row[k + 1] - row[k])
            inside = (at >= 0) & (at < len(row) - 1)
            total += weight * inside * value * np.exp(1j * self.wave * distance)
        return np.asarray(np.abs(total))
