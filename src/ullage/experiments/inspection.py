"""Compare a map with each object: mapped, partly mapped, missed; for metrics and reports only."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from typing import Any, Literal

import numpy as np

from ullage.arrays import Floats
from ullage.data import Frames, Metric
from ullage.grids import OccupancyMap
from ullage.processing.metrics import on_map
from ullage.processing.truth import surface_of
from ullage.world.raycast import Raycaster
from ullage.world.scene import Scene

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


def object_rows(objects: Sequence[ObjectOnMap]) -> list[dict[str, Any]]:
    """Objects as plain values, for JSON."""
    return [asdict(one) for one in objects]
