"""How often a map misses wires and poles, and how often it holds what is not there, by range and angle.

Things of three sizes stand at places drawn anew for each flight, in a room of 12 x 8 x 3 m with all its echoes, and
the same flights are made without them. The body is turned against its way by another angle in each flight, so that what
is abeam lies at all angles off the radars' axes. Every place, of a thing and of an open cell, has a range and an angle
off the boresight: those of the nearest look of the flight that had it within 60 deg. A miss is a thing that is not on
the finished map, a false alarm an occupied cell over 0.15 m from everything; rates are shares of the things, and of the
open cells, that the flights had at that range and angle. An alarm of `detect(method="track")` has a range alone: where
nothing stands so near all round, each is false.

python -m studies.tables.wire_rates [--flights 12] [--volume] [--keep FOLDER] [--figure FILE]
"""

from __future__ import annotations

import argparse
import pickle
import sys
import tempfile
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np
from scipy.spatial import cKDTree

import ullage as ul
from studies.tables.wire_table import OBJECTS, angles, hits_of
from studies.thesis.flights import level_round, rising_round
from ullage.data import Frames, Trajectory
from ullage.geometry import quat_matrix, rpy_quat
from ullage.grids import OccupancyMap
from ullage.processing.metrics import cell_centres
from ullage.processing.truth import in_sight, spaced_looks, surface_of
from ullage.world.scene import Scene

SIZE, COPIES, CLEAR_M, APART_M = (12.0, 8.0, 3.0), 2, 0.5, 0.7
RANGES, ANGLES = ((0.5, 1.0), (1.0, 2.0), (2.0, 4.5)), ((0, 15), (15, 30), (30, 60))
MOST_TURN_DEG = 45.0
MOST_DEG, MATCH_M, BLIND_M, SKIRT_M, BESIDE_M = 60.0, 0.15, 0.5, 0.4, 0.5
COLORS = dict(zip(OBJECTS, ("tab:blue", "tab:orange", "tab:green"), strict=True))


@dataclass
class Tally:
    """What all flights gave; a place is range [m] and angle [deg]."""

    things: dict[str, list[tuple[float, float, bool]]] = field(default_factory=dict)
    cells: dict[bool, list[np.ndarray]] = field(default_factory=lambda: {True: [], False: []})
    flags: dict[bool, np.ndarray] = field(default_factory=lambda: {True: np.zeros(3), False: np.zeros(3)})


def places(path: Trajectory, rng: np.random.Generator) -> list[tuple[str, np.ndarray]]:
    """Where the things of one flight stand: clear of the way, of the walls and of each other."""
    out: list[tuple[str, np.ndarray]] = []
    half = np.array(SIZE[:2]) / 2 - CLEAR_M
    while len(out) < COPIES * len(OBJECTS):
        at = rng.uniform(-half, half)
        clear = np.linalg.norm(path.position[:, :2] - at, axis=1).min() > CLEAR_M
        if clear and all(np.linalg.norm(at - other) > APART_M for _, other in out):
            out.append((list(OBJECTS)[len(out) % len(OBJECTS)], at))
    return out


def turned(path: Trajectory, yaw_deg: float) -> Trajectory:
    """The same way, with the body turned to the left of it."""
    matrix = quat_matrix(path.quat_xyzw)
    ahead, left = matrix[:, :, 0], matrix[:, :, 1]
    yaw = np.arctan2(ahead[:, 1], ahead[:, 0]) + np.radians(yaw_deg)
    return Trajectory(path.t_ns, path.position, rpy_quat(np.arcsin(left[:, 2]), -np.arcsin(ahead[:, 2]), yaw))


def furnished(stand: list[tuple[str, np.ndarray]]) -> Scene:
    things = [
        Scene.of_wires((*at, -1.5), (*at, 1.5), OBJECTS[name], name=f"{name} {k}") for k, (name, at) in enumerate(stand)
    ]
    return Scene.union([ul.scenes.room(SIZE), *things])


def nearest_looks(frames: dict[str, Frames], points: np.ndarray) -> np.ndarray:
    """Range [m] and angle [deg] (n, 2) of places (n, 2) from the nearest look within 60 deg; infinite without one."""
    best = np.full((len(points), 2), np.inf)
    for part in frames.values():
        for i in spaced_looks(part.believed):
            gap = points - part.believed.position[i, :2]
            reach = np.linalg.norm(gap, axis=1)
            off = np.degrees(angles(part[int(i) : int(i) + 1], gap))
            better = (off < MOST_DEG) & (
                (reach < best[:, 0] - 1e-3) | ((reach < best[:, 0] + 1e-3) & (off < best[:, 1]))
            )
            best[better] = np.stack([reach, off], 1)[better]
    return best


def false_cells(omap: OccupancyMap, scene: Scene, frames: dict[str, Frames], stand: np.ndarray) -> np.ndarray:
    """Range, angle, whether it is held occupied, and whether that is beside a thing (n, 4), of each open cell."""
    height = float(np.mean([f.believed.position[:, 2].mean() for f in frames.values()]))
    centres = cell_centres(omap.grid.at_height(height), np.arange(omap.grid.size))
    gap = cKDTree(surface_of(scene, omap.grid, frames).points[:, :2]).query(centres[:, :2])[0]
    open_ = (gap > MATCH_M + 1e-6) & in_sight(scene, frames, centres)
    held = omap.occupied.ravel()[open_]
    beside = np.linalg.norm(centres[open_, None, :2] - stand, axis=2).min(1, initial=np.inf) < BESIDE_M
    return np.column_stack([nearest_looks(frames, centres[open_, :2]), held, held & beside])


def early_flags(frames: dict[str, Frames], stand: list[tuple[str, np.ndarray]]) -> np.ndarray:
    """Looks, metres of range in which nothing stands yet all round, and the flags of `track` there (3).

    A strong echo's own skirt, 0.4 m before it, is not counted, nor the last of the direct path, to 0.5 m.
    """
    half, out = np.array(SIZE) / 2, np.zeros(3)
    for part in frames.values():
        hits = hits_of(part, "track")
        for i in spaced_looks(part.believed):
            at = part.believed.position[i]
            gaps = [float((half - abs(at)).min()), *(float(np.linalg.norm(at[:2] - w)) for _, w in stand)]
            clear, mine = min(gaps) - SKIRT_M, hits.range_m[hits.frame == i]
            out += 1, max(clear - BLIND_M, 0.0), ((mine >= BLIND_M) & (mine < clear)).sum()
    return out


def fly(seed: int, tally: Tally, folder: Path, *, flights: int, volume: bool) -> None:
    """One flight with the things and one without."""
    path = turned(rising_round(seed) if volume else level_round(seed), MOST_TURN_DEG * (seed + 0.5) / flights)
    stand = places(path, np.random.default_rng(seed + 500))
    for there in (True,) if volume else (True, False):
        scene = furnished(stand if there else [])
        grid = ul.Grid.covering(scene.bounds, 0.1, dims=3 if volume else 2, margin_m=0.5)
        frames = flown(
            scene, path, seed, folder / f"{'rise' if volume else 'level'}{seed}{'' if there else 'bare'}.pkl"
        )
        omap = ul.map_occupancy(frames, grid, method="likelihood")
        if not volume:
            at = np.array([place for _, place in stand if there]).reshape(-1, 2)
            tally.cells[there].append(false_cells(omap, scene, frames, at))
            tally.flags[there] += early_flags(frames, stand if there else [])
        if there:
            score = ul.metrics.map_quality(omap, scene, frames)
            where = nearest_looks(frames, np.array([at for _, at in stand]))
            for k, (name, _) in enumerate(stand):
                tally.things.setdefault(name, []).append((*where[k], bool(score[f"found:{name} {k}"].value)))
        print(f"{seed}, things {there}: {int(omap.occupied.sum())} cells", file=sys.stderr, flush=True)


def flown(scene: Scene, path: Trajectory, seed: int, file: Path) -> dict[str, Frames]:
    """One flight's frames, simulated once and kept in a file."""
    if not file.exists():
        made = ul.simulate(scene, path, ul.Rig.preset("thesis-4"), seed=seed)
        file.write_bytes(pickle.dumps({name: replace(f, simulated=None) for name, f in made.items()}))
    frames: dict[str, Frames] = pickle.loads(file.read_bytes())
    return frames


def shares(rows: np.ndarray) -> np.ndarray:
    """How many places lie in each class of range and angle, and how many of them say yes (ranges, angles, 2)."""
    out = np.zeros((len(RANGES), len(ANGLES), 2), int)
    for i, (a, b) in enumerate(RANGES):
        for j, (c, d) in enumerate(ANGLES):
            mine = (rows[:, 0] >= a) & (rows[:, 0] < b) & (rows[:, 1] >= c) & (rows[:, 1] < d)
            out[i, j] = mine.sum(), rows[mine, 2].sum()
    return out


def print_rates(tally: Tally) -> None:
    """Markdown: a row for each class of range and angle."""
    missed = {name: shares(np.array([(r, a, not ok) for r, a, ok in rows])) for name, rows in tally.things.items()}
    false = {there: shares(np.concatenate(rows)) for there, rows in tally.cells.items() if rows}
    heads = [f"{name} missed" for name in missed] + [
        f"false of 1000 open cells, {'with' if there else 'without'} things" for there in false
    ]
    print("| range, angle |", " | ".join(heads), "|\n|---|" + "---|" * len(heads))
    for i, (a, b) in enumerate(RANGES):
        for j, (c, d) in enumerate(ANGLES):
            row = [f"{counts[i, j, 1]} of {counts[i, j, 0]}" for counts in missed.values()]
            row += [
                f"{1e3 * counts[i, j, 1] / counts[i, j, 0]:.2f} ({counts[i, j, 1]} of {counts[i, j, 0]})"
                if counts[i, j, 0]
                else "-"
                for counts in false.values()
            ]
            print(f"| {a:g} to {b:g} m, {c} to {d}° |", " | ".join(row), "|")
    for there, rows in tally.cells.items():
        if rows:
            held, beside = np.concatenate(rows)[:, 2:].sum(0)
            print(f"false cells, things {there}: {held:.0f}, of these within {BESIDE_M} m of a thing {beside:.0f}")
    for there, (looks, metres, count) in tally.flags.items():
        if looks:
            print(
                f"flags nearer than anything, things {there}: {count:.0f} in {looks:.0f} looks, {metres:.0f} m of range"
            )


def draw(tally: Tally, path: str) -> None:
    """Where things were found and missed and cells were false, and how the rates go with range."""
    import matplotlib

    matplotlib.use("Agg")
    import matplotlib.pyplot as plt

    figure, (left, right) = plt.subplots(1, 2, figsize=(11, 4.4), layout="constrained")
    bare = np.concatenate([rows[rows[:, 2] > 0] for rows in tally.cells[False]])
    full = np.concatenate([rows[rows[:, 2] > 0] for rows in tally.cells[True]])
    left.scatter(full[:, 0], full[:, 1], s=14, c="0.45", marker="x", lw=0.8, label="false cell, with things")
    left.scatter(bare[:, 0], bare[:, 1], s=14, c="tab:red", marker="+", lw=0.8, label="false cell, without")
    for name, rows in tally.things.items():
        r, a, ok = np.array(rows, float).T
        left.scatter(r[ok > 0], a[ok > 0], s=26, color=COLORS[name], label=f"{name}, found")
        left.scatter(r[ok == 0], a[ok == 0], s=40, facecolors="none", edgecolors=COLORS[name], label=f"{name}, missed")
    left.set(
        xlabel="range at the nearest look [m]", ylabel="angle off the boresight there [°]", xlim=(0, 4.6), ylim=(0, 60)
    )
    left.legend(fontsize=7, loc="lower center", ncols=4, bbox_to_anchor=(0.5, 1.0))
    middles = np.arange(len(RANGES))
    for k, (c, d) in enumerate(ANGLES):
        for there, shade in ((True, 0.9), (False, 0.4)):
            counts = shares(np.concatenate(tally.cells[there]))[:, k]
            rate = 1e3 * counts[:, 1] / np.maximum(counts[:, 0], 1)
            at = middles + 0.27 * (k - 1) + (-0.06 if there else 0.06)
            label = f"{c} to {d}°, {'with' if there else 'without'} things"
            right.bar(at, rate, 0.12, color=f"C{k}", alpha=shade, label=label)
    right.set_xticks(middles, [f"{a:g} to {b:g} m" for a, b in RANGES])
    right.set(xlabel="range at the nearest look", ylabel="false cells of 1000 open ones")
    right.legend(fontsize=7, loc="lower center", ncols=3, bbox_to_anchor=(0.5, 1.0))
    for axes in (left, right):
        axes.grid(alpha=0.3)
    figure.savefig(path, dpi=100)


def main() -> None:
    parser = argparse.ArgumentParser()
    parser.add_argument("--flights", type=int, default=12)
    parser.add_argument("--volume", action="store_true", help="weave up and down, and map the volume: misses alone")
    parser.add_argument("--keep", type=Path, help="folder that keeps simulated frames for the next run")
    parser.add_argument("--figure")
    options = parser.parse_args()
    tally = Tally()
    with tempfile.TemporaryDirectory() as own:
        folder = options.keep or Path(own)
        folder.mkdir(parents=True, exist_ok=True)
        for seed in range(options.flights):
            fly(seed, tally, folder, flights=options.flights, volume=options.volume)
    print_rates(tally)
    if options.figure:
        draw(tally, options.figure)


if __name__ == "__main__":
    main()
