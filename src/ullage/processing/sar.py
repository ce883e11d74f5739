"""SAR images from frames: the thesis' summation and coherent back-projection, behind one call."""

from __future__ import annotations

from itertools import pairwise
from typing import Any, Literal, get_args

import numpy as np

from ullage import checks
from ullage.arrays import Floats
from ullage.data import Frames, Recording, sensors_of
from ullage.errors import InputError
from ullage.grids import Grid, Image
from ullage.processing.backprojection import MOST_THREADS, Backprojector
from ullage.processing.own_echo import without_own_echo
from ullage.processing.summation import summed

Window = Literal["path", "none", "hann", "taylor"]
Combine = Literal["incoherent", "coherent"]


def focus(
    frames: Recording,
    grid: Grid,
    *,
    method: Literal["backprojection", "summation"] = "backprojection",
    window: Window = "path",
    antenna: bool = True,
    combine: Combine = "incoherent",
    subaperture_m: float | None = None,
    threads: int = 0,
    remove_own_echo: bool = True,
) -> Image:
    """Focus an image from the frames of one or several sensors and their estimated poses.

    Args:
        frames: one sensor's frames, or several by name or in a row.
        grid: of the image; a plane without a height takes the sensors' mean height.
        method: "backprojection" sums echoes in phase over the true distances to each cell; "summation" is the
            thesis' sum of amplitudes straight ahead.
        window: weight of each frame along the track: "path" by the distance moved, so that standing still adds
            nothing; "none" all alike; "hann" and "taylor" (-35 dB) lower the side lobes of one straight pass.
        antenna: weigh cells with the two-way antenna pattern.
        combine: whether several sensors are added in phase; in power otherwise.
        subaperture_m: length of track that is summed in phase [m]; the images of such pieces are added in power, each
            by its share of the path. The image is coarser, but objects seen from a part of the path stay visible,
            and slow errors of the poses blur no more than a piece. None: the whole path.
        threads: 0 takes every core.
        remove_own_echo: subtract the radar's own echo first (`processing.own_echo`).

    Raises:
        InputError: unknown method, no poses, no phase, a sample that is not finite, a grid too large for memory, or
            sensors of different frequency to be added in phase.
    """
    _check_choices(window, combine, threads)
    checks.instance("grid", grid, Grid, "focus")
    parts = without_own_echo(frames) if remove_own_echo else sensors_of(frames)
    if method == "summation":
        return summed(parts, grid)
    if method != "backprojection":
        raise InputError(f"no method {method!r}", where="focus", allowed="backprojection, summation")
    grid = grid.at_height(float(np.concatenate([p.believed.position[:, 2] for p in parts]).mean()))
    settings: dict[str, Any] = {"window": window, "antenna": antenna, "threads": threads}
    if combine == "coherent" or len(parts) == 1:
        if subaperture_m is not None and len(parts) > 1:
            raise InputError(
                "pieces of track of several sensors in phase", where="subaperture_m", allowed='combine="incoherent"'
            )
        return (
            _in_phase(parts, grid, **settings).image()
            if subaperture_m is None
            else _piecewise(parts[0], grid, subaperture_m, **settings)
        )
    images = [focus(part, grid, subaperture_m=subaperture_m, remove_own_echo=False, **settings) for part in parts]
    power = np.sqrt(np.sum([np.abs(i.values) ** 2 for i in images], axis=0))
    coherence = np.max([i.coherence for i in images if i.coherence is not None], axis=0)
    return Image(grid, power.astype(np.float32), coherence, "backprojection")


def _check_choices(window: str, combine: str = "incoherent", threads: int = 0) -> None:
    if window not in get_args(Window):
        raise InputError(f"no window {window!r}", where="focus", allowed=", ".join(get_args(Window)))
    if combine not in get_args(Combine):
        raise InputError(f"combine is {combine!r}", where="focus", allowed=", ".join(get_args(Combine)))
    checks.whole("threads", threads, "focus", low=0, high=MOST_THREADS)


def _in_phase(parts: list[Frames], grid: Grid, *, window: Window, antenna: bool, threads: int) -> Backprojector:
    """One coherent image of all frames."""
    image = Backprojector(grid, antenna=antenna, threads=threads)
    for part in parts:
        image.update(part, weights=frame_weights(part, window))
    return image


def _piecewise(frames: Frames, grid: Grid, length_m: float, **settings: Any) -> Image:
    """The power of coherent images of pieces of the track, each by its share of the frames' weight."""
    pieces = subapertures(frames, length_m)
    share = np.array([frame_weights(frames)[piece].sum() for piece in pieces])
    power, coherence = np.zeros(grid.shape), np.zeros(grid.shape, np.float32)
    for piece, part in zip(pieces, share / share.sum(), strict=True):
        image = _in_phase([frames[piece]], grid, **settings)
        power += part * np.abs(image.values) ** 2
        coherence = np.maximum(coherence, image.coherence)
    return Image(grid, np.sqrt(power).astype(np.float32), coherence, "backprojection")


def subapertures(frames: Frames, length_m: float) -> list[slice]:
    """Cut the frames into pieces of equal path length, close to a given length.

    Raises:
        InputError: the length is not above zero.
    """
    checks.number("subaperture_m", length_m, "focus", above=0.0, allowed="> 0")
    step = np.linalg.norm(np.diff(frames.believed.position, axis=0), axis=1)
    travelled = np.concatenate([[0.0], np.cumsum(step)])
    count = max(1, round(float(travelled[-1]) / length_m))
    cuts = np.searchsorted(travelled, travelled[-1] * np.arange(1, count) / count)
    edges = np.unique([0, *cuts.tolist(), len(frames)])
    return [slice(int(a), int(b)) for a, b in pairwise(edges)]


def frame_weights(frames: Frames, window: Window = "path") -> Floats:
    """Weight of each frame (n) along its track.

    Raises:
        InputError: unknown window.
    """
    _check_choices(window)
    position = frames.believed.position
    if window == "none" or len(frames) < 3:
        return np.ones(len(frames))
    step = np.linalg.norm(np.diff(position, axis=0), axis=1)
    moved = np.minimum((np.append(step, step[-1]) + np.insert(step, 0, step[0])) / 2, frames.spec.wavelength_m / 2)
    if moved.sum() < 1e-6:
        return np.ones(len(frames))
    moved = moved * len(moved) / moved.sum()
    if window == "path":
        return np.asarray(moved)
    from scipy.signal.windows import hann, taylor

    shape = hann(1001) if window == "hann" else taylor(1001, nbar=5, sll=35)
    centred = position - position.mean(0)
    along = centred @ np.linalg.svd(centred, full_matrices=False)[2][0]
    place = (along - along.min()) / max(float(np.ptp(along)), 1e-9)
    return np.asarray(moved * np.interp(place, np.linspace(0, 1, 1001), shape))
