"""Measure the sharpness of an image: widths, side lobes, place."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from ullage.arrays import Floats
from ullage.data import Metric
from ullage.errors import InputError
from ullage.grids import Image


def image_quality(image: Image, *, target_m: ArrayLike | None = None, search_m: float = 0.5) -> dict[str, Metric]:
    """Widths, side lobes and contrast of the brightest point, along the grid's axes.

    Args:
        image: any image of two dimensions or the brightest slice of three.
        target_m: true place (3) [m]; the brightest point within `search_m` of it is measured, and its error.
        search_m: radius of the search around the target [m].

    Returns:
        width_x_3db, width_y_3db, width_x_6db, width_y_6db [m]; pslr and islr of the cut along x and y [dB];
        entropy [nat]; contrast [dB]; error [m] where a target is given, horizontal.

    Raises:
        InputError: no cell lies near the target, or the image is dark.
    """
    amplitude = np.asarray(image.amplitude, np.float64)
    if image.grid.dims == 3:
        amplitude = amplitude[int(np.argmax(amplitude.reshape(len(amplitude), -1).max(1)))]
    power = amplitude**2
    if not power.sum() > 0:
        raise InputError("the image is dark", where="image_quality")
    x, y = image.grid.x_m, image.grid.y_m
    near = np.ones_like(power, bool)
    if target_m is not None:
        place = np.asarray(target_m, float)
        near = np.hypot(x[None, :] - place[0], y[:, None] - place[1]) <= search_m
        if not near.any():
            raise InputError(f"no cell within {search_m} m of {place.tolist()}", where="image_quality")
    row, col = np.unravel_index(int(np.argmax(np.where(near, power, -1))), power.shape)
    out = {}
    for axis, at, cut, top in (("x", x, power[row], int(col)), ("y", y, power[:, col], int(row))):
        for drop in (3.0, 6.0):
            out[f"width_{axis}_{drop:.0f}db"] = Metric(f"width_{axis}_{drop:.0f}db", _width(at, cut, top, drop), "m")
        pslr, islr = _side_lobes(cut, top)
        out[f"pslr_{axis}"], out[f"islr_{axis}"] = (
            Metric(f"pslr_{axis}", pslr, "dB"),
            Metric(f"islr_{axis}", islr, "dB"),
        )
    share = power[power > 0] / power.sum()
    out["entropy"] = Metric("entropy", float(-(share * np.log(share)).sum()), "nat")
    out["contrast"] = Metric("contrast", float(10 * np.log10(power.max() / np.median(power[power > 0]))), "dB")
    if target_m is not None:
        error = float(np.hypot(_peak(x, power[row], int(col)) - place[0], _peak(y, power[:, col], int(row)) - place[1]))
        out["error"] = Metric("error", error, "m")
    return out


def _peak(at: Floats, cut: Floats, top: int) -> float:
    """The top of the parabola through the brightest cell and its neighbours."""
    if not 0 < top < len(cut) - 1:
        return float(at[top])
    a, b, c = np.sqrt(cut[top - 1 : top + 2])
    bend = a - 2 * b + c
    return float(at[top] + (0.5 * (a - c) / bend if bend < 0 else 0.0) * (at[1] - at[0]))


def _width(at: Floats, cut: Floats, top: int, drop_db: float) -> float:
    """Full width where the power has fallen by `drop_db`; NaN where the image ends before."""
    level = cut[top] * 10 ** (-drop_db / 10)
    ends = []
    for side in (cut[top:], cut[top::-1]):
        low = np.flatnonzero(side < level)
        if not len(low):
            return float("nan")
        k = int(low[0])
        ends.append(k - 1 + (side[k - 1] - level) / (side[k - 1] - side[k]))
    return float(sum(ends) * (at[1] - at[0]))


def _side_lobes(cut: Floats, top: int) -> tuple[float, float]:
    """Strongest side lobe and all side lobes together over the main lobe [dB]; the main lobe ends at its nulls."""
    right, left = top, top
    while right + 1 < len(cut) and cut[right + 1] <= cut[right]:
        right += 1
    while left > 0 and cut[left - 1] <= cut[left]:
        left -= 1
    rest = np.concatenate([cut[:left], cut[right + 1 :]])
    if not len(rest) or not rest.max() > 0:
        return float("-inf"), float("-inf")
    main = float(cut[left : right + 1].sum())
    return float(10 * np.log10(rest.max() / cut[top])), float(10 * np.log10(rest.sum() / main))
