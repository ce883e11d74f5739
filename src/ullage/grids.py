"""Grids in the world and what is laid out on them: images and occupancy maps.

Arrays on a grid are indexed [y, x] for a plane and [z, y, x] for a volume, rows from low y to high y.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ullage.errors import InputError

Floats = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class Grid:
    """Square cells on a horizontal plane, or cubes in a volume."""

    origin_m: tuple[
        float, float, float
    ]  # lower corner of the first cell [m]; z is the plane's height, NaN: the sensors' mean
    step_m: float  # edge of a cell [m]
    shape: tuple[int, ...]  # (ny, nx) or (nz, ny, nx)

    def __post_init__(self) -> None:
        if not (math.isfinite(self.step_m) and self.step_m > 0):
            raise InputError(f"step_m is {self.step_m}", where="Grid", allowed="> 0")
        if len(self.shape) not in (2, 3) or min(self.shape) < 1:
            raise InputError(f"shape is {self.shape}", where="Grid", allowed="(ny, nx) or (nz, ny, nx), each >= 1")
        if not all(map(math.isfinite, self.origin_m[: len(self.shape)])):
            raise InputError(f"origin_m is {self.origin_m}", where="Grid", allowed="finite numbers")

    @classmethod
    def covering(
        cls, bounds: ArrayLike, step_m: float, *, z_m: float | None = None, dims: int = 2, margin_m: float = 0.0
    ) -> Grid:
        """The smallest grid over a box, cell edges on multiples of the step.

        Args:
            bounds: (2, 3) lower and upper corner [m], as `Scene.bounds`.
            step_m: edge of a cell [m].
            z_m: height of the plane [m] (dims=2); None takes the sensors' mean height when the grid is used.
            dims: 2 for a plane, 3 for a volume.
            margin_m: room added on every side [m].

        Raises:
            InputError: the box is not finite or the step not above zero.
        """
        box = np.asarray(bounds, float)
        if box.shape != (2, 3) or not np.isfinite(box).all() or np.any(box[1] < box[0]):
            raise InputError(
                f"bounds are {box.tolist()}", where="Grid", allowed="(2, 3) finite, lower then upper corner"
            )
        if not (math.isfinite(step_m) and step_m > 0):
            raise InputError(f"step_m is {step_m}", where="Grid", allowed="> 0")
        low = np.floor((box[0] - margin_m) / step_m + 1e-9)
        high = np.maximum(np.ceil((box[1] + margin_m) / step_m - 1e-9), low + 1)
        nx, ny, nz = (int(k) for k in high - low)
        x, y, z = (float(k) for k in low * step_m)
        if dims == 3:
            return cls((x, y, z), step_m, (nz, ny, nx))
        return cls((x, y, math.nan if z_m is None else z_m), step_m, (ny, nx))

    @property
    def dims(self) -> int:
        """2 for a plane, 3 for a volume."""
        return len(self.shape)

    @property
    def size(self) -> int:
        """Number of cells."""
        return math.prod(self.shape)

    @property
    def x_m(self) -> Floats:
        """Cell centres along x (nx) [m]."""
        return self._axis(0)

    @property
    def y_m(self) -> Floats:
        """Cell centres along y (ny) [m]."""
        return self._axis(1)

    @property
    def z_m(self) -> Floats:
        """Cell centres along z (nz) [m]; the plane's own height for a plane."""
        return self._axis(2) if self.dims == 3 else np.array([self.origin_m[2]])

    def _axis(self, k: int) -> Floats:
        return np.asarray(self.origin_m[k] + self.step_m * (np.arange(self.shape[-1 - k]) + 0.5), np.float64)

    @property
    def extent_m(self) -> tuple[float, float, float, float]:
        """(left, right, bottom, top) of the x-y plane [m], as matplotlib's imshow wants it with origin="lower"."""
        ny, nx = self.shape[-2:]
        x, y = self.origin_m[:2]
        return x, x + nx * self.step_m, y, y + ny * self.step_m

    def at_height(self, z_m: float) -> Grid:
        """The same plane at a height [m], where none was set; a grid with a height stays as it is."""
        if self.dims == 3 or math.isfinite(self.origin_m[2]):
            return self
        return Grid((*self.origin_m[:2], z_m), self.step_m, self.shape)

    def index(self, points_m: ArrayLike) -> tuple[NDArray[np.int64], NDArray[np.bool_]]:
        """Cell of each point (n, 3): indices (n, dims) in array order, and whether the point lies on the grid (n)."""
        points = np.atleast_2d(np.asarray(points_m, float))[:, : self.dims]
        cell = np.floor((points - np.asarray(self.origin_m)[: self.dims]) / self.step_m).astype(np.int64)[:, ::-1]
        return cell, np.all((cell >= 0) & (cell < np.asarray(self.shape)), axis=1)


@dataclass(frozen=True, slots=True, eq=False)
class Image:
    """A SAR image: one value per cell of a grid."""

    grid: Grid
    values: NDArray[Any]  # grid.shape, complex64 (coherent) or float32 (summed amplitudes)
    coherence: NDArray[np.float32] | None = None  # grid.shape, 0..1
    method: str = ""

    def __post_init__(self) -> None:
        if self.values.shape != self.grid.shape:
            raise InputError(f"values have shape {self.values.shape}", where="Image", allowed=f"{self.grid.shape}")

    @property
    def amplitude(self) -> NDArray[np.float32]:
        """Magnitude of each cell."""
        return np.asarray(np.abs(self.values), np.float32)

    @property
    def peak_m(self) -> Floats:
        """Centre of the brightest cell (3) [m]."""
        cell = np.unravel_index(int(np.argmax(self.amplitude)), self.grid.shape)
        z = self.grid.z_m[cell[0] if self.grid.dims == 3 else 0]
        return np.array([self.grid.x_m[cell[-1]], self.grid.y_m[cell[-2]], z])


UNKNOWN, AMBIGUOUS = -1, -2


@dataclass(frozen=True, slots=True, eq=False)
class OccupancyMap:
    """What is known of each cell: 0..100 percent chance of being occupied, -1 unknown, -2 ambiguous.

    Ambiguous means: an echo came from an arc that holds this cell, and nothing yet says from which cell of it.
    """

    grid: Grid
    percent: NDArray[np.int8]  # grid.shape
    method: str = ""
    occupied_from: int = 65  # percent at and above which a cell counts as occupied
    free_to: int = 35  # percent at and below which it counts as free

    def __post_init__(self) -> None:
        if self.percent.shape != self.grid.shape or self.percent.dtype != np.int8:
            raise InputError(
                f"percent is {self.percent.dtype} {self.percent.shape}",
                where="OccupancyMap",
                allowed=f"int8 {self.grid.shape}",
            )

    @property
    def occupied(self) -> NDArray[np.bool_]:
        """Cells held to be occupied."""
        return np.asarray(self.percent >= self.occupied_from)

    @property
    def free(self) -> NDArray[np.bool_]:
        """Cells held to be free."""
        return np.asarray((self.percent >= 0) & (self.percent <= self.free_to))

    @property
    def unknown(self) -> NDArray[np.bool_]:
        """Cells of which nothing is known."""
        return np.asarray(self.percent == UNKNOWN)

    @property
    def ambiguous(self) -> NDArray[np.bool_]:
        """Cells on an arc that one look alone left open."""
        return np.asarray(self.percent == AMBIGUOUS)
