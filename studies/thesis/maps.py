"""Score maps of one flight and count their errors by place, for all mapping experiments."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from studies.thesis.workspace import Flown, Workspace
from ullage.arrays import Floats
from ullage.data import Frames, Metric
from ullage.grids import Grid, OccupancyMap
from ullage.processing.metrics import MATCH_M, cell_centres, map_quality
from ullage.processing.occupancy import map_occupancy
from ullage.processing.truth import surface_of
from ullage.world.library import WORLDS
from ullage.world.scene import Scene
from ullage.world.section import section

MEASURES = (
    "f1",
    "precision",
    "recall",
    "accuracy_median",
    "surface_declared_free",
    "known_behind",
    "false_occupied_per_100m2",
)
HEAD = (
    "map",
    "F1",
    "precision",
    "recall",
    "error, median [m]",
    "surface declared free",
    "known behind walls",
    "false [m²/100 m²]",
)


def sampled_frames(flown: Flown, *, most: int = 400) -> dict[str, Frames]:
    """Return some frames of each radar, enough to determine the surfaces in view."""
    return {name: part[:: max(1, len(part) // most)] for name, part in flown.frames.items()}


def map_at(flown: Flown, step_m: float, method: Any) -> tuple[OccupancyMap, dict[str, Metric]]:
    """Map a flight on another grid and score it."""
    box = np.stack([np.minimum(flown.scene.bounds[0], flown.track.position.min(0)),
                    np.maximum(flown.scene.bounds[1], flown.track.position.max(0))])  # fmt: skip
    omap = map_occupancy(flown.frames, Grid.covering(box, step_m, margin_m=1.0), method=method)
    return omap, map_quality(omap, flown.scene, sampled_frames(flown))


def row_of(name: str, omap: OccupancyMap, scores: dict[str, Metric]) -> tuple[str, ...]:
    """Return a row of the table under HEAD, with false area instead of false cells so that grids compare."""
    values = [scores[key].value for key in MEASURES]
    values[-1] *= omap.grid.step_m**2
    return (name, *(f"{value:.3f}" for value in values[:-1]), f"{values[-1]:.2f}")


def false_cells(
    omap: OccupancyMap, flown: Flown, *, around: Sequence[Floats] | None = None, radius_m: float = 1.2
) -> int:
    """Count occupied cells farther than MATCH_M from every true surface; only near given points, if given."""
    from scipy.spatial import cKDTree

    surface = surface_of(flown.scene, omap.grid, sampled_frames(flown, most=50))
    occupied = cell_centres(omap.grid.at_height(flown.height_m), np.flatnonzero(omap.occupied))[:, :2]
    if not len(occupied):
        return 0
    wrong = np.asarray(cKDTree(surface.points[:, :2]).query(occupied)[0] > MATCH_M)
    if around is not None:
        near = np.min([np.linalg.norm(occupied - np.asarray(point)[:2], axis=1) for point in around], axis=0)
        wrong &= near < radius_m
    return int(wrong.sum())


def middle_of(scene: Scene, name: str) -> Floats:
    """Return the horizontal middle of all objects with a name prefix (2) [m]."""
    mine = np.array([thing.name.split("::")[0] == name for thing in scene.objects])
    points = scene.corners()[mine[scene.face_object]].reshape(-1, 3)
    return np.asarray((points.min(0) + points.max(0))[:2] / 2)


def walls_of(flown: Flown) -> Floats:
    """Return the true outline at the height of the flight (s, 2, 2) [m]."""
    return section(flown.scene, flown.height_m)


def show_world(work: Workspace, world: str, path: Path, figure: str, caption: str) -> None:
    """Draw the world as a cutaway, and a plan with the flight."""
    if work.quick:
        return  # the documentation shows it
    from studies.cutaway import world_picture

    one = WORLDS[world]
    world_picture(one.scene(), path, waypoints=np.array(one.path_xyzyaw), title=one.title, **one.view)
    work.results.add_figure(path, figure, caption)
