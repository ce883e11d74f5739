"""Choose the plane or volume that a run images, and warn of targets off it."""

from __future__ import annotations

import warnings
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from ullage.arrays import Floats
from ullage.config import ImageSpec
from ullage.data import Frames
from ullage.errors import UllageWarning
from ullage.grids import Grid, Image
from ullage.processing.image_height import focus_height
from ullage.processing.own_echo import without_own_echo

_OFF_DB = 3.0  # a brightest point that focuses so much better elsewhere is warned of [dB]
_OFF_M, _ALIKE_M = 0.2, 0.5  # how far from the plane that is; spread of reflectors that share a plane [m]


@dataclass(frozen=True, slots=True)
class ImagePlane:
    """Place of an image and its reason."""

    grid: Grid
    reason: str

    @property
    def text(self) -> str:
        """Height or heights in words, for a figure or a report."""
        if self.grid.dims == 3:
            half = self.grid.step_m / 2
            low, high = self.grid.z_m[0] - half, self.grid.z_m[-1] + half
            return f"volume z = {low:.2f} .. {high:.2f} m ({self.reason}), brightest over height"
        return f"plane z = {self.grid.origin_m[2]:.2f} m ({self.reason})"


def image_plane(
    spec: ImageSpec, bounds: Floats, *, flight_m: float, marks: Floats | None = None, margin_m: float = 0.0
) -> ImagePlane:
    """Choose where to image: the scenario's plane or volume, else the surveyed reflectors' height, else the flight's.

    Args:
        spec: the settings.
        bounds: (2, 3) box to image [m].
        flight_m: height of the flight [m].
        marks: (m, 3) surveyed reflectors [m].
        margin_m: room added on every side of a plane [m].
    """
    if spec.volume is not None:
        wide = np.array([bounds[0], bounds[1]], float)
        wide[:, :2] += [[-margin_m], [margin_m]]
        wide[:, 2] = spec.volume
        return ImagePlane(Grid.covering(wide, spec.step_m, dims=3), "as set")
    height, reason = flight_m, "the flight's height"
    if spec.z_m is not None:
        height, reason = spec.z_m, "as set"
    elif marks is not None and len(marks) and np.ptp(marks[:, 2]) < _ALIKE_M:
        height, reason = float(np.median(marks[:, 2])), "through the surveyed reflectors"
    return ImagePlane(Grid.covering(bounds, spec.step_m, z_m=height, margin_m=margin_m), reason)


def plane_findings(image: Image, frames: Mapping[str, Frames], *, marks: Floats | None = None) -> str:
    """Warn of targets off the imaged plane; report what the track reveals about heights.

    Args:
        image: the image; a volume gives no report.
        frames: of every sensor of the image, by name.
        marks: (m, 3) surveyed reflectors [m].
    """
    if image.grid.dims == 3 or image.method != "backprojection" or not image.values.any():
        return ""
    plane_m = image.grid.origin_m[2]
    if marks is not None and len(marks):
        off = marks[np.abs(marks[:, 2] - plane_m) > _OFF_M]
        for x, y, z in off[:1]:
            _warn(f"the surveyed reflector at ({x:.2f}, {y:.2f}) is at z = {z:.2f} m", plane_m, f"image.z_m={z:.2f}")
    part = max(without_own_echo(frames), key=len)
    found = focus_height(part, image)
    if not found.resolved:
        return "heights not resolved: the track is straight; a target off the plane appears displaced"
    off_m = found.best_m[2] - plane_m
    if found.gain_db > _OFF_DB and abs(off_m) > _OFF_M:
        text = f"the brightest point focuses {found.gain_db:.1f} dB better at z = {found.best_m[2]:.1f} m"
        _warn(text, plane_m, "image.z_m or image.volume")
    return ""


def _warn(what: str, plane_m: float, remedy: str) -> None:
    warnings.warn(f"{what}, the image plane at {plane_m:.2f} m: targets are displaced or blurred "
                  f"(set {remedy})", UllageWarning, stacklevel=3)  # fmt: skip
