"""The full-profile mapper in a volume, on flights that change height by a metre: Markdown, mean and 95 % interval.

Beside it, on the same frames, what the yardstick allows: a map of all surface within eight Fresnel zones of the true
foot of a perpendicular from one of the looks ("told the walls").

With --level, the flights stay level, and the table also says what share is flagged as ambiguous of the cells that lie
12 to 28 deg above and below the true foot of a perpendicular, at its range, in the beam and 0.2 m off every surface.
With --missions, ordinary inspection missions through worlds of `volume_missions` instead, a row for each.

python benchmarks/volume_table.py [--flights 0,1,2] [--only WORD] [--level] [--missions room,tank] [--keep FOLDER]
"""

from __future__ import annotations

import argparse
import pickle
import sys
import tempfile
from dataclasses import replace
from pathlib import Path

import numpy as np
from mapping_table import SIZE, believed, print_table, told
from mapping_table import route as level_route
from scipy.spatial import cKDTree
from volume_missions import MISSIONS, frames_of, world

import ullage as ul
from ullage.data import Frames, Trajectory
from ullage.geometry import quat_matrix
from ullage.grids import OccupancyMap
from ullage.processing.truth import spaced_looks, surface_of
from ullage.world.raycast import Raycaster
from ullage.world.scene import Scene

COLUMNS = {
    "f1": "F1",
    "precision": "precision",
    "recall": "recall",
    "accuracy_median": "error median [m]",
    "accuracy_p90": "error p90 [m]",
    "surface_declared_free": "surface free",
    "known_behind": "known behind",
    "ambiguous": "ambiguous",
    "free_found": "free found",
}
LEVEL_COLUMNS = {
    "flagged": "flagged",
    "flagged_free": "of these free",
    "flagged_unknown": "of these unknown",
    "flagged_cells": "cells",
}
RISE_M, WAVE_M = 0.45, 2.4
BEAM, OFF_M = float(np.cos(np.radians(32.5))), 0.2
ASIDE = np.radians([*range(-28, -11, 2), *range(12, 29, 2)])


def route(seed: int, *, rise_m: float = RISE_M) -> Trajectory:
    """The round of the plane's table, but rising and sinking by twice `rise_m`."""
    flat = level_route(seed)
    way = np.concatenate([[0], np.cumsum(np.linalg.norm(np.diff(flat.position, axis=0), axis=1))])
    position = flat.position.copy()
    position[:, 2] += rise_m * np.sin(2 * np.pi * way / WAVE_M + seed)
    return Trajectory(flat.t_ns, position, flat.quat_xyzw)


def flown(scene: Scene, seed: int, folder: Path, *, level: bool = False) -> dict[str, Frames]:
    """One flight's frames, simulated once and kept in the folder."""
    file = folder / f"{'level' if level else 'rise'}{seed}.pkl"
    if not file.exists():
        path = level_route(seed) if level else route(seed)
        made = ul.simulate(scene, path, ul.Rig.preset("thesis-4"), seed=seed)
        file.write_bytes(pickle.dumps({name: replace(f, simulated=None) for name, f in made.items()}))
    frames: dict[str, Frames] = pickle.loads(file.read_bytes())
    return frames


def beside_feet(scene: Scene, frames: dict[str, Frames], grid: ul.Grid) -> np.ndarray:
    """Cells (c, 3) at the range of a wall's true foot, but above or below it: what one straight leg leaves open."""
    caster, out = Raycaster(scene), []
    for part in frames.values():
        path = part.believed
        ahead, boresight = np.gradient(path.position, axis=0), quat_matrix(path.quat_xyzw)[:, :, 0]
        for i in spaced_looks(path):
            eye, track = path.position[i], ahead[i] / np.linalg.norm(ahead[i])
            for axis, sign in ((0, 1), (0, -1), (1, 1), (1, -1)):
                normal = sign * np.eye(3)[axis]
                reach = SIZE[axis] / 2 - eye @ normal
                aside = normal - (normal @ track) * track
                if boresight[i] @ normal < BEAM or not caster.visible(eye, (eye + (reach - 0.01) * normal)[None])[0]:
                    continue
                around = np.cos(ASIDE)[:, None] * aside + np.sin(ASIDE)[:, None] * np.cross(track, aside)
                ways = (normal @ track) * track + around
                out.append(eye + reach * ways[ways @ boresight[i] > BEAM])
    cells, inside = grid.index(np.concatenate(out))
    return np.unique(cells[inside], axis=0)


def flagged(omap: OccupancyMap, scene: Scene, frames: dict[str, Frames]) -> dict[str, float]:
    """What a level flight's map says of the cells that nothing but a second height could tell from a wall's foot."""
    cells = beside_feet(scene, frames, omap.grid)
    centres = np.array(omap.grid.origin_m) + (cells[:, ::-1] + 0.5) * omap.grid.step_m
    room = np.all(abs(centres) < np.array(SIZE) / 2, axis=1)
    off = cKDTree(surface_of(scene, omap.grid, frames).points).query(centres)[0] > OFF_M
    mine = tuple(cells[room & off].T)
    said = {"flagged": omap.ambiguous, "flagged_free": omap.free, "flagged_unknown": omap.percent == -1}
    return {**{key: float(flags[mine].mean()) for key, flags in said.items()}, "flagged_cells": float(len(mine[0]))}


def cases(frames: dict[str, Frames], seed: int):
    """Rows of the table: name, frames as they are mapped, or None for the map that is told."""
    count = len(next(iter(frames.values())))
    yield "exact poses", frames
    yield "amplitude only", {name: replace(f, samples=f.amplitude) for name, f in frames.items()}
    yield "3 mm white pose error", believed(frames, np.random.default_rng(seed + 100).normal(0, 0.003, (count, 3)))
    yield "told the walls", None


def missions(names: str, flights: str, only: str, folder: Path) -> dict[str, list[dict[str, float]]]:
    """Scores of all missions whose name holds a word, through the worlds named."""
    scores: dict[str, list[dict[str, float]]] = {}
    for name in names.split(","):
        scene = world(name)
        grid = ul.Grid.covering(scene.bounds, 0.1, dims=3, margin_m=0.5)
        for mission in (m for m in MISSIONS if only in m):
            for seed in map(int, flights.split(",")):
                frames = frames_of(name, mission, seed, folder)
                got = ul.metrics.map_quality(ul.map_occupancy(frames, grid), scene, frames)
                scores.setdefault(f"{name}, {mission}", []).append({key: got[key].value for key in COLUMNS})
                print(f"{seed} {name}, {mission}: F1 {got['f1'].value:.3f}", file=sys.stderr, flush=True)
    return scores


def main() -> None:
    parser = argparse.ArgumentParser()
    parser.add_argument("--flights", default="0,1,2", help="seeds of the flights, as 0,1,2")
    parser.add_argument("--only", default="", help="rows that hold this word")
    parser.add_argument("--level", action="store_true", help="fly level instead")
    parser.add_argument("--keep", type=Path, help="folder that keeps simulated frames for the next run")
    parser.add_argument("--missions", default="", help="worlds to fly ordinary missions through, as room,tank")
    options = parser.parse_args()
    scene = ul.scenes.room(SIZE, plate={"width_m": 1.0, "height_m": 2.0, "distance_m": 2.6})
    grid = ul.Grid.covering(scene.bounds, 0.1, dims=3, margin_m=0.5)
    scores: dict[str, list[dict[str, float]]] = {}
    with tempfile.TemporaryDirectory() as own:
        folder = options.keep or Path(own)
        folder.mkdir(parents=True, exist_ok=True)
        if options.missions:
            made = missions(options.missions, options.flights, options.only, folder)
            print_table("mission", COLUMNS, made)
            return
        for seed in map(int, options.flights.split(",")):
            frames = flown(scene, seed, folder, level=options.level)
            for name, recording in cases(frames, seed):
                if options.only not in name:
                    continue
                omap = told(scene, frames, grid, zones=8) if recording is None else ul.map_occupancy(recording, grid)
                got = ul.metrics.map_quality(omap, scene, frames)
                row = {key: got[key].value for key in COLUMNS} | (flagged(omap, scene, frames) if options.level else {})
                scores.setdefault(name, []).append(row)
                print(f"{seed} {name}: F1 {got['f1'].value:.3f}", file=sys.stderr, flush=True)
    print_table("volume", COLUMNS | (LEVEL_COLUMNS if options.level else {}), scores)


if __name__ == "__main__":
    main()
