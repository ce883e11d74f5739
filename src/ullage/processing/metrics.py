"""Evaluate maps of any method against the true scene."""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Any, NamedTuple

import numpy as np
from scipy.ndimage import distance_transform_edt
from scipy.spatial import cKDTree

from ullage import checks
from ullage.arrays import Bools, Floats, Longs
from ullage.data import Metric, Recording, sensors_of
from ullage.grids import Grid, OccupancyMap
from ullage.processing.metrics_image import image_quality
from ullage.processing.truth import BORDER, Surface, in_sight, surface_of
from ullage.world.scene import Scene

__all__ = ["cell_centres", "hover_change", "image_quality", "map_cost", "map_quality", "map_size", "reliability",
           "worst_moment"]  # fmt: skip

MATCH_M = 0.15
BEHIND_M = 0.3
CORRIDOR_M = 0.5
SMALL_M = 0.6
MOST_CELLS = 40_000
CLIP = 0.01
RELIABILITY_PERCENT = 0, 2, 36, 50, 65, 75, 85, 95, 101
BODY_M = 0.3
"""Radius of the space that a flying drone needs [m]."""


@dataclass(frozen=True, slots=True, eq=False)
class _Scored:
    """Everything that the single scores are taken from."""

    omap: OccupancyMap
    surface: Surface
    observable: Bools  # (s)
    occupied: Floats  # (o, 3) centres of occupied cells
    occupied_gap: Floats  # (o) to the nearest true surface [m]
    surface_gap: Floats  # (s) to the nearest occupied cell [m], inf without one
    on_surface: Bools  # (o) occupied cells that hold true surface, on their border or within
    on_cells: Bools  # (s) surface in occupied cells, on their border or within
    cells: Longs  # (c) flat index of the cells that are judged one by one
    cell_gap: Floats  # (c) to the nearest true surface [m]
    cell_open: Bools  # (c) seen from the flight


def map_quality(
    omap: OccupancyMap, scene: Scene, frames: Recording, *, match_m: float = MATCH_M, min_looks: int = 3
) -> dict[str, Metric]:
    """Score a map at its own fixed thresholds.

    Surface counts as observable when at least `min_looks` looks (5 cm or 4 deg apart) had it in the antenna's 3 dB beam
    (65 deg for the X4), in range, in line of sight and, where it is smooth, within 10 deg of its normal (75 deg for the
    thesis' ray model, whose cosine law lights oblique walls). Recall, completeness and F1 are over observable surface;
    precision and accuracy over every occupied cell against every surface. `recall_in_view` is over all surface that a
    lidar on the flight would see: in range and in line of sight, in any direction and at any incidence. Those named
    `_half_cell` match only surface that lies in an occupied cell or on its border. A plane is judged in the slice at
    its height.

    A place is flyable when a ball of 0.3 m radius about it is free. `flyable_found` is the share of truly flyable cells
    in sight of the flight that the map holds flyable, `flyable_false` the share of cells that the map holds flyable and
    that are not.

    Args:
        omap: the map.
        scene: the true world.
        frames: the input of the map; their `truth` (else their poses) gives the surfaces in view.
        match_m: an occupied cell and a surface point this near count as the same [m].
        min_looks: looks that make a point observable.

    Returns:
        Scores by name; `found:NAME` for each object smaller than 0.6 m on the map.

    Raises:
        InputError: nothing of the scene lies on the grid, or an argument is of another type.
    """
    checks.instance("omap", omap, OccupancyMap, "map_quality")
    checks.instance("scene", scene, Scene, "map_quality")
    judged = _judge(omap, scene, frames, min_looks)
    near = judged.surface_gap <= match_m
    scores = (
        _matches(judged, judged.occupied_gap <= match_m, near, "")
        + _in_view(judged, near)
        + _flyable(judged)
        + _matches(judged, judged.on_surface, judged.on_cells, "_half_cell")
        + _distances(judged)
        + _shares(judged)
        + _false_alarms(judged, match_m)
        + _corridor(judged)
        + _calibration(judged)
        + _small_objects(judged, scene, match_m)
    )
    return {metric.name: metric for metric in scores}


def _judge(omap: OccupancyMap, scene: Scene, frames: Recording, min_looks: int) -> _Scored:
    grid = omap.grid
    surface = surface_of(scene, grid, frames)
    dims = grid.dims
    occupied = cell_centres(grid, np.flatnonzero(omap.occupied))
    tree = cKDTree(np.concatenate([surface.points, surface.corners])[:, :dims])
    reach = (0.5 + BORDER) * grid.step_m
    gap, on_surface = _gaps(tree, occupied[:, :dims], reach)
    surface_gap, on_cells = np.full(len(surface.points), np.inf), np.zeros(len(surface.points), bool)
    if len(occupied):
        surface_gap, on_cells = _gaps(cKDTree(occupied[:, :dims]), surface.points[:, :dims], reach)
    cells = np.arange(grid.size)
    if grid.size > MOST_CELLS:
        cells = np.sort(np.random.default_rng(0).choice(grid.size, MOST_CELLS, replace=False))
    height = float(np.mean(np.concatenate([p.believed.position[:, 2] for p in sensors_of(frames)])))
    centres = cell_centres(grid.at_height(height), cells)
    open_ = in_sight(scene, frames, centres)
    return _Scored(
        omap, surface, surface.observable(min_looks), occupied, gap, surface_gap, on_surface, on_cells, cells,
        np.asarray(tree.query(centres[:, :dims])[0]), open_,
    )  # fmt: skip


def _gaps(tree: cKDTree, points: Floats, reach: float) -> tuple[Floats, Bools]:
    """Distance of each point (p, d) to the nearest in a tree, and whether one lies within `reach` along every axis."""
    if not len(points):
        return np.zeros(0), np.zeros(0, bool)
    return np.asarray(tree.query(points)[0]), np.asarray(tree.query(points, p=np.inf)[0] <= reach)


def cell_centres(grid: Grid, cells: Longs) -> Floats:
    """Centres (c, 3) [m] of cells given by flat index."""
    where = np.unravel_index(cells, grid.shape)
    z = grid.z_m[where[0]] if grid.dims == 3 else np.full(len(cells), grid.origin_m[2])
    return np.column_stack([grid.x_m[where[-1]], grid.y_m[where[-2]], z])


def on_map(omap: OccupancyMap, points: Floats) -> Bools:
    """Whether each point (s, 3) of a surface lies within 0.15 m of an occupied cell."""
    centres = cell_centres(omap.grid, np.flatnonzero(omap.occupied))[:, : omap.grid.dims]
    if not len(centres):
        return np.zeros(len(points), bool)
    return np.asarray(cKDTree(centres).query(points[:, : omap.grid.dims])[0] <= MATCH_M)


def _share(flags: Bools, empty: float = 0.0) -> float:
    return float(np.mean(flags)) if flags.size else empty


def _matches(judged: _Scored, true: Bools, found: Bools, suffix: str) -> list[Metric]:
    precision, recall = _share(true), _share(found[judged.observable])
    f1 = 2 * precision * recall / (precision + recall) if precision + recall > 0 else 0.0
    return [Metric(name + suffix, value) for name, value in (("f1", f1), ("precision", precision), ("recall", recall))]


def _in_view(judged: _Scored, found: Bools) -> list[Metric]:
    return [Metric("recall_in_view", _share(found[judged.surface.in_view]))]


def _distances(judged: _Scored) -> list[Metric]:
    out = []
    for name, gaps in (("accuracy", judged.occupied_gap), ("completeness", judged.surface_gap[judged.observable])):
        known = gaps[np.isfinite(gaps)]
        values = (np.median(known), known.mean(), np.percentile(known, 90)) if known.size else (np.nan,) * 3
        out += [
            Metric(f"{name}_{kind}", float(v), "m") for kind, v in zip(("median", "mean", "p90"), values, strict=True)
        ]
    return out


def _shares(judged: _Scored) -> list[Metric]:
    seen = judged.surface.seen
    free, known = judged.omap.free.ravel()[judged.cells], _known(judged.omap).ravel()[judged.cells]
    declared = _declared_free(judged.omap, judged.surface)
    behind = known & ~judged.cell_open & (judged.cell_gap > BEHIND_M)
    clear = judged.cell_open & (judged.cell_gap > judged.omap.grid.step_m)
    return [
        Metric("surface_declared_free", _share(declared[seen])),
        Metric("surface_missed_and_free", _share(declared[seen] & (judged.surface_gap[seen] > MATCH_M))),
        Metric("known_behind", behind.sum() / max(known.sum(), 1)),
        Metric("free_found", _share(free[clear])),
        Metric("ambiguous", _share(judged.omap.ambiguous.ravel()[judged.cells][judged.cell_open])),
        Metric("surface_observable", _share(judged.observable)),
        Metric("surface_specular_invisible", _share(seen & ~judged.observable)),
        Metric("surface_hidden", _share(~seen & ~judged.observable)),
    ]


def _flyable(judged: _Scored) -> list[Metric]:
    """Measure the share of usable space that the map shows as free, and the share of its free space that is unusable.

    The ball about a cell's centre must not touch a cell that is not free, nor what lies off the grid.
    """
    offered = judged.omap.clearance().distance_m.ravel()[judged.cells] > BODY_M
    usable = judged.cell_open & (judged.cell_gap > BODY_M)
    return [
        Metric("flyable_found", _share(offered[usable])),
        Metric("flyable_false", _share(~usable[offered])),
    ]


def _declared_free(omap: OccupancyMap, surface: Surface) -> Bools:
    """Mark the surface points (s) whose cells are all free."""
    before, behind = _sides(omap.grid, surface)
    return np.asarray(omap.free.ravel()[before] & omap.free.ravel()[behind])


def _sides(grid: Grid, surface: Surface) -> tuple[Longs, Longs]:
    """Flat index of the cells a hair before and behind each surface point: two where it lies on a cell's border."""
    out = []
    for side in (-0.1, 0.1):
        cell, _ = grid.index(surface.points + side * grid.step_m * surface.normals)
        cell = np.clip(cell, 0, np.asarray(grid.shape) - 1)
        out.append(np.ravel_multi_index(tuple(cell.T), grid.shape))
    return out[0], out[1]


def _known(omap: OccupancyMap) -> Bools:
    return omap.occupied | omap.free


def _false_alarms(judged: _Scored, within: float) -> list[Metric]:
    grid = judged.omap.grid
    false = int((judged.occupied_gap > within).sum())
    seen = judged.cell_open.mean() * grid.size * grid.step_m**2
    seen /= grid.shape[0] if grid.dims == 3 else 1
    return [
        Metric("false_occupied", float(false), "cells"),
        Metric("false_occupied_per_100m2", 100.0 * false / max(seen, grid.step_m**2), "1/100m2"),
    ]


def _corridor(judged: _Scored) -> list[Metric]:
    omap, half = judged.omap, CORRIDOR_M / 2
    step = omap.grid.step_m
    to_occupied = (
        distance_transform_edt(~omap.occupied) * step if omap.occupied.any() else np.full(omap.grid.shape, np.inf)
    )
    to_not_free = distance_transform_edt(omap.free) * step
    flyable = judged.cell_open & (judged.cell_gap > half + MATCH_M)
    barred = judged.cell_gap < half - MATCH_M
    return [
        Metric("corridor_falsely_blocked", _share(to_occupied.ravel()[judged.cells][flyable] <= half)),
        Metric("corridor_falsely_clear", _share(to_not_free.ravel()[judged.cells][barred] > half)),
    ]


def _labelled(judged: _Scored) -> tuple[Longs, Bools]:
    """Percent (k) of the cells in sight, and whether they hold true surface; cells at its border are left out."""
    flat, (before, behind) = judged.omap.percent.ravel(), _sides(judged.omap.grid, judged.surface)
    solid = np.zeros(flat.shape, bool)
    solid[np.where(flat[before] >= flat[behind], before, behind)[judged.surface.seen]] = True
    label = solid[judged.cells]
    use = label | (judged.cell_open & (judged.cell_gap > 0.75 * judged.omap.grid.step_m))
    return flat[judged.cells][use].astype(int), label[use]


class Reliable(NamedTuple):
    """Cells whose percent lies in a range, and how many of them hold surface."""

    low: int  # percent, from
    high: int  # to, both included
    cells: int
    said: float  # their mean chance of being occupied
    held: float  # share that holds true surface


def reliability(omap: OccupancyMap, scene: Scene, frames: Recording) -> list[Reliable]:
    """Compare the percents of a map with the truth, as a reliability diagram does.

    Args:
        omap: the map.
        scene: the true world.
        frames: the input of the map, which gives the cells in sight.

    Returns:
        Ranges of percent that cells have. Cells in sight count; free ones beside a surface's border do not.

    Raises:
        InputError: nothing of the scene lies on the grid.
    """
    percent, label = _labelled(_judge(omap, scene, frames, 1))
    out = []
    for low, high in pairwise(RELIABILITY_PERCENT):
        mine = (percent >= low) & (percent < high)
        if mine.any():
            held = float(label[mine].mean())
            out.append(Reliable(low, high - 1, int(mine.sum()), float(percent[mine].mean()) / 100, held))
    return out


def _calibration(judged: _Scored) -> list[Metric]:
    percent, label = _labelled(judged)
    chance = np.clip(np.where(percent >= 0, percent / 100.0, 0.5), CLIP, 1 - CLIP)
    likelihood = np.where(label, np.log(chance), np.log1p(-chance))
    known = percent >= 0
    bins = np.minimum((chance * 10).astype(int), 9)[known]
    gap = 0.0
    for k in range(10):
        mine = bins == k
        if mine.any():
            gap += mine.mean() * abs(chance[known][mine].mean() - label[known][mine].mean())
    return [
        Metric("log_likelihood", float(likelihood.mean()) if len(label) else np.nan, "nat/cell"),
        Metric("brier", float(np.mean((chance - label) ** 2)) if len(label) else np.nan),
        Metric("ece", float(gap)),
    ]


def _small_objects(judged: _Scored, scene: Scene, within: float) -> list[Metric]:
    out = []
    for index, thing in enumerate(scene.objects):
        mine = judged.surface.object_id == index
        if not mine.any() or np.ptp(judged.surface.points[mine], axis=0)[:2].max() > SMALL_M:
            continue
        out.append(Metric(f"found:{thing.name}", float(judged.surface_gap[mine].min() <= within)))
    return out


def worst_moment(maps: Sequence[tuple[float, OccupancyMap]], scene: Scene, frames: Recording) -> dict[str, Metric]:
    """Find the worst of the maps that a flight saw: a pilot flies by the map of now, not by the last one.

    Args:
        maps: each with its time [s], all on one grid.
        scene: the true world.
        frames: the input of the maps.

    Returns:
        `worst_false_occupied`, the most occupied cells farther than 0.15 m from every true surface;
        `worst_surface_declared_free`, the largest share of the surface in sight of the whole flight that was marked as
        free; each with the time of its map, `_at` [s]. Empty without maps.

    Raises:
        InputError: nothing of the scene lies on the grid.
    """
    if not maps:
        return {}
    grid = maps[0][1].grid
    surface = surface_of(scene, grid, frames)
    tree = cKDTree(np.concatenate([surface.points, surface.corners])[:, : grid.dims])
    found = []
    for at, omap in maps:
        cells = cell_centres(grid, np.flatnonzero(omap.occupied))[:, : grid.dims]
        false = np.count_nonzero(np.asarray(tree.query(cells)[0]) > MATCH_M) if len(cells) else 0
        found.append((float(at), float(false), _share(_declared_free(omap, surface)[surface.seen])))
    out = []
    for name, unit, k in (("worst_false_occupied", "cells", 1), ("worst_surface_declared_free", "", 2)):
        worst = max(found, key=lambda one, k=k: one[k])  # type: ignore[misc]
        out += [Metric(name, worst[k], unit), Metric(f"{name}_at", worst[0], "s")]
    return {one.name: one for one in out}


def hover_change(before: OccupancyMap, after: OccupancyMap, scene: Scene, frames: Recording) -> dict[str, Metric]:
    """Measure the effect of hovering on a map: scores of both maps on the same frames, later minus earlier."""
    first, second = (map_quality(m, scene, frames) for m in (before, after))
    names = ("f1", "surface_declared_free", "false_occupied")
    return {f"hover_{n}": Metric(f"hover_{n}", second[n].value - first[n].value, second[n].unit) for n in names}


def map_cost(mapper: Any, frames: Recording) -> dict[str, Metric]:
    """CPU time a mapper takes for each profile, measured one frame at a time in turn of the sensors [ms]."""
    parts = sensors_of(frames)
    spent = []
    for i in range(max(map(len, parts))):
        for part in parts:
            if i < len(part):
                piece = part[i : i + 1]
                start = time.process_time()
                mapper.update(piece)
                spent.append(1e3 * (time.process_time() - start))
    values = (np.median(spent), np.mean(spent), np.percentile(spent, 99))
    return {
        f"cpu_{n}": Metric(f"cpu_{n}", float(v), "ms") for n, v in zip(("median", "mean", "p99"), values, strict=True)
    }


def map_size(omap: OccupancyMap) -> dict[str, Metric]:
    """Memory of a map, and of the same compressed as its file would be [byte], per square metre too."""
    import zlib

    grid = omap.grid
    area = grid.shape[-1] * grid.shape[-2] * grid.step_m**2
    packed = len(zlib.compress(np.ascontiguousarray(omap.percent).tobytes(), 6))
    return {
        "ram": Metric("ram", float(omap.nbytes), "B"),
        "ram_per_m2": Metric("ram_per_m2", omap.nbytes / area, "B/m2"),
        "file": Metric("file", float(packed), "B"),
        "file_per_m2": Metric("file_per_m2", packed / area, "B/m2"),
    }


def __dir__() -> list[str]:
    return __all__
