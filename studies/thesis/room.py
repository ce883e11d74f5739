"""Map the NTNU room on four grids from coarse to fine, with Elfes' method and ullage's (thesis 6.2)."""

from __future__ import annotations

import numpy as np

from studies.thesis.map_figures import Panel, draw_panels
from studies.thesis.maps import HEAD, map_at, middle_of, row_of, show_world, walls_of
from studies.thesis.workspace import Flown, Workspace
from ullage.data import Metric
from ullage.grids import UNKNOWN, Grid, OccupancyMap
from ullage.processing.clean import remove_direct_path
from ullage.processing.elfes import ElfesMapper
from ullage.processing.metrics import map_quality, map_size
from ullage.processing.sar import focus

STEPS = {0.5: "ntnu-mapping-50cm", 0.2: "ntnu-mapping-20cm", 0.1: "ntnu-mapping", 0.05: "ntnu-mapping-5cm"}
PRINTED_KB = {0.5: 80, 0.2: 500, 0.1: 2000, 0.05: 8000}
"""What the thesis says a map of 50 x 50 m takes at 64 bit a cell [kB] (7.2)."""
SMALL = (0.2, 0.1)
CLEANED_DB = (-np.inf, -60.0, -45.0, -35.0, -30.0, -25.0, -20.0)
"""Levels under the image's brightest cell below which a cell is not kept [dB]; the first keeps all."""


def run(work: Workspace) -> None:
    """Map at every resolution; draw figures 6.9, 6.10, 6.12a and 6.13."""
    show_world(
        work, "ntnu-mapping", work.folder / "world.png", "figures 6.10 and 6.12a",
        "The testing room with the plate, and the path flown.",
    )  # fmt: skip
    steps = [step for step in STEPS if not work.quick or step in SMALL]
    rays = {step: work.fly(STEPS[step], reads=("image", "map") if step == 0.1 else ("map",)) for step in steps}
    waves = work.fly("ntnu-mapping-physical", ["sensing.rate_hz=10"] if work.quick else [], reads=())
    work.log("mapping on every grid")
    rows, memory, top, bottom = [], [], [], []
    mapped = {step: map_at(waves, step, "likelihood") for step in rays if step == 0.1 or not work.quick}
    for step, flown in rays.items():
        if flown.omap is None:
            continue
        rows.append(row_of(f"Elfes, {step:g} m", flown.omap, flown.metrics))
        top.append(Panel(f"Elfes, {step:g} m (thesis law)", flown.omap, flown.track))
        if step not in mapped:
            continue
        ours, scores = mapped[step]
        rows.append(row_of(f"ullage, {step:g} m", ours, scores))
        bottom.append(Panel(f"ullage, {step:g} m (physical law)", ours, waves.track))
        memory.append(_memory(step, ours))
    path = work.folder / "maps.png"
    draw_panels(path, [top, bottom], walls=walls_of(waves), title="The NTNU room mapped")
    work.results.add_figure(
        path, "figure 6.13", "Above, the thesis' method on its own ray frames; below, ullage's mapper on physical "
        "frames of the same flight. Red: what truly stands at the height of the flight.",
    )  # fmt: skip
    work.results.add_table(
        "Scores", HEAD, rows, note="Scored against the world by one evaluator (docs: Occupancy maps)."
    )
    work.results.add_table(
        "Memory of a map",
        ("cells", "thesis, 50 x 50 m, 64 bit [kB]", "the same, 10 x 8 m [kB]", "Elfes' mapper, 10 x 8 m, 32 bit [kB]",
         "8 bit [kB]", "ullage's finished map, 10 x 8 m [kB]", "its file [kB]"), memory,
        note="10 x 8 m is the room with a metre around it. Elfes' mapper holds two values a cell in 32 bits, one in 8 "
        "bits. The thesis' figures hold for its 10^6 cells; its equation 5.2 prints 50000 in their place.",
    )  # fmt: skip
    _images(work, rays[0.1], waves)
    clean_by_image(work, rays[0.1])
    state(work, rays, mapped[0.1])
    if 0.05 in rays:
        _finest_differs(work, rays[0.05])


def _memory(step: float, omap: OccupancyMap) -> tuple[str, ...]:
    size, cells = map_size(omap), omap.grid.size
    nodes = (ElfesMapper(omap.grid, bits=bits).nbytes / 1e3 for bits in (32, 8))
    return (f"{step:g} m", str(PRINTED_KB[step]), f"{cells * 8 / 1e3:.1f}", *(f"{node:.1f}" for node in nodes),
            f"{size['ram'].value / 1e3:.1f}", f"{size['file'].value / 1e3:.1f}")  # fmt: skip


def _images(work: Workspace, rays: Flown, waves: Flown) -> None:
    """Draw the room as a SAR image (figure 6.9)."""
    if rays.image is None:
        return
    grid = rays.image.grid
    clean = {name: remove_direct_path(part, until_m=0.6) for name, part in waves.frames.items()}
    panels = [
        Panel("summation, thesis law", rays.image),
        Panel("summation, physical law", focus(clean, grid, method="summation")),
        Panel("back-projection, physical law", focus(clean, grid)),
    ]
    path = work.folder / "sar.png"
    draw_panels(path, [panels], walls=walls_of(waves), title="Images of the room while traversing it", width_in=4.2)
    work.results.add_figure(path, "figure 6.9", "The room as a SAR image while it is traversed with four radars.")


def clean_by_image(work: Workspace, flown: Flown) -> None:
    """Clean Elfes' grid by the summation image, as section 7.2 of the thesis proposes.

    An occupied cell stays where the image's amplitude, over its brightest cell, passes a level. Others become unknown.
    """
    omap, image = flown.omap, flown.image
    if omap is None or image is None:
        return
    row, column = np.nonzero(omap.occupied)
    place = np.stack([omap.grid.x_m[column], omap.grid.y_m[row], np.full(len(row), image.grid.origin_m[2])], axis=1)
    cell, inside = image.grid.index(place)
    amplitude = np.zeros(len(row))
    amplitude[inside] = image.amplitude[tuple(cell[inside].T)]
    level_db = 20 * np.log10(np.maximum(amplitude / image.amplitude.max(), 1e-9))
    rows = []
    for least_db in CLEANED_DB:
        percent, faint = np.array(omap.percent), level_db < least_db
        percent[row[faint], column[faint]] = UNKNOWN
        scores = map_quality(OccupancyMap(omap.grid, percent, omap.method), flown.scene, flown.frames)
        found = [scores[name].value for name in ("f1", "precision", "recall")]
        name = f"{least_db:g} dB" if np.isfinite(least_db) else "as it is"
        rows.append((name, str(int(faint.sum())), *(f"{value:.3f}" for value in found)))
    work.results.add_table(
        "Elfes' grid cleaned by the summation image, 0.1 m",
        ("least level in the image", "cells removed", "F1", "precision", "recall"), rows,
        note="The thesis proposes to reduce the uncertainty of the grid by the image (7.2). Walls seen obliquely are "
        "as faint in the image as false cells, so cleaning costs more than it gains.",
    )  # fmt: skip


def state(work: Workspace, rays: dict[float, Flown], ours: tuple[OccupancyMap, dict[str, Metric]]) -> None:
    """Check the thesis' statements on its maps, and compare ullage's mapper.

    Args:
        work: takes the statements.
        rays: flights under the ray law by the size of a cell [m]; 0.1 m is among them.
        ours: ullage's map in cells of 0.1 m, and its scores.
    """
    hold, fine = work.results.add_statement, rays[0.1]
    if 0.5 in rays:
        hold("Elfes: 0.5 m is unclear; occupied cells lie farther off than at 0.1 m, mean", "7.2",
             rays[0.5].number("accuracy_mean") - fine.number("accuracy_mean"), "m", low=0.1, high=0.5)  # fmt: skip
    false = {step: flown.number("false_occupied") * _cell_m(flown) ** 2 for step, flown in rays.items()}
    hold("Elfes: 0.2 m gives more falsely occupied area than 0.1 m", "7.2", false[0.2] - false[0.1], "m2", low=1)
    plate = middle_of(fine.scene, "steel_plate")
    for step, flown in rays.items():
        if step < 0.5 and flown.omap is not None:
            hold(f"Elfes: the plate is on the map at {step:g} m", "7.2", _gap(flown.omap, plate), "m", high=0.05)
    hold("Elfes: occupied cells at 0.1 m from the true surface, median", "7.2", fine.number("accuracy_median"), "m",
         high=0.1)  # fmt: skip
    hold("Elfes: space behind walls is mapped (share of known cells)", "7.2", fine.number("known_behind"), low=0.02)
    hold("Elfes: surface found at 0.1 m (recall)", "7.2", fine.number("recall"), low=0.5)
    if 0.05 in rays:
        hold("Elfes at 0.05 m: few falsely occupied cells (precision)", "7.2", rays[0.05].number("precision"), low=0.8)
    omap, scores = ours
    hold("ullage: the plate is on the map at 0.1 m", "beyond", _gap(omap, plate), "m", high=0.15)
    hold("ullage's F1 over Elfes', both on their own frames, 0.1 m", "beyond", scores["f1"].value - fine.number("f1"),
         low=0.05)  # fmt: skip
    hold("ullage: cells held known over 0.3 m behind a surface (share)", "beyond", scores["known_behind"].value,
         high=0.005)  # fmt: skip
    hold("ullage: surface declared free (share)", "beyond", scores["surface_declared_free"].value, high=0.01)
    _memory_of_nodes(work)


def _cell_m(flown: Flown) -> float:
    return float("nan") if flown.omap is None else flown.omap.grid.step_m


def _memory_of_nodes(work: Workspace) -> None:
    """Check the mapper's memory for 50 x 50 m (equation 5.2, section 5.3.1)."""
    grid = Grid.covering([[0, 0, 0], [50, 50, 0]], 0.05, z_m=0.0)
    small, large = (ElfesMapper(grid, bits=bits).nbytes / 1e6 for bits in (8, 32))
    hold = work.results.add_statement
    hold("what Elfes' mapper holds for 50 x 50 m at 0.05 m, two values of 32 bits a cell; the thesis: 8 MB", "5.2",
         large, "MB", low=7.9, high=8.2)  # fmt: skip
    hold("the same with one byte a cell; the thesis: 1 MB", "5.3.1", small, "MB", low=0.95, high=1.03)


def _finest_differs(work: Workspace, flown: Flown) -> None:
    """State how the finest grid differs (figure 6.13)."""
    mapper = ElfesMapper(Grid.covering(flown.scene.bounds, 0.05, margin_m=1.0), spread_m=0.05)
    mapper.update(flown.frames)
    thin = map_quality(mapper.map(), flown.scene, flown.frames)
    work.results.add_difference(
        "figure 6.13 d", "0.05 m is as good as 0.1 m",
        f"few false cells (precision {flown.number('precision'):.2f}), but recall {flown.number('recall'):.2f}, and "
        f"{100 * flown.number('surface_declared_free'):.0f} % of the surface declared free",
        "method: a reading's f_o is normalised to a sum of 1 over its arc. Half the side of a cell means four "
        "times as many cells, each with a quarter of the evidence, at the same number of readings. An arc of half "
        f"the thickness 0.05 m in place of 0.15 m gives recall {thin['recall'].value:.2f} and "
        f"{100 * thin['surface_declared_free'].value:.0f} % free. A slower flight was not tried.",
    )  # fmt: skip


def _gap(omap: OccupancyMap, point: np.ndarray) -> float:
    """Return the horizontal distance from a point to the nearest occupied cell's border [m]."""
    y, x = np.nonzero(omap.occupied)
    if not len(x):
        return float("inf")
    half = omap.grid.step_m / 2
    gaps = [
        np.maximum(abs(axis - at) - half, 0)
        for axis, at in zip((omap.grid.x_m[x], omap.grid.y_m[y]), point, strict=True)
    ]
    return float(np.hypot(*gaps).min())
