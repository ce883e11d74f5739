"""Why a map has no occupied cell, in one sentence."""

from __future__ import annotations

import numpy as np

from ullage.arrays import Bools, Floats
from ullage.data import Frames, Recording, sensors_of
from ullage.geometry import quat_matrix
from ullage.grids import Grid
from ullage.processing.baseband import envelope
from ullage.processing.echoes import blind_m, echo_level

CLEAR = 2.0
"""Amplitude of a clear echo over the level of any echo, which noise passes in some frames."""
FEW = 0.05
"""Share of the frames in which noise may look like a clear echo."""
LEAST_MOTION_M = 0.05
"""A radar that moves less sees all from one place."""
CARRIED = 0.2
"""Share of the motion ahead by which the range of an echo changes at most, where the radar carries its object."""


def why_empty(received: Recording, cleaned: Recording, grid: Grid) -> str:
    """Return the first reason that holds for every radar.

    Args:
        received: the frames.
        cleaned: the same without the radars' own echoes.
        grid: of the map.
    """
    before, after = sensors_of(received), sensors_of(cleaned)
    if not any(_strongest(part)[1].mean() > FEW for part in before):
        levels = [
            f"{part.sensor}: {part.amplitude.max():.3g}, level {np.median(echo_level(part)):.3g}" for part in before
        ]
        return f"no echo stands out of the noise (strongest of {'; '.join(levels)})"
    if not any(_strongest(part)[1].mean() > FEW for part in after):
        return "all echoes move with the radar and were removed as its own; remove_own_echo=False keeps them"
    if all(np.ptp(part.believed.position, axis=0).max() < LEAST_MOTION_M for part in after):
        return f"no radar moves {LEAST_MOTION_M:g} m, so no echo is seen from two places"
    if all(text := [_carried(part) for part in after]):
        return text[0]
    if not any(_inside(part, grid) for part in after):
        return "all echoes lie outside the grid, seen straight ahead; a larger grid holds them"
    return "no echo stays at one place as the radar moves; check poses, times and the range axis"


def _strongest(part: Frames) -> tuple[Floats, Bools]:
    """Range of the strongest echo of each frame (n) [m], and whether it is clear (n)."""
    values = np.where(part.range_m >= blind_m(part), envelope(part), 0.0)
    return part.range_m[values.argmax(axis=1)], values.max(axis=1) > CLEAR * echo_level(part)


def _carried(part: Frames) -> str:
    """The reason where the strongest echo keeps its range while the radar moves straight ahead; else nothing."""
    reach, found = _strongest(part)
    path = part.believed
    ahead = quat_matrix(path.quat_xyzw)[:, :, 0]
    moved = float(np.abs(np.einsum("ni,ni->n", np.diff(path.position, axis=0), ahead[1:])).sum())
    kept = reach[found]
    if not len(kept) or moved < LEAST_MOTION_M or float(np.subtract(*np.percentile(kept, (95, 5)))) > CARRIED * moved:
        return ""
    return (
        f"the strongest echo stays at {np.median(kept):.2f} m while the radar moves {moved:.1f} m the way it looks; it "
        "belongs to the vehicle, or the poses are not world_from_radar with x along the boresight"
    )


def _inside(part: Frames, grid: Grid) -> bool:
    """Whether an echo straight ahead lies in the grid."""
    reach, found = _strongest(part)
    path = part.believed
    places = path.position + reach[:, None] * quat_matrix(path.quat_xyzw)[:, :, 0]
    return bool((grid.index(places)[1] & found).any())
