"""How near a drifting track comes back to the truth, nothing aligned, and what its frames know of a turn.

Two drifts of 20 cm on each of five flights; or, with --turn, how much stays of a turn of the track by 2 deg about its
first place, while the attitude is believed as it is: with all that may tell of a turn, and without.

python -m studies.tables.drift_table [--flights 5] [--drifts 2] [--turn]
"""

from __future__ import annotations

import argparse

import numpy as np

import ullage as ul
from studies.thesis.flights import believed, drift, judged_room, level_round, received
from ullage.data import Frames, Trajectory
from ullage.processing.drift_surfaces import correct_drift_by_surfaces

DRIFT_M, TURN_DEG = 0.2, 2.0
SMOOTH_S, ROUGH_S = 5.0, 1.5
WHAT = {
    "all": (True, SMOOTH_S),
    "without the 10 cm from the body's middle to each sensor": (False, SMOOTH_S),
    "the offset smooth over 1.5 s only, not 5 s": (True, ROUGH_S),
    "without either": (False, ROUGH_S),
}


def rig(*, arms: bool) -> ul.Rig:
    """The four radars, on arms of 10 cm or all in the body's middle."""
    out = ul.Rig.preset("thesis-4")
    if arms:
        return out
    return ul.Rig(
        sensors={
            name: one.but(mount=one.mount.model_copy(update={"position_m": (0.0, 0.0, 0.0)}))
            for name, one in out.sensors.items()
        }
    )


def turn_left(frames: dict[str, Frames], path: Trajectory, time_s: float) -> float:
    """What stays [deg] of a turn of the track."""
    angle, away = np.radians(TURN_DEG), path.position - path.position[0]
    turned = np.column_stack(
        [away[:, :2] @ [[np.cos(angle), np.sin(angle)], [-np.sin(angle), np.cos(angle)]], away[:, 2]]
    )
    found = (
        correct_drift_by_surfaces(believed(frames, turned - away), drift_m=DRIFT_M, time_s=time_s)
        .frames["front"]
        .believed.position
    )
    one, other = ((at - at.mean(0))[:, :2] for at in (frames["front"].believed.position, found))
    cross = one[:, 0] * other[:, 1] - one[:, 1] * other[:, 0]
    return float(np.degrees(np.arctan2(cross.sum(), (one * other).sum())))


def print_turns(flights: int) -> None:
    scene = judged_room()
    print(f"| what may tell | flights 0 to {flights - 1} |\n|---|---|")
    for name, (arms, time_s) in WHAT.items():
        left = []
        for seed in range(flights):
            path = level_round(seed)
            left.append(turn_left(ul.simulate(scene, path, rig(arms=arms), seed=seed), path, time_s))
        print(f"| {name} |", ", ".join(f"{turn:.2f}" for turn in left), "|", flush=True)


def print_drifts(flights: int, count: int) -> None:
    scene = judged_room()
    print("| flight | drift | before [mm] | after [mm] | of this one shift of all [mm] | corrected | sigma [mm] |")
    print("|---|---|---|---|---|---|---|")
    for seed in range(flights):
        path = level_round(seed)
        frames = received(scene, path, seed)
        for k in range(count):
            offset = drift(len(path), DRIFT_M, np.random.default_rng([seed, 300 + k]))
            done = correct_drift_by_surfaces(believed(frames, offset), drift_m=DRIFT_M)
            found = next(iter(done.frames.values()))
            left = (found.believed.position - next(iter(frames.values())).believed.position)[:, :2]
            rms = [1e3 * np.sqrt((part**2).sum(1).mean()) for part in (offset[:, :2], left)]
            sigma = 1e3 * np.sqrt((done.sigma_m**2).sum(1).mean())
            print(f"| {seed} | {k} | {rms[0]:.0f} | {rms[1]:.0f} | {1e3 * np.hypot(*left.mean(0)):.0f} |", end=" ")
            print("yes" if done.corrected else f"no: {done.reason}", f"| {sigma:.0f} |", flush=True)


def main() -> None:
    parser = argparse.ArgumentParser()
    parser.add_argument("--flights", type=int, default=5)
    parser.add_argument("--drifts", type=int, default=2)
    parser.add_argument("--turn", action="store_true", help="what stays of a turn, in place of the drifts")
    options = parser.parse_args()
    if options.turn:
        print_turns(options.flights)
    else:
        print_drifts(options.flights, options.drifts)


if __name__ == "__main__":
    main()
