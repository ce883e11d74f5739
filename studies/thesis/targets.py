"""The thesis' four targets: the track past each, the radars, and the target's level in an image of the track."""

from __future__ import annotations

from typing import Any

import numpy as np

from studies.thesis.variants import alone
from ullage.arrays import Floats
from ullage.data import Frames, Trajectory
from ullage.grids import Grid, Image
from ullage.processing.sar import focus
from ullage.specs import RadarSpec
from ullage.world.library import WORLDS

TARGETS = {
    "ntnu-plate": ("steel_plate::plate", "facing plate"),
    "ntnu-plate45": ("steel_plate::plate", "plate at 45 deg"),
    "ntnu-pole": ("steel_pole::pole", "square pole"),
    "ntnu-wire": ("steel_wire::wire", "wire"),
}
"""World: the name of the steel in it, and what to call it."""
TAIL_M = 8.4
"""No straight path in the room is longer than this; what comes later has been reflected on the way [m]."""
IMAGE_BOX = np.array([[-1.5, -2.0, 1.1], [4.3, 2.0, 1.1]])
"""Where images are made: from beyond the direct path to the wall behind the targets [m]."""
CELL_M = 0.05
"""Cells of the images [m]."""
OWN_M = 0.3
"""Cells this near to a target are its own [m]."""


def strafe(world: str, *, step_m: float = 0.05) -> Trajectory:
    """Return the world's strafing track with one frame per `step_m`."""
    (x0, y0, z0, yaw), (x1, y1, z1, _) = WORLDS[world].path_xyzyaw
    return Trajectory.line((x0, y0, z0), (x1, y1, z1), 0.5, 0.5 / step_m, yaw_deg=yaw)


def radars() -> tuple[RadarSpec, RadarSpec]:
    """Return the front radar with and without noise, that of the ray law included."""
    loud = RadarSpec.preset("x4m05")
    return loud, loud.but(noise=None, thesis=loud.thesis.but(noise_sigma=0.0))


def decibel(value: Any) -> Any:
    """Return 20 log10 of an amplitude, at least -300 dB."""
    return 20 * np.log10(np.maximum(abs(np.asarray(value)), 1e-15))


def target_place(world: str) -> Floats:
    """Return the place of a target's steel (2) [m]: its near face, or the middle of a turned plate."""
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
    """Return the brightest cell near a target relative to the brightest of the image [dB]."""
    y, x = np.meshgrid(image.grid.y_m, image.grid.x_m, indexing="ij")
    near = np.hypot(x - target_m[0], y - target_m[1]) < OWN_M
    return float(decibel(image.amplitude[near].max() / image.amplitude.max()))
