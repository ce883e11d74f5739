"""Scatterers that stay coherent along a track, as places in the world and on maps.

A single profile hides a weak reflector in clutter. Along a track of many wavelengths its phase follows its range, and
nothing else does by chance. Only frames whose poses are known to match their phases can show this: those that
`ul.calibrate` has put on a track.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ullage.data import Frames
from ullage.grids import OccupancyMap
from ullage.processing.baseband import as_baseband
from ullage.processing.point_focus import PointFocus

Floats = NDArray[np.float64]

LEAST_GAIN = 60.0  # log-likelihood; the three best points of a flight with the track of another reach 58 each
CLEAR_M = 0.3  # around the sensor's path nothing stands
LEVEL_RAD = 0.1  # steepest straight track whose scatterers are moved to a chosen height


@dataclass(frozen=True, slots=True, eq=False)
class Scatterer:
    """A place that the radar received from coherently."""

    place: Floats  # (3) world [m]
    gain: float  # log-likelihood of a steady point over noise
    height_known: bool  # False: the track is straight, and the height was assumed


def find_scatterers(frames: Frames, *, z_m: float | None = None) -> list[Scatterer]:
    """Find the places that reflect coherently along a calibrated track, best first.

    A track that turns or climbs gives places in three dimensions. A straight one leaves a circle about the track; the
    place on it at height `z_m` in front of the antenna is given. Places behind the antenna are left out.

    Args:
        frames: with poses whose clock and range offset are right, and without the radar's own echo.
        z_m: height of scatterers seen from a straight track [m]; None: the height of the track.
    """
    frames = as_baseband(frames)  # keeps out noise beside the band
    focus = PointFocus(frames, frames.believed, 0.0)
    if len(focus.t_s) < 8:
        return []
    points = focus.drawn(focus.starts(0.0, 0.0), 0.0, 0.0)
    path, ahead = focus.path(0.0), _boresight(frames, focus.t_s)
    spread = np.linalg.svd(path - path.mean(0), compute_uv=False) / np.sqrt(len(path))
    straight = bool(spread[1] < focus.wave_m)
    out = []
    for index in focus.distinct(points, 0.0):
        point = points[index]
        place = _on_circle(point.place, path, ahead.mean(0), z_m) if straight else point.place
        if point.gain < LEAST_GAIN or place is None or not _in_front(place, point.amplitude, path, ahead):
            continue
        if np.linalg.norm(path - place, axis=1).min() > CLEAR_M:
            out.append(Scatterer(place, point.gain, not straight))
    return out


def with_scatterers(omap: OccupancyMap, found: Sequence[Scatterer], path: Floats) -> OccupancyMap:
    """Mark the cells of scatterers as occupied, and what the sensor flew through as free.

    A plane shows scatterers of every height, a volume those of known height.

    Args:
        omap: of the other echoes.
        found: the scatterers.
        path: (n, 3) positions of the sensor [m].
    """
    percent, dims = np.array(omap.percent), omap.grid.dims
    cells = np.argwhere(percent >= omap.occupied_from)
    centres = np.asarray(omap.grid.origin_m)[:dims] + (cells[:, ::-1] + 0.5) * omap.grid.step_m
    percent[tuple(cells[_distance(path[:, :dims], centres) <= CLEAR_M].T)] = 0
    shown = [one.place for one in found if dims == 2 or one.height_known]
    if shown:
        index, inside = omap.grid.index(np.array(shown))
        percent[tuple(index[inside].T)] = 100
    return OccupancyMap(omap.grid, percent, omap.method, omap.occupied_from, omap.free_to)


def _distance(path: Floats, places: Floats) -> Floats:
    from scipy.spatial import cKDTree

    return np.asarray(cKDTree(path).query(places)[0]) if len(places) else np.zeros(0)


def _boresight(frames: Frames, t_s: NDArray[np.floating]) -> Floats:
    """Direction of the antenna (n, 3) at these times [s]."""
    kept = np.searchsorted(frames.t_ns * 1e-9, t_s).clip(0, len(frames) - 1)
    return np.asarray(frames.believed.world_from_body[kept, :3, 0])


def _in_front(place: Floats, amplitude: Floats, path: Floats, ahead: Floats) -> bool:
    """Whether a place lies in the half space that the antenna faces, where it is received best."""
    direction = place - path
    cosine = (direction * ahead).sum(1) / np.maximum(np.linalg.norm(direction, axis=1), 1e-9)
    return bool((amplitude * cosine).sum() > 0)


def _on_circle(place: Floats, path: Floats, ahead: Floats, z_m: float | None) -> Floats | None:
    """The place at a height, in front of the antenna, that a straight level track cannot tell from this one.

    None where the circle about the track does not reach that height.
    """
    middle = path.mean(0)
    along = np.linalg.svd(path - middle, full_matrices=False)[2][0]
    across = np.array([-along[1], along[0], 0.0])
    if abs(along[2]) > LEVEL_RAD or not across @ ahead:
        return place
    foot = middle + along * ((place - middle) @ along)
    rise = (place[2] if z_m is None else z_m) - foot[2]
    wide = (place - foot) @ (place - foot) - rise**2
    if wide <= 0:
        return None
    side = across * np.sign(across @ ahead) / np.linalg.norm(across)
    return np.asarray(foot + side * np.sqrt(wide) + [0, 0, rise])
