"""What every mapper checks before it takes frames in."""

from __future__ import annotations

import warnings

import numpy as np

from ullage import checks
from ullage.data import Frames, Recording, sensors_of
from ullage.errors import InputError, UllageWarning
from ullage.grids import Grid

MOST_RADIUS_M = 10.0
JUMP_M = 0.5
JUMP_SPEED_M_S = 20.0


def in_order(frames: Recording, grid: Grid) -> list[Frames]:
    """The frames of each sensor, checked: finite samples, poses, a flight inside the grid.

    Sensors come by how far they look from straight ahead, then by name: a map never hangs on the order of a dict.

    Raises:
        InputError: naming sensor and frame.
    """
    parts = sorted(sensors_of(frames), key=from_ahead)
    for part in parts:
        _refuse_bad_samples(part)
        _warn_of_jumps(part)
        _refuse_outside(part, grid)
    return parts


def from_ahead(frames: Frames) -> tuple[float, str]:
    """Return the order of a sensor: how far it looks from straight ahead, then its name."""
    ahead = float(frames.spec.mount.body_from_sensor()[0, 0])  # cosine of the angle from the body's x axis
    return -round(ahead, 6), frames.sensor


def _refuse_bad_samples(frames: Frames) -> None:
    total = np.sum(frames.samples, axis=1)
    for index in np.flatnonzero(~np.isfinite(total)):
        if not np.isfinite(frames.samples[index]).all():
            raise InputError(f"frame {index} has a sample that is not finite", where=frames.sensor)


def jumps(frames: Frames) -> np.ndarray:
    """Index of the first frame after each jump of the poses: over 0.5 m at over 20 m/s."""
    path = frames.believed
    if len(path) < 2:
        return np.zeros(0, np.int64)
    gap = np.linalg.norm(np.diff(path.position, axis=0), axis=1)
    speed = gap / np.maximum(np.diff(path.t_ns) * 1e-9, 1e-9)
    return np.flatnonzero((gap > JUMP_M) & (speed > JUMP_SPEED_M_S)) + 1


def _warn_of_jumps(frames: Frames) -> None:
    where = jumps(frames)
    if len(where):
        warnings.warn(
            f"{frames.sensor}: the poses jump {len(where)} times, first at frame {where[0]}; "
            "frames on both sides are mapped, but never joined",
            UllageWarning,
            stacklevel=4,
        )


def _refuse_outside(frames: Frames, grid: Grid) -> None:
    _, inside = grid.index(frames.believed.position)
    if not inside.all():
        first = int(np.flatnonzero(~inside)[0])
        x, y, z = frames.believed.position[first]
        left, right, bottom, top = grid.extent_m
        tall = "" if grid.dims == 2 else f", z {grid.z_m[0]:.1f}..{grid.z_m[-1]:.1f}"
        raise InputError(
            f"the grid does not hold the flight: frame {first} at ({x:.2f}, {y:.2f}, {z:.2f}) m",
            where=frames.sensor,
            allowed=f"x {left:.1f}..{right:.1f}, y {bottom:.1f}..{top:.1f}{tall} m; a larger grid",
        )


def plane_of(grid: Grid, parts: list[Frames]) -> Grid:
    """The grid at the sensors' mean height, where it has none."""
    return grid.at_height(float(np.mean(np.concatenate([p.believed.position[:, 2] for p in parts]))))


def radius_of_vehicle(radius_m: float) -> float:
    """The radius of the ball about the antenna that the vehicle fills [m].

    Raises:
        InputError: it is not a positive number, or too large.
    """
    limits = f"above 0, at most {MOST_RADIUS_M:g} m"
    if checks.number("vehicle_radius_m", radius_m, "mapper", above=0.0, allowed=limits) > MOST_RADIUS_M:
        raise InputError(f"vehicle_radius_m is {radius_m}", where="mapper", allowed=limits)
    return radius_m
