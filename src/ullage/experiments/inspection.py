"""Compare a map with each object: mapped, partly mapped, missed; for metrics and reports only."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from typing import Any, Literal

import numpy as np
from scipy.spatial import cKDTree

from ullage.data import Frames, Metric
from ullage.grids import OccupancyMap
from ullage.processing.metrics import MATCH_M, cell_centres
from ullage.processing.truth import surface_of
from ullage.world.scene import Scene

State = Literal["mapped", "partly mapped", "missed", "not observable"]
MAPPED_FROM = 0.5
"""Share of an object's observable surface from which it counts as mapped."""
OBSERVED_FROM = 3
"""Keyframes that make a point of a surface observable, as in `map_quality`."""


@dataclass(frozen=True, slots=True)
class ObjectOnMap:
    """Object in sight of the flight, with the share of it that the map shows."""

    name: str
    state: State
    mapped: float  # share of its observable surface within 0.15 m of an occupied cell; of that in sight if none is
    observable: float  # share of its surface in sight that the radars could observe


def inspect(omap: OccupancyMap, scene: Scene, frames: Mapping[str, Frames]) -> list[ObjectOnMap]:
    """Compare a map with the objects of the scene, as `map_quality` does with the whole scene.

    Args:
        omap: the map.
        scene: the true world.
        frames: the input of the map; their true poses give the surfaces in sight.

    Returns:
        Each object with surface on the grid and in sight of the flight, in the scene's order.

    Raises:
        InputError: nothing of the scene lies on the grid.
    """
    surface = surface_of(scene, omap.grid, frames)
    dims = omap.grid.dims
    cells = cell_centres(omap.grid, np.flatnonzero(omap.occupied))[:, :dims]
    near = np.zeros(len(surface.points), bool)
    if len(cells):
        near |= np.asarray(cKDTree(cells).query(surface.points[:, :dims])[0] <= MATCH_M)
    observable, out = surface.observable(OBSERVED_FROM), []
    for index, thing in enumerate(scene.objects):
        seen = (surface.object_id == index) & surface.in_view
        if not seen.any():
            continue
        able = seen & observable
        share = float(near[able if able.any() else seen].mean())
        out.append(ObjectOnMap(thing.name, _state(share, bool(able.any())), share, float(able.sum() / seen.sum())))
    return out


def _state(share: float, observable: bool) -> State:
    if not observable and not share:
        return "not observable"
    return "mapped" if share >= MAPPED_FROM else "partly mapped" if share else "missed"


def found_line(objects: Sequence[ObjectOnMap], metrics: Mapping[str, Metric]) -> str:
    """Say in one line how good the map is and which objects it misses."""
    missed = [one.name for one in objects if one.state == "missed"]
    shown = sum(one.state in ("mapped", "partly mapped") for one in objects)
    score = f"F1 {metrics['f1'].value:.3f}, " if "f1" in metrics else ""
    return f"found: {score}{shown} of {len(objects)} objects in sight; missed: {', '.join(missed) or 'none'}"


def object_rows(objects: Sequence[ObjectOnMap]) -> list[dict[str, Any]]:
    """Objects as plain values, for JSON."""
    return [asdict(one) for one in objects]
