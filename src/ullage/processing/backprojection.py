"""Time-domain back-projection over any path, frame by frame, onto a plane or a volume."""

from __future__ import annotations

import math
import os
from concurrent.futures import ThreadPoolExecutor
from copy import copy
from dataclasses import dataclass
from itertools import pairwise
from typing import Self

import numpy as np
from numpy.typing import NDArray

from ullage import checks
from ullage.arrays import Floats, Singles
from ullage.data import Frames
from ullage.errors import InputError
from ullage.geometry import C0, quat_matrix
from ullage.grids import Grid, Image
from ullage.kernels.backprojection import Pattern, Profiles, Rows, Track, backproject_rows
from ullage.processing.baseband import checked, to_baseband
from ullage.specs import AntennaSpec, RadarSpec

MOST_THREADS = 1024
_SPAN = 1 / (1 - math.sqrt(0.5))  # (1 - q / span)^2 is one half at q = 1, the -3 dB opening


@dataclass(frozen=True, slots=True)
class Beam:
    """The two-way amplitude (1 - q / span)^2 with q = (v_y / sin half azimuth)^2 + (v_z / sin half elevation)^2."""

    inv_y2: float
    inv_z2: float
    min_weight: float

    @classmethod
    def of(cls, antenna: AntennaSpec, *, weighted: bool, min_weight: float) -> Beam:
        """The beam of an antenna; `weighted` False or an isotropic antenna: the same everywhere."""
        if not weighted or antenna.kind == "isotropic":
            return cls(0.0, 0.0, 0.0)
        half = np.radians(np.minimum([antenna.azimuth_deg, antenna.elevation_deg], 180.0)) / 2
        y, z = 1 / np.sin(half) ** 2
        return cls(float(y), float(z), min_weight)

    def weight(self, direction: Floats) -> Floats:
        """Two-way amplitude for unit vectors (n, 3) in the sensor's frame."""
        if self.inv_y2 == 0:
            return np.ones(len(direction))
        q = direction[:, 1] ** 2 * self.inv_y2 + direction[:, 2] ** 2 * self.inv_z2
        w = np.where((direction[:, 0] > 0) & (q < _SPAN), (1 - q / _SPAN) ** 2, 0.0)
        return np.where(w >= self.min_weight, w, 0.0)


def oversampled(samples: NDArray[np.complex64], factor: int, *, reach: int = 6) -> NDArray[np.complex64]:
    """Band-limited samples (n, b) on a grid `factor` times finer, (n, (b - 1) factor + 1); Kaiser-windowed sinc."""
    if factor == 1:
        return samples
    lag = np.arange(1 - reach, reach + 1)[:, None] - np.arange(factor)[None, :] / factor
    kernel = np.sinc(lag) * np.i0(7.0 * np.sqrt(np.clip(1 - (lag / reach) ** 2, 0, 1))) / np.i0(7.0)
    padded = np.pad(samples, ((0, 0), (reach - 1, reach)))
    windows = np.lib.stride_tricks.sliding_window_view(padded, 2 * reach, axis=1)
    fine = windows @ (kernel / kernel.sum(0)).astype(np.float32)
    return np.ascontiguousarray(fine.reshape(len(samples), -1)[:, : (samples.shape[1] - 1) * factor + 1])


def oversampling(spec: RadarSpec, bin_m: float) -> int:
    """Return the upsampling of the profile that keeps the error of linear interpolation below -50 dB."""
    return max(1, math.ceil(bin_m / (C0 / (2 * spec.bandwidth_hz) / 16) - 1e-6))


class Backprojector:
    """Add frames to an image as they come; memory depends on the grid only, not on the length of the flight.

    Args:
        grid: of the image; a plane without a height takes that of the first frames' sensors.
        antenna: weigh each cell with the two-way pattern and leave cells out of the beam alone.
        min_weight: the pattern under which a cell is out of the beam.
        threads: 0 takes every core.

    Raises:
        InputError: the grid would not fit into memory, or no such number of threads.
    """

    def __init__(self, grid: Grid, *, antenna: bool = True, min_weight: float = 0.05, threads: int = 0) -> None:
        grid.check_memory(20, "the image")
        self.grid, self.antenna, self.min_weight = grid, antenna, min_weight
        self.threads = checks.whole("threads", threads, "focus", low=0, high=MOST_THREADS) or os.cpu_count() or 1
        self.frames = 0
        self._weight, self._wavelength_m = 0.0, 0.0
        self._sums = np.zeros((grid.size // grid.shape[-1], 5, grid.shape[-1]), np.float32)

    def update(self, frames: Frames, *, weights: Floats | None = None) -> None:
        """Adds frames, each with a weight (None: 1).

        Raises:
            InputError: the frames have no poses or phase, a sample is not finite, or their carrier is another than
                that of frames before: their phases have nothing in common.
        """
        path, spec = frames.believed, frames.spec
        if abs(spec.wavelength_m - (self._wavelength_m or spec.wavelength_m)) > 1e-6 * spec.wavelength_m:
            before, now = (C0 / w / 1e9 for w in (self._wavelength_m, spec.wavelength_m))
            raise InputError(
                f"a carrier of {now:.3f} GHz after one of {before:.3f} GHz",
                where=frames.sensor,
                allowed="one carrier in a sum in phase; several sensors in power",
            )
        self._wavelength_m = spec.wavelength_m
        self.grid = self.grid.at_height(float(path.position[:, 2].mean()))
        bin_m = float(np.diff(frames.range_m).mean())
        factor = oversampling(spec, bin_m)
        given = np.ones(len(frames)) if weights is None else np.ascontiguousarray(weights, np.float64)
        beam = Beam.of(spec.antenna, weighted=self.antenna, min_weight=self.min_weight)
        rotation = quat_matrix(path.quat_xyzw)
        per_m = factor / bin_m
        axis = np.float32(per_m), np.float32(float(frames.range_m[0]) * per_m), np.float32(2 / spec.wavelength_m)
        for start in range(0, len(frames), 256):
            part = slice(start, start + 256)
            fine = oversampled(to_baseband(checked(frames[part])), factor)
            profiles = Profiles(np.ascontiguousarray(fine.real), np.ascontiguousarray(fine.imag), *axis)
            self._add(profiles, Track(path.position[part], rotation[part], given[part].astype(np.float32)), beam)
        self.frames += len(frames)
        self._weight += float(given.sum())

    def merge(self, other: Self) -> None:
        """Add the sum of other frames over the same grid."""
        self._sums += other._sums
        self.frames += other.frames
        self._weight += other._weight

    def copy(self) -> Self:
        """Copy the sum, to continue independently."""
        other = copy(self)
        other._sums = self._sums.copy()
        return other

    def _add(self, profiles: Profiles, track: Track, beam: Beam) -> None:
        z, y = (a.ravel() for a in np.meshgrid(self.grid.z_m, self.grid.y_m, indexing="ij"))
        x0, step = float(self.grid.x_m[0]), float(self.grid.step_m)
        pattern = Pattern(*map(np.float32, (beam.inv_y2 / _SPAN, beam.inv_z2 / _SPAN, beam.min_weight)))

        def add(part: slice) -> None:
            backproject_rows(Rows(y[part], z[part], x0, step), profiles, track, pattern, self._sums[part])

        cuts = np.linspace(0, len(y), min(self.threads, len(y)) + 1).astype(int)
        parts = [slice(int(a), int(b)) for a, b in pairwise(cuts)]
        if len(parts) == 1:
            add(parts[0])
            return
        with ThreadPoolExecutor(len(parts)) as pool:
            list(pool.map(add, parts))

    @property
    def values(self) -> NDArray[np.complex64]:
        """Return the complex image so far: an echo of amplitude 1 on boresight in every frame has the value 1."""
        flat = (self._sums[:, 0] + 1j * self._sums[:, 1]) / np.float32(max(self._weight, 1e-30))
        return np.asarray(flat.reshape(self.grid.shape), np.complex64)

    @property
    def coherence(self) -> Singles:
        """|sum w s|^2 / (sum w  sum w |s|^2) of each cell: 1 when all echoes agree in phase and strength."""
        top = self._sums[:, 0] ** 2 + self._sums[:, 1] ** 2
        bottom = self._sums[:, 2] * self._sums[:, 3]
        out = np.divide(top, bottom, out=np.zeros_like(top), where=bottom > 0)
        return np.asarray(np.minimum(out, 1.0).reshape(self.grid.shape), np.float32)

    @property
    def looks(self) -> Singles:
        """Effective number of frames behind each cell, (sum w)^2 / sum w^2; looks x coherence ~ Exp(1) in noise."""
        top, bottom = self._sums[:, 3] ** 2, self._sums[:, 4]
        out = np.divide(top, bottom, out=np.zeros_like(top), where=bottom > 0)
        return np.asarray(out.reshape(self.grid.shape), np.float32)

    def image(self) -> Image:
        """Return the image so far with its coherence."""
        return Image(self.grid, self.values, self.coherence, "backprojection")
