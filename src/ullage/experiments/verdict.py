"""Summarise a run in sentences and metrics, for readers who did not fly it.

`verdict` judges a run on a recording. `inspect` compares a map with each object of a known world: mapped, partly
mapped, missed; for metrics and reports only.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np
from scipy.spatial import cKDTree

from ullage.arrays import Floats
from ullage.data import Frames, Metric
from ullage.grids import OccupancyMap
from ullage.processing.metrics import cell_centres, on_map
from ullage.processing.scatterers import Scatterer
from ullage.processing.truth import surface_of
from ullage.world.raycast import Raycaster
from ullage.world.scene import Scene

CLEAR_M = 0.3  # something occupied this close to the flown path contradicts the flight
ON_MAP_M = 0.15  # a surveyed reflector this close to an occupied cell is on the map


def verdict(
    frames: Frames,
    omap: OccupancyMap | None,
    scatterers: Sequence[Scatterer],
    marks: Floats | None,
    *,
    settled: bool = False,
) -> tuple[list[str], list[Metric]]:
    """Describe the certainty of the offsets, coherent reflectors, and the map's agreement with known objects.

    Args:
        frames: calibrated, of one sensor.
        omap: the last map, if one was made.
        scatterers: found along the track.
        marks: (m, 3) surveyed reflectors [m].
        settled: whether these settled the offsets.
    """
    words, metrics = [_offsets(frames)], [Metric("scatterers", len(scatterers))]
    if frames.calibration is not None:
        speed_m_s = float(np.sqrt((frames.believed.rates[0] ** 2).sum(1).mean()))  # root mean square
        along_m = frames.calibration.t_sigma_s * speed_m_s
        range_m = frames.calibration.range_sigma_m
        metrics.append(Metric("offset_shift", float(np.hypot(along_m, range_m)), "m"))
        words.append(
            f"One standard deviation of the offsets moves what is mapped by {along_m:.3f} m along the track and by "
            f"{range_m:.3f} m in range."
        )
    if settled:
        words.append("The surveyed reflectors settled the offsets, so the map's agreement with them proves little.")
    words.append(_scatterers(scatterers))
    if omap is not None:
        words += _on_path(frames, omap, scatterers, metrics)
        dims, places = omap.grid.dims, _occupied(omap)
        for mark in marks if marks is not None else []:
            off = _least(mark[None, :dims], places)
            metrics.append(Metric("reflector_to_map", off, "m"))
            words.append(_reflector(mark, off))
    if (found := frames.calibration) is not None and found.scale_sigma:
        words.append(f"The echoes fit a track {found.scale:.2f} +- {found.scale_sigma:.2f} times as large as given.")
        if found.message:
            words.append(f"{found.message[0].upper()}{found.message[1:]}.")
    mount = frames.spec.mount
    words.append(
        f"The antenna is taken to point along the body's axis turned by yaw {mount.yaw_deg:g} deg and pitch "
        f"{mount.pitch_deg:g} deg; this was not measured. Another mounting goes in by ul.open(..., mount=)."
    )
    return words, metrics


def _on_path(frames: Frames, omap: OccupancyMap, scatterers: Sequence[Scatterer], metrics: list[Metric]) -> list[str]:
    """Describe how near occupied cells are to the flown path.

    A plane shows scatterers of every height, so those of known height count in three dimensions.
    """
    path, dims = frames.believed.position, omap.grid.dims
    known = np.array([one.place for one in scatterers if one.height_known]).reshape(-1, 3)
    index, inside = omap.grid.index(known)
    percent = np.array(omap.percent)
    percent[tuple(index[inside].T)] = 0
    rest = _occupied(OccupancyMap(omap.grid, percent, omap.method, omap.occupied_from, omap.free_to))
    near = min(_least(path[:, :dims], rest), _least(path, known))
    metrics.append(Metric("occupied_to_path", near, "m"))
    if near < CLEAR_M:
        return [
            f"Something is marked {near:.2f} m from the flown path, nearer than {CLEAR_M} m: the map is wrong there."
        ]
    return [f"The nearest occupied place is {near:.2f} m from the flown path." if np.isfinite(near)
            else "No cell is occupied."]  # fmt: skip


def _occupied(omap: OccupancyMap) -> Floats:
    """Centres of the occupied cells (k, dims) [m]."""
    return cell_centres(omap.grid, np.flatnonzero(omap.occupied))[:, : omap.grid.dims]


def _offsets(frames: Frames) -> str:
    found = frames.calibration
    if found is None:
        return "The frames were not calibrated against a track."
    others = [t for t, _, share in found.modes[1:] if share > 1e-3]
    rest = f"; other candidates: {', '.join(f'{t:+.2f} s' for t in others)}" if others else ""
    return (
        f"Clock offset {found.t_offset_s:+.3f} +- {found.t_sigma_s:.3f} s and range offset {found.range_offset_m:+.3f} "
        f"+- {found.range_sigma_m:.3f} m, with a probability of {100 * found.probability:.1f} %{rest}."
    )


def _scatterers(found: Sequence[Scatterer]) -> str:
    if not found:
        return "No place reflects coherently along the track: the map holds echoes of single profiles only."
    best = max(found, key=lambda one: one.gain)
    x, y, z = best.place
    height = "" if best.height_known else "; heights are assumed, since the track is straight"
    place = f"({x:.2f}, {y:.2f}, {z:.2f}) m"
    return (
        f"{len(found)} places reflect coherently along the track, the clearest at {place}{height}. Clutter alone would "
        f"give the faintest of them with a probability of {max(one.chance for one in found):.1g}."
    )


def _reflector(mark: Floats, off_m: float) -> str:
    place = f"The surveyed reflector at ({mark[0]:.2f}, {mark[1]:.2f}, {mark[2]:.2f}) m"
    if not np.isfinite(off_m):
        return f"{place} is not on the map."
    if off_m <= ON_MAP_M:
        return f"{place} is on the map: the nearest occupied cell is {off_m:.2f} m away."
    return f"{place} is not on the map at its survey: the nearest occupied cell is {off_m:.2f} m away."


def _least(points: Floats, places: Floats) -> float:
    """The least distance between two sets of points; infinite where one is empty."""
    return float(np.min(cKDTree(points).query(places)[0])) if len(points) and len(places) else float("inf")


State = Literal["mapped", "partly mapped", "missed", "not observable"]
MAPPED_FROM = 0.5
"""Share of an object's surface in sight from which it counts as mapped."""
OBSERVED_FROM = 3
"""Keyframes that make a point of a surface observable, as in `map_quality`."""


@dataclass(frozen=True, slots=True)
class ObjectOnMap:
    """Object in sight of the flight, with the share of it that the map shows."""

    name: str
    state: State
    mapped: float  # share of its surface in sight that lies within 0.15 m of an occupied cell
    observable: float  # share of its surface in sight that the radars could observe


def inspect(omap: OccupancyMap, scene: Scene, frames: Mapping[str, Frames]) -> tuple[list[ObjectOnMap], Floats]:
    """Compare a map with the objects of the scene, as `map_quality` does with the whole scene.

    Args:
        omap: the map.
        scene: the true world.
        frames: the input of the map; their true poses give the surfaces in sight.

    Returns:
        Each object with surface on the grid and in sight of the flight, in the scene's order; and the points (k, 3) of
        surface in sight that are not on the map [m].

    Raises:
        InputError: nothing of the scene lies on the grid.
    """
    surface = surface_of(scene, omap.grid, frames)
    near = on_map(omap, surface.points)
    observable, out = surface.observable(OBSERVED_FROM), []
    for index, thing in enumerate(scene.objects):
        seen = (surface.object_id == index) & surface.in_view
        if not seen.any():
            continue
        able, share = float(observable[seen].mean()), float(near[seen].mean())
        out.append(ObjectOnMap(thing.name, _state(share, bool(able)), share, able))
    return out, surface.points[surface.in_view & ~near]


def place_of(omap: OccupancyMap, scene: Scene, frames: Mapping[str, Frames]) -> str:
    """Name the plane of a map by its height over what lies below the middle of the flight; or the volume."""
    grid = omap.grid
    if grid.dims == 3:
        return f"In the volume from z = {grid.z_m[0]:.1f} m to {grid.z_m[-1]:.1f} m"
    positions = np.concatenate([part.believed.position for part in frames.values()])
    height = float(positions[:, 2].mean())
    middle = positions[np.argmin(np.linalg.norm(positions[:, :2] - np.median(positions[:, :2], axis=0), axis=1))]
    face, distance = Raycaster(scene).hits(np.array([*middle[:2], height]), np.array([[0.0, 0.0, -1.0]]))
    if face[0] < 0:
        return f"In the plane z = {height:.1f} m"
    below = scene.objects[scene.face_object[face[0]]].name.replace("_", " ")
    return f"In the plane {distance[0]:.1f} m above {below}"


def _state(share: float, observable: bool) -> State:
    if not observable and not share:
        return "not observable"
    return "mapped" if share >= MAPPED_FROM else "partly mapped" if share else "missed"


def found_line(objects: Sequence[ObjectOnMap], metrics: Mapping[str, Metric]) -> str:
    """Say in one line how good the map is and which objects it misses."""
    named = {state: [one.name for one in objects if one.state == state] for state in ("partly mapped", "missed")}
    shown = sum(one.state == "mapped" for one in objects)
    score = f"F1 {metrics['f1'].value:.3f}, " if "f1" in metrics else ""
    rest = "; ".join(f"{state.split()[0]}: {', '.join(names) or 'none'}" for state, names in named.items())
    return f"found: {score}{shown} of {len(objects)} objects in sight mapped; {rest}"
