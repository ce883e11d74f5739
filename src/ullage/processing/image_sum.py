"""A SAR image that grows as frames come: one sum for each sensor, readable at any time."""

from __future__ import annotations

from typing import Any, Literal, Self

import numpy as np
from numpy.typing import NDArray

from ullage.arrays import Floats
from ullage.data import Frames
from ullage.grids import Grid, Image
from ullage.processing.backprojection import Backprojector
from ullage.processing.sar import focus


class ImageSum:
    """Sums frames into one image: sensors add in power (back-projection) or in amplitude (summation).

    Frames weigh by the distance that the sensor moved, so that standing still adds nothing. A frame costs the same
    however long the flight, and memory is the grid's.

    Args:
        grid: where to focus.
        method: how.
    """

    def __init__(self, grid: Grid, method: Literal["backprojection", "summation"]) -> None:
        self.grid, self.method = grid, method
        self._sums: dict[str, Backprojector] = {}
        self._amplitudes: dict[str, NDArray[Any]] = {}
        self._last_m: dict[str, Floats] = {}

    def add(self, name: str, part: Frames) -> None:
        """Add frames of one sensor."""
        if self.method == "summation":
            image = focus(part, self.grid, method="summation", remove_own_echo=False)
            self.grid = image.grid
            before = self._amplitudes.get(name)
            self._amplitudes[name] = image.values if before is None else before + image.values
            return
        position = part.believed.position
        before_m = self._last_m.get(name, position[0])
        self._last_m[name] = position[-1]
        moved = np.linalg.norm(np.diff(np.vstack([before_m, position]), axis=0), axis=1)
        summing = self._sums.setdefault(name, Backprojector(self.grid))
        summing.update(part, weights=np.minimum(moved, part.spec.wavelength_m / 2))

    def take_over(self, name: str, other: Self) -> None:
        """Replace the sum of one sensor by a copy of another's."""
        if name in other._amplitudes:
            self._amplitudes[name], self.grid = other._amplitudes[name], other.grid
        if name in other._sums:
            self._sums[name] = other._sums[name].copy()
            self._last_m[name] = other._last_m[name]

    def begin(self, name: str, position_m: Floats) -> None:
        """Set the place of a sensor (3) before its first frames, so that these have weights by distance from it."""
        self._last_m[name] = position_m

    def merge(self, name: str, other: Self) -> None:
        """Add another's sum of one sensor, of frames after those here."""
        if name in other._amplitudes:
            self._amplitudes[name] = self._amplitudes[name] + other._amplitudes[name]
        if name in other._sums:
            self._sums[name].merge(other._sums[name])
            self._last_m[name] = other._last_m[name]

    def image(self) -> Image | None:
        """Return the image so far; None: no frames came."""
        if self._amplitudes:
            return Image(self.grid, np.sum(list(self._amplitudes.values()), axis=0), None, "summation")
        images = [summing.image() for summing in self._sums.values()]
        if len(images) < 2:
            return images[0] if images else None
        power = np.sqrt(np.sum([np.abs(i.values) ** 2 for i in images], axis=0)).astype(np.float32)
        coherence = np.max([summing.coherence for summing in self._sums.values()], axis=0)
        return Image(images[0].grid, power, coherence, "backprojection")
