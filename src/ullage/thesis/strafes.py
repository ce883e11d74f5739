"""What the experiments on single targets share: where a target is, its image, and how bright it is there."""

from __future__ import annotations

from typing import Any

import numpy as np

from ullage.arrays import Floats
from ullage.data import Frames
from ullage.grids import Grid, Image
from ullage.processing.sar import focus
from ullage.thesis.laws import TARGETS, alone, decibel
from ullage.world.library import WORLDS

IMAGE_BOX = np.array([[-1.5, -2.0, 1.1], [4.3, 2.0, 1.1]])
"""Where images are made: from beyond the direct path to the wall behind the targets [m]."""
CELL_M = 0.05
"""Cells of the images [m]."""
OWN_M = 0.3
"""Cells this near to a target are its own [m]."""


def target_place(world: str) -> Floats:
    """Where the radar meets a target's steel (2) [m]: its near face, or the middle of a turned plate."""
    low, high = alone(WORLDS[world].scene(), TARGETS[world][0]).bounds
    return np.array([(low[0] + high[0]) / 2 if world == "ntnu-plate45" else low[0], (low[1] + high[1]) / 2])


def strafe_image(
    frames: Frames, *, method: Any = "summation", around: Floats = IMAGE_BOX, height_m: float = float(IMAGE_BOX[0, 2])
) -> Image:
    """Focus the frames of a strafe on a plane.

    Args:
        frames: one radar's.
        method: of imaging.
        around: box of the image (2, 3) [m].
        height_m: of the plane [m].
    """
    return focus(frames, Grid.covering(around, CELL_M, z_m=height_m), method=method)


def level_db(image: Image, target_m: Floats) -> float:
    """Return the brightest cell near a target over the brightest of the image [dB]."""
    y, x = np.meshgrid(image.grid.y_m, image.grid.x_m, indexing="ij")
    near = np.hypot(x - target_m[0], y - target_m[1]) < OWN_M
    return float(decibel(image.amplitude[near].max() / image.amplitude.max()))
