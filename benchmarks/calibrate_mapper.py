"""Fit the mapper's chances that an echo's bearing is true, on simulated rooms that no test or table uses.

Every echo that the mapper weighs is held against the room: its bearing is true when the point it names lies within
12 cm of a surface; echoes of what stands hidden behind a wall are left out. The log-odds are a sum of piecewise linear
terms, one for each measured quantity, fitted by logistic regression with a ridge.

python benchmarks/calibrate_mapper.py [--flights 2]
"""

from __future__ import annotations

import argparse
from dataclasses import replace

import numpy as np
from scipy.optimize import minimize
from scipy.spatial import cKDTree

import ullage as ul
from ullage.data import Frames, Trajectory
from ullage.geometry import rpy_quat
from ullage.processing import coherent
from ullage.processing.mapper import UllageMapper
from ullage.processing.mapper_looks import lit_ways
from ullage.processing.truth import surface_of
from ullage.thesis.flights import believed
from ullage.world.raycast import Raycaster

ROOMS = (
    ((7.0, 5.0, 2.8), "concrete", {"width_m": 0.8, "height_m": 1.5, "distance_m": 1.8, "yaw_deg": 20}, 0.6),
    ((9.0, 7.0, 3.6), "brick", {"width_m": 1.5, "height_m": 2.0, "distance_m": 3.4, "yaw_deg": 45}, 1.9),
    ((8.0, 8.0, 3.2), "concrete", {"width_m": 1.0, "height_m": 2.0, "distance_m": 3.0, "yaw_deg": 90}, 1.6),
    ((8.5, 6.5, 2.6), "concrete", {"width_m": 1.2, "height_m": 2.4, "distance_m": 2.2, "material": "wood"}, 0.8),
)
TRUE_M = 0.12
LEAST = float(np.cos(np.radians(50.0)))
RIDGE = 2e-5


def route(size: tuple[float, float, float], east: float, seed: int) -> Trajectory:
    x, y = size[0] / 2 - 1.3, size[1] / 2 - 1.3
    corners = np.array([(-x, -y), (east, -y), (east, y), (-x, y), (-x, 0.2 - y)])
    corners += np.random.default_rng(seed).uniform(-0.25, 0.25, corners.shape)
    way = np.concatenate([[0], np.cumsum(np.linalg.norm(np.diff(corners, axis=0), axis=1))])
    s = np.arange(0, way[-1], 0.02)
    xy = np.stack([np.interp(s, way, corners[:, k]) for k in (0, 1)], axis=1)
    kernel = np.hanning(25) / np.hanning(25).sum()
    xy = np.stack([np.convolve(np.pad(c, 12, mode="edge"), kernel, "valid") for c in xy.T], axis=1)
    dx, dy = np.gradient(xy, axis=0).T
    quat = rpy_quat(0.02 * np.sin(s), 0.03 * np.cos(s), np.unwrap(np.arctan2(dy, dx)))
    t_ns = np.rint(np.arange(len(s)) * 4e7).astype(np.int64)
    return Trajectory(t_ns, np.column_stack([xy, 0.05 * np.sin(1.3 * s)]), quat)


def echoes(scene, frames: dict[str, Frames]) -> tuple[list[dict[str, float]], list[bool]]:
    """What was measured of each echo that has a bearing in the beam, and whether that bearing is true."""
    grid = ul.Grid.covering(scene.bounds, 0.1, margin_m=1.0)
    tree, caster = cKDTree(surface_of(scene, grid, frames).points[:, :2]), Raycaster(scene)
    measured: list[dict[str, float]] = []
    true: list[bool] = []
    plain = coherent.EchoJudge.weigh

    def listen(judge, look):
        kept: list[dict[str, np.ndarray]] = []
        chance = coherent.chance
        coherent.chance = lambda table, terms: (kept.append(terms), chance(table, terms))[1]
        try:
            cosine, sigma, trust = plain(judge, look)
        finally:
            coherent.chance = chance
        for k, echo in enumerate(look.echoes):
            ways = lit_ways(look.heard.axes, look.track, float(np.clip(cosine[k], -1, 1)), LEAST)
            if not look.track.any() or not ways:
                continue
            eye = look.heard.position
            gaps = [float(tree.query((eye + echo[0] * way)[:2])[0]) for way in ways]
            way = ways[int(np.argmin(gaps))]
            short = eye + max(echo[0] - TRUE_M, 0.1) * way
            if min(gaps) < TRUE_M or caster.visible(eye, short[None], slack_m=0.02)[0]:
                measured.append({name: float(values[k]) for name, values in kept[0].items()})
                true.append(min(gaps) < TRUE_M)
        return cosine, sigma, trust

    coherent.EchoJudge.weigh = listen
    try:
        mapper = UllageMapper(grid)
        mapper.update(frames)
        mapper.finish()
    finally:
        coherent.EchoJudge.weigh = plain
    return measured, true


def fit(table: coherent.Table, measured: list[dict[str, float]], true: list[bool]) -> None:
    names, y = list(table[1]), np.array(true)
    columns = [np.ones((len(y), 1))]
    for name in names:
        knots, values = np.array(table[1][name][0]), np.array([row[name] for row in measured])
        columns.append(np.stack([np.interp(values, knots, unit) for unit in np.eye(len(knots))], axis=1))
    x = np.concatenate(columns, axis=1)
    ridge = np.r_[0, np.full(x.shape[1] - 1, RIDGE * len(y))]

    def cost(w):
        odds = x @ w
        return np.logaddexp(0, odds).sum() - odds[y].sum() + (ridge * w**2).sum(), x.T @ (
            1 / (1 + np.exp(-odds)) - y
        ) + 2 * ridge * w

    w = minimize(cost, np.zeros(x.shape[1]), jac=True).x
    chance = 1 / (1 + np.exp(-x @ w))
    print(f"{len(y)} echoes, {y.mean():.3f} true; log-loss {cost(w)[0] / len(y):.3f}; bias {w[0]:.2f}")
    at = 1
    for name in names:
        knots = table[1][name][0]
        print(f'    "{name}": ({knots}, {tuple(np.round(w[at : at + len(knots)], 2).tolist())}),')
        at += len(knots)
    for low, high in ((0, 0.2), (0.2, 0.5), (0.5, 0.8), (0.8, 0.95), (0.95, 1.01)):
        mine = (chance >= low) & (chance < high)
        share = y[mine].mean() if mine.any() else 0.0
        print(f"    said {low:.2f}..{high:.2f}: {mine.sum()} echoes, true {share:.2f}")


def main() -> None:
    parser = argparse.ArgumentParser()
    parser.add_argument("--flights", type=int, default=2)
    parser.add_argument("--rooms", type=int, default=len(ROOMS))
    options = parser.parse_args()
    kept = {"phase": ([], []), "range": ([], [])}
    for k, (size, material, plate, east) in enumerate(ROOMS[: options.rooms]):
        scene = ul.scenes.room(size, material=material, plate=plate)
        for flight in range(options.flights):
            path = route(size, east, 1000 + 7 * flight + k)
            frames = ul.simulate(scene, path, ul.Rig.preset("thesis-4"), seed=flight)
            noise = np.random.default_rng(flight).normal(0, 0.003, (len(path), 3))
            bare = {name: replace(f, samples=f.amplitude) for name, f in frames.items()}
            for kind, recording in (("phase", frames), ("phase", believed(frames, noise)), ("range", bare)):
                for into, got in zip(kept[kind], echoes(scene, recording), strict=True):
                    into.extend(got)
    fit(coherent.BY_PHASE, *kept["phase"])
    fit(coherent.BY_RANGE, *kept["range"])


if __name__ == "__main__":
    main()
