"""What the map shows of door and windows of the NTNU room: python -m studies.tables.openings FIGURE.png.

The thesis' map gives "no indication of where the windows and doors are located" (7.2). Each row compares the wall where
an opening is with the bare wall beside it, in maps of the same flight in cells of 0.05 m.
"""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np

from studies.thesis.map_figures import Panel, draw_panels
from studies.thesis.workspace import Flown
from ullage.experiments.catalog import find_scenario
from ullage.experiments.simulated import prepare
from ullage.grids import Grid, OccupancyMap
from ullage.processing.elfes import ElfesMapper
from ullage.processing.occupancy import map_occupancy
from ullage.radar.simulate import simulate
from ullage.world.scene import Scene
from ullage.world.section import section

STEP_M, DEPTH_M = 0.05, 0.6
OPENINGS = ("door", "window_1", "window_2", "window_3")


def spans(scene: Scene) -> dict[str, tuple[float, float, float]]:
    """Return each opening's extent along its wall, and the wall's y [m]."""
    out = {}
    for name in OPENINGS:
        mine = [thing.name.split("::")[0] == name for thing in scene.objects]
        points = scene.corners()[np.array(mine)[scene.face_object]].reshape(-1, 3)
        out[name] = (float(points[:, 0].min()), float(points[:, 0].max()), float(points[:, 1].mean()))
    return out


def wall(omap: OccupancyMap, low: float, high: float, y: float) -> tuple[float, float]:
    """Return the share of a stretch of wall that is occupied, and where the first occupied cell lies from it [m]."""
    grid = omap.grid
    across = (grid.x_m > low) & (grid.x_m < high)
    near = abs(grid.y_m - y) < DEPTH_M
    part, inward = omap.occupied[np.ix_(near, across)], (y - grid.y_m[near]) * np.sign(y)
    found = part.any(0)
    first = np.where(part, inward[:, None], -np.inf).max(0)[found]
    return float(found.mean()), float(np.median(first)) if found.any() else float("nan")


def main() -> None:
    rays, waves = (prepare(find_scenario(name)) for name in ("ntnu-mapping", "ntnu-mapping-physical"))
    grid = Grid.covering(rays.scene.bounds, STEP_M, margin_m=1.0)
    mapper = ElfesMapper(grid)
    mapper.update(dict(simulate(rays.scene, rays.flown, rays.rig, fidelity="thesis", seed=7)))
    frames = dict(simulate(waves.scene, waves.flown, waves.rig, seed=7))
    maps = {"Elfes, ray model": mapper.map(), "ullage, physical": map_occupancy(frames, grid, method="likelihood")}
    print("opening | " + " | ".join(f"{name}: occupied, first cell from the wall [m]" for name in maps))
    for name, (low, high, y) in spans(waves.scene).items():
        for what, ends in ((name, (low, high)), (f"wall beside {name}", (low - (high - low), low))):
            found = (wall(omap, *ends, y) for omap in maps.values())
            print(f"{what} | " + " | ".join(f"{100 * share:.0f} %, {first:+.2f}" for share, first in found))
    flown = Flown("ntnu-mapping", waves, frames, None, None, {})
    marks = np.array([((low + high) / 2, y) for low, high, y in spans(waves.scene).values()])
    panels = [Panel(name, omap, flown.track, marks) for name, omap in maps.items()]
    walls = section(waves.scene, flown.height_m)
    draw_panels(Path(sys.argv[1]), [panels], walls=walls, title="Door and windows (circled), 0.05 m", width_in=5.0)


if __name__ == "__main__":
    if len(sys.argv) != 2:
        sys.exit(__doc__)
    main()
