"""A learned inverse sensor model beside Elfes' and ullage's mapper, judged by the same evaluator.

    python -m studies.tables.learned_mapper --samples 200 --flights 2      needs torch==2.13.0 and ullage[scale]

A small network takes the range profile about one cell's range, the strongest sample before it, range and bearing. It
gives the chances that the cell is out of sight, free or a surface. Classes are balanced in training, so the difference
of two outputs is a log-likelihood ratio; a map adds these ratios over keyframes. Network, weight of a frame and offset
are fitted on the kinds "tuning", and the scores are those of the kinds "testing".
"""

from __future__ import annotations

import argparse
import tempfile
import time
from pathlib import Path
from typing import Any

import numpy as np
import torch
import zarr

import ullage as ul
from ullage.experiments.dataset import read_index

SENSORS = ("front", "left", "back", "right")
AROUND = 5  # range bins before and after the cell's
REACH_M, OPENING = 9.0, np.radians(60)
FEATURES = 2 * AROUND + 1 + 4
SCORES = ("f1", "precision", "recall", "recall_in_view", "surface_declared_free")


def features(decibels: Any, range_m: Any, pose: Any, cells: Any) -> tuple[Any, Any]:
    """Features (c, FEATURES) of the cells (n, 2) that one radar may see, and which of the cells these are.

    Args:
        decibels: one range profile (b) [dB].
        range_m: of its bins (b) [m].
        pose: position (x, y) [m] and yaw [rad] of the radar.
        cells: centres of cells (n, 2) [m].
    """
    away = cells - pose[:2]
    distance = np.hypot(*away.T)
    bearing = (np.arctan2(away[:, 1], away[:, 0]) - pose[2] + np.pi) % (2 * np.pi) - np.pi
    seen = np.flatnonzero((distance < REACH_M) & (distance > 0.3) & (np.abs(bearing) < OPENING))
    level = (np.clip(decibels, -120, -20) + 80) / 20
    at = np.searchsorted(range_m, distance[seen]).clip(AROUND, len(range_m) - AROUND - 1)
    window = level[at[:, None] + np.arange(-AROUND, AROUND + 1)]
    strongest = np.maximum.accumulate(np.where(range_m < 0.5, -3.0, level))
    rest = [strongest[at - AROUND], distance[seen] / 5, bearing[seen], np.abs(bearing[seen])]
    return np.column_stack([window, *rest]).astype(np.float32), seen


def yaw_of(quat: Any) -> float:
    """Heading of an attitude (x, y, z, w) [rad]."""
    x, y, z, w = quat
    return float(np.arctan2(2 * (w * z + x * y), 1 - 2 * (y * y + z * z)))


def training_rows(path: Path, rng: np.random.Generator) -> tuple[Any, Any]:
    """Features and classes of random cells of all samples: as many out of sight as free and as surface."""
    group, rows, classes = zarr.open_group(str(path), mode="r"), [], []
    range_m, mounts = group["range_m"][:], group["body_from_sensor"][:]
    for row in read_index(path):
        if row["failed"]:
            continue
        k = row["k"]
        echoes, truth, origin = group["samples"][k], group["occupancy"][k], group["patch_origin_m"][k]
        place, quats = group["believed_position_m"][k], group["believed_quat_xyzw"][k]
        for frame in rng.choice(len(place), 6, replace=False):
            picked = np.concatenate([rng.permutation(np.flatnonzero(truth == one))[:300] for one in range(3)])
            cells = origin + (np.stack(np.unravel_index(picked, truth.shape)[::-1], 1) + 0.5) * 0.1
            for sensor in range(4):
                pose = sensor_pose(place[frame], yaw_of(quats[frame]), mounts[sensor])
                decibels = 20 * np.log10(np.abs(echoes[sensor, frame]) + 1e-6)
                found, seen = features(decibels, range_m, pose, cells)
                rows.append(found)
                classes.append(truth.ravel()[picked[seen]])
    return np.concatenate(rows), np.concatenate(classes).astype(np.int64)


def sensor_pose(place: Any, yaw: float, mount: Any) -> Any:
    """Position (x, y) and yaw of a radar on a level body."""
    x, y = mount[:2, 3]
    turn = np.array([[np.cos(yaw), -np.sin(yaw)], [np.sin(yaw), np.cos(yaw)]])
    return np.array([*(place[:2] + turn @ (x, y)), yaw + np.arctan2(mount[1, 0], mount[0, 0])])


def fitted(rows: Any, classes: Any, *, epochs: int) -> torch.nn.Module:
    """Fit the network; each class weighs the same."""
    torch.manual_seed(0)
    net = torch.nn.Sequential(torch.nn.Linear(FEATURES, 48), torch.nn.ReLU(), torch.nn.Linear(48, 32), torch.nn.ReLU(),
                              torch.nn.Linear(32, 3))  # fmt: skip
    weight = torch.tensor(len(classes) / np.bincount(classes, minlength=3) / 3, dtype=torch.float32)
    loss, step = torch.nn.CrossEntropyLoss(weight), torch.optim.Adam(net.parameters(), 2e-3)
    x, y = torch.from_numpy(rows), torch.from_numpy(classes)
    for epoch in range(epochs):
        total = 0.0
        for part in torch.randperm(len(x)).split(2048):
            step.zero_grad()
            now = loss(net(x[part]), y[part])
            now.backward()
            step.step()
            total += float(now.detach()) * len(part)
        print(f"epoch {epoch + 1}: loss {total / len(x):.3f}", flush=True)
    return net


def evidence(net: torch.nn.Module, frames: dict[str, ul.Frames], grid: ul.Grid, *, every_m: float = 0.2) -> Any:
    """Sum of log-likelihood ratios of the grid's cells over keyframes, each times the chance to be in sight."""
    x, y = (grid.origin_m[k] + (np.arange(grid.shape[1 - k]) + 0.5) * grid.step_m for k in range(2))
    cells, out = np.stack(np.meshgrid(x, y), -1).reshape(-1, 2), np.zeros(grid.size)
    for part in frames.values():
        last = np.full(3, np.inf)
        for i, place in enumerate(part.believed.position):
            if np.linalg.norm(place - last) < every_m:
                continue
            last = place
            decibels = 20 * np.log10(np.abs(part.samples[i]) + 1e-6)
            pose = np.array([*place[:2], yaw_of(part.believed.quat_xyzw[i])])
            found, seen = features(decibels, part.range_m, pose, cells)
            with torch.no_grad():
                logits = net(torch.from_numpy(found))
                chance = torch.softmax(logits, 1)[:, 0]
            out[seen] += ((1 - chance) * (logits[:, 2] - logits[:, 1])).numpy()
    return out.reshape(grid.shape)


def as_map(sums: Any, grid: ul.Grid, weight: float, offset: float) -> ul.OccupancyMap:
    """The map of summed evidence; cells with next to none stay unknown."""
    percent = np.rint(100 / (1 + np.exp(-np.clip(weight * sums + offset, -30, 30)))).astype(np.int8)
    return ul.OccupancyMap(
        grid, np.where(np.abs(sums) < 0.5, -1, percent).astype(np.int8).reshape(grid.shape), "learned"
    )


def flown(kind: str, seed: int, count: int) -> tuple[Any, dict[str, ul.Frames], ul.Grid]:
    """A world, frames of a flight in it, and the grid of its map."""
    scene, path = ul.worlds.random(kind, seed), ul.worlds.flight(kind, seed)[:count]
    frames = ul.simulate(scene, path, ul.worlds.rig(kind, seed), seed=seed)
    box = np.stack(
        [np.minimum(scene.bounds[0], path.position.min(0)), np.maximum(scene.bounds[1], path.position.max(0))]
    )
    return scene, frames, ul.Grid.covering(box, 0.1, dims=2, margin_m=0.5)


def tuned(net: torch.nn.Module, given: argparse.Namespace) -> tuple[float, float]:
    """Weight of a frame and offset with the best mean F1 on flights of the kinds "tuning"."""
    cases = []
    for kind in ul.worlds.TUNING:
        scene, frames, grid = flown(kind, 7_000_001, given.frames)
        cases.append((scene, frames, grid, evidence(net, frames, grid)))
    tries = [(weight, offset) for weight in (0.05, 0.2, 0.8) for offset in (-4.0, -2.0, -1.0, 0.0, 1.0)]
    means = [
        np.mean([ul.metrics.map_quality(as_map(sums, grid, *one), scene, frames)["f1"].value
                 for scene, frames, grid, sums in cases])
        for one in tries
    ]  # fmt: skip
    print("tuning kinds: mean F1", round(float(max(means)), 3), "with weight and offset", tries[int(np.argmax(means))])
    return tries[int(np.argmax(means))]


def judged(net: torch.nn.Module, weight: float, offset: float, given: argparse.Namespace) -> None:
    """Print the scores of the three methods on the kinds "testing"."""
    table: dict[str, list[list[float]]] = {"elfes": [], "likelihood": [], "learned": []}
    for kind in ul.worlds.TESTING:
        for seed in range(given.flights):
            scene, frames, grid = flown(kind, seed, given.frames)
            maps = {method: ul.map_occupancy(frames, grid, method=method) for method in ("elfes", "likelihood")}
            maps["learned"] = as_map(evidence(net, frames, grid), grid, weight, offset)
            for method, omap in maps.items():
                got = ul.metrics.map_quality(omap, scene, frames)
                table[method].append([got[name].value for name in SCORES])
                print(kind, seed, method, *(f"{value:.3f}" for value in table[method][-1]), flush=True)
    print("\n| method | flights | " + " | ".join(SCORES) + " |\n" + "|---" * (len(SCORES) + 2) + "|")
    for method, rows in table.items():
        print(f"| {method} | {len(rows)} | " + " | ".join(f"{value:.3f}" for value in np.nanmean(rows, 0)) + " |")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--samples", type=int, default=200, help="of the training set")
    parser.add_argument("--flights", type=int, default=2, help="of each kind in the judgement")
    parser.add_argument("--frames", type=int, default=200, help="of a flight, at most")
    parser.add_argument("--epochs", type=int, default=6)
    parser.add_argument("--to", type=Path, default=Path("learned_mapper.pt"))
    given = parser.parse_args()
    torch.set_num_threads(1)
    start = time.process_time()
    with tempfile.TemporaryDirectory() as folder:
        path = ul.dataset("tuning", Path(folder) / "set.zarr", n=given.samples, frames=16, where=1)
        print(f"data set: {time.process_time() - start:.0f} CPU s", flush=True)
        rows, classes = training_rows(path, np.random.default_rng(0))
    print(f"{len(rows)} cells: {np.bincount(classes)}", flush=True)
    net = fitted(rows, classes, epochs=given.epochs)
    torch.save(net.state_dict(), given.to)
    print(
        f"{given.to}: {given.to.stat().st_size / 1e3:.0f} kB; {time.process_time() - start:.0f} CPU s so far",
        flush=True,
    )
    judged(net, *tuned(net, given), given)
    print(f"{time.process_time() - start:.0f} CPU s in all")


if __name__ == "__main__":
    main()
