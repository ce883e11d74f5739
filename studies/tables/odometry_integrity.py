"""Measure whether poses by radar err by more than they say: a Markdown row a flight.

    python -m studies.tables.odometry_integrity --seeds 3 [--seconds 40] [--worlds hold,room,tank,corridor]

The hold is the scenario `cargo-hold-physical`; the others are random worlds (`ullage.worlds.random`). A drone flies
from rest at 0.5 m/s with four X4M05 at 17 Hz, a simulated inertial unit and an altimeter.
"""

from __future__ import annotations

import argparse
import time

import numpy as np
from shapely import LineString

import ullage as ul
from ullage.experiments.catalog import find_scenario
from ullage.experiments.radar_poses import errors, is_lost
from ullage.experiments.simulated import prepare

RATE_HZ = 17.0


def flight(world: str, seed: int, seconds: float) -> tuple[ul.Scene, ul.Trajectory]:
    """A world and the first seconds of a flight from rest through it."""
    if world == "hold":
        made = prepare(find_scenario("cargo-hold-physical", options=[f"seed={seed}", f"sensing.rate_hz={RATE_HZ:g}"]))
        scene, flown = made.scene, made.flown
    else:
        scene, path = ul.worlds.random(world, seed), ul.worlds.flight(world, seed).position
        level = np.array(LineString(path[:, :2]).simplify(0.1).coords)
        points = np.column_stack([level, np.full(len(level), path[:, 2].mean())])
        flown = ul.fly(ul.Waypoints(points, speed_m_s=0.5), scene=scene, rate_hz=RATE_HZ, seed=seed)
    return scene, flown[: int(seconds * RATE_HZ)]


def row(world: str, seed: int, seconds: float) -> str:
    """Errors of one flight, and how they compare with what the odometry says."""
    scene, flown = flight(world, seed, seconds)
    frames = ul.simulate(scene, flown, ul.Rig.preset("thesis-4"), seed=seed)
    imu, height = ul.simulate_imu(flown, seed=seed), ul.simulate_height(flown, seed=seed)
    begun = time.process_time()
    found = ul.odometry(frames, imu, start=flown[:1], height=height)
    cpu_s = time.process_time() - begun
    truth, lost = flown.at(found.trajectory.t_ns), is_lost(found)
    score = {one.name: one.value for one in errors(found, flown)}
    error = np.abs(found.trajectory.position - truth.position)
    silent = ((error / found.sigma[:, :3]).max(1) > 3) & ~lost
    kept = (error[~lost] ** 2).sum(1) if (~lost).any() else np.full(1, np.nan)
    way = np.linalg.norm(np.diff(flown.position, axis=0), axis=1).sum()
    numbers = (
        f"{flown.duration_s:.0f}", f"{way:.0f}", f"{score['pose_rms']:.2f}", f"{score['pose_end']:.2f}",
        f"{np.sqrt(kept.mean()):.2f}", f"{100 * silent.mean():.0f}", f"{score['pose_sigmas']:.1f}",
        f"{score['poses_lost']:.0f}", f"{cpu_s / flown.duration_s:.1f}",
    )  # fmt: skip
    return f"| {world} | {seed} | " + " | ".join(numbers) + " |"


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seeds", type=int, default=3)
    parser.add_argument("--seconds", type=float, default=40.0, help="of each flight")
    parser.add_argument("--worlds", default="hold,room,tank,corridor")
    given = parser.parse_args()
    names = (
        "world", "seed", "flown [s]", "way [m]", "rms [m]", "end [m]", "rms while not lost [m]",
        "over 3 sigma while not lost [%]", "most sigmas while not lost", "lost [%]", "CPU [s/s]",
    )  # fmt: skip
    print("| " + " | ".join(names) + " |\n" + "|---" * len(names) + "|", flush=True)
    for seed in range(1, given.seeds + 1):
        for world in given.worlds.split(","):
            print(row(world, seed, given.seconds), flush=True)


if __name__ == "__main__":
    main()
