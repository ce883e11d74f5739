"""Make the flights that test every method: rounds through one room, drawn by a seed, with errors of their poses."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Literal

import numpy as np

from ullage.arrays import Floats
from ullage.data import Frames, Metric, Trajectory
from ullage.geometry import rpy_quat
from ullage.grids import Grid, OccupancyMap, Tiles
from ullage.processing.truth import spaced_looks, surface_of
from ullage.radar.simulate import simulate
from ullage.specs import Rig
from ullage.world import scenes
from ullage.world.scene import Scene

Fidelity = Literal["physical", "thesis"]
Recordings = dict[str, Frames]
Scores = dict[str, list[dict[str, float]]]
"""Scores of each flight by the name of the method."""

COLUMNS = {
    "f1": "F1",
    "f1_half_cell": "F1, half a cell",
    "precision": "precision",
    "recall": "recall",
    "accuracy_median": "error median [m]",
    "accuracy_p90": "error p90 [m]",
    "surface_declared_free": "surface free",
    "known_behind": "known behind",
}
"""What every map is judged by, and its heading."""
SEEDS = 5
SIZE = (8.0, 6.0, 3.0)
RISE_M, WAVE_M = 0.45, 2.4
HOVER_S = 60.0


def judged_room() -> Scene:
    """Return a concrete room of 8 x 6 x 3 m with a steel plate of 1 x 2 m in it."""
    return scenes.room(SIZE, plate={"width_m": 1.0, "height_m": 2.0, "distance_m": 2.6})


def plane_of(scene: Scene) -> Grid:
    """Return the plane of 0.1 m cells for maps of a scene."""
    return Grid.covering(scene.bounds, 0.1, margin_m=1.0)


def volume_of(scene: Scene) -> Grid:
    """Return the volume of 0.1 m cells for maps of a scene."""
    return Grid.covering(scene.bounds, 0.1, dims=3, margin_m=0.5)


def level_round(seed: int, *, rate_hz: float = 25.0) -> Trajectory:
    """Draw a round at 0.5 m/s and nearly constant height, with random corners."""
    corners = np.array([(-2.6, -1.4), (1.2, -1.5), (1.3, 1.4), (-2.5, 1.5), (-2.6, -1.2)])
    corners = corners + np.random.default_rng(seed).uniform(-0.25, 0.25, corners.shape)
    way = np.concatenate([[0], np.cumsum(np.linalg.norm(np.diff(corners, axis=0), axis=1))])
    s = np.arange(0, way[-1], 0.5 / rate_hz)
    xy = np.stack([np.interp(s, way, corners[:, k]) for k in (0, 1)], axis=1)
    kernel = np.hanning(25) / np.hanning(25).sum()
    xy = np.stack([np.convolve(np.pad(c, 12, mode="edge"), kernel, "valid") for c in xy.T], axis=1)
    dx, dy = np.gradient(xy, axis=0).T
    quat = rpy_quat(0.02 * np.sin(s), 0.03 * np.cos(s), np.unwrap(np.arctan2(dy, dx)))
    height = 0.05 * np.sin(1.3 * s)
    return Trajectory(np.rint(np.arange(len(s)) * 1e9 / rate_hz).astype(np.int64), np.column_stack([xy, height]), quat)


def rising_round(seed: int, *, rise_m: float = RISE_M) -> Trajectory:
    """Draw the same round, rising and sinking by twice `rise_m`."""
    flat = level_round(seed)
    way = np.concatenate([[0], np.cumsum(np.linalg.norm(np.diff(flat.position, axis=0), axis=1))])
    position = flat.position.copy()
    position[:, 2] += rise_m * np.sin(2 * np.pi * way / WAVE_M + seed)
    return Trajectory(flat.t_ns, position, flat.quat_xyzw)


def hovering(path: Trajectory, rng: np.random.Generator, *, rate_hz: float = 25.0) -> Trajectory:
    """Append 60 s of hovering to a flight, with a drift of some centimetres as a drone has."""
    n = int(HOVER_S * rate_hz)
    t = np.arange(1, n + 1) / rate_hz
    phase, turn = rng.uniform(0, 2 * np.pi, 3), rng.uniform(0.2, 0.5, 3)
    wander = np.array([0.02, 0.02, 0.01]) * (np.sin(turn * t[:, None] + phase) - np.sin(phase))
    t_ns = path.t_ns[-1] + np.rint(t * 1e9).astype(np.int64)
    return Trajectory(t_ns, path.position[-1] + wander, np.tile(path.quat_xyzw[-1], (n, 1)))


def received(scene: Scene, path: Trajectory, seed: int, *, fidelity: Fidelity = "physical") -> Recordings:
    """Simulate the frames of the thesis' four radars along a path."""
    return dict(simulate(scene, path, Rig.preset("thesis-4"), fidelity=fidelity, seed=seed))


def believed(frames: Mapping[str, Frames], offset: Floats) -> Recordings:
    """Return frames whose estimated positions have an error (n, 3) [m]; the true poses are kept."""
    return {
        name: replace(f, poses=Trajectory(f.t_ns, f.believed.position + offset, f.believed.quat_xyzw))
        for name, f in frames.items()
    }


def without_phase(frames: Mapping[str, Frames]) -> Recordings:
    """Return the frames with amplitudes only."""
    return {name: replace(f, samples=f.amplitude) for name, f in frames.items()}


def drift(n: int, size_m: float, rng: np.random.Generator) -> Floats:
    """Draw a smooth position error (n, 3) of about this size that starts at zero [m]."""
    phase, rate = rng.uniform(0, 6.28, 3), rng.uniform(0.7, 1.6, 3)
    out = size_m * np.sin(np.linspace(0, 6.28, n)[:, None] * rate + phase) * [1, 1, 0.3]
    return np.asarray(out - out[0])


def errorless_map(scene: Scene, frames: Recordings, grid: Grid, *, zones: int = 1) -> OccupancyMap:
    """Return an errorless map: the surface within some Fresnel zones of a specular point."""
    grid = grid.at_height(float(np.mean([f.believed.position[:, 2].mean() for f in frames.values()])))
    surface = surface_of(scene, grid, frames)
    lit = np.flatnonzero(surface.looks > 0)
    points, normals = surface.points[lit], surface.normals[lit]
    keep = np.zeros(len(lit), bool)
    for part in frames.values():
        for i in spaced_looks(part.believed):
            ray = part.believed.position[i] - points
            away = np.sum(ray * normals, axis=1)
            aside = np.linalg.norm(ray - away[:, None] * normals, axis=1)
            keep |= aside < np.sqrt(zones * part.spec.wavelength_m * abs(away) / 2)
    percent = np.full(grid.shape, -1, np.int8)
    cell, _ = grid.index(points[keep] + 1e-3 * normals[keep])
    percent[tuple(np.clip(cell, 0, np.array(grid.shape) - 1).T)] = 99
    return OccupancyMap(grid, Tiles.of(percent, shape=grid.shape, corner=(0,) * grid.dims), "errorless")


def values_of(scores: Mapping[str, Metric], keys: Sequence[str]) -> dict[str, float]:
    """Return the values of metrics by name."""
    return {key: scores[key].value for key in keys}


def mean_of(scores: Scores, name: str, key: str) -> float:
    """Return the mean over the flights."""
    return float(np.mean([row[key] for row in scores[name]]))


def interval(values: Sequence[float], *, scale: float = 1.0, digits: int = 3) -> str:
    """Format the mean over flights and its 95 % interval by Student's t; a dash if there is none."""
    from scipy.stats import t

    count = len(values)
    if not np.all(np.isfinite(values)) or not count:
        return "-"
    mean = scale * float(np.mean(values))
    if count == 1:
        return f"{mean:.{digits}f}"
    half = scale * float(t.ppf(0.975, count - 1) * np.std(values, ddof=1) / np.sqrt(count))
    return f"{mean:.{digits}f} ± {half:.{digits}f}"


def rows_of(scores: Scores, columns: Mapping[str, str]) -> list[tuple[str, ...]]:
    """Return the rows of a table: each name, then mean and interval of each column."""
    return [(name, *(interval([row[key] for row in rows]) for key in columns)) for name, rows in scores.items()]
