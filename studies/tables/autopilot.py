"""Let ArduCopter's own simulator explore by `ullage explore`, and write one row a flight to a table of results.

    python -m studies.tables.autopilot --binary PATH/TO/arducopter [--worlds ntnu-room] [--seconds 60] [--seeds 1]

The binary is ArduCopter's software-in-the-loop build, which is not part of ullage. It takes off in Guided, hovers in
Brake, and is handed over in Guided once `ullage explore` waits for it. Nothing but set-points goes between both, and no
surface stops the simulated vehicle. Closest distances are those of its true place (SIM_STATE) with ullage's hull, until
it lands. `--end ctrl-c` and `--end killed` break off a flight halfway and only print what happens; no row is written.
"""

from __future__ import annotations

import argparse
import csv
import json
import os
import re
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from itertools import groupby
from pathlib import Path
from typing import NamedTuple

import numpy as np

from tools.fly_autopilot import MODES, PARAMETERS, Pilot, end, free_port, simulator
from tools.results import RESULTS, save
from ullage.arrays import Floats
from ullage.data import Trajectory
from ullage.experiments.exploration_report import clearances_m
from ullage.geometry import rpy_quat
from ullage.ports.mavlink.brake import BRAKE
from ullage.world.library import WORLDS
from ullage.world.raycast import Raycaster
from ullage.world.scene import Scene

NAME, RATE_HZ, SPEED_M_S = "autopilot", 10, 0.5
LAND = 9
"""Mode of ArduCopter in which it lands and stops its motors."""
LANDING_M = 0.25
"""So far below the height of the flight it lands."""
READY_S, LATE_S = 120.0, 90.0
HEADER = ("world, seed", "time [s]", "mapped", "contacts; closest [m]", "pose to set-point: median; 99 % [ms]",
          "load; map late [s]")  # fmt: skip


class Flown(NamedTuple):
    """What was seen of one flight."""

    truth: Floats  # (n, 4) time [s] and place in the world [m], from the hand-over on
    estimate: Floats  # (n, 4) the same, as the autopilot reported it
    pace: float  # seconds of the autopilot's clock in a second
    metrics: dict[str, float]
    verdict: str
    lines: str  # of ullage's terminal
    after: str  # what the vehicle did once ullage had ended


def flown(binary: Path, world: str, seed: int, seconds: float, ends: str, runs: Path) -> Flown:
    """Fly once.

    Raises:
        RuntimeError: the simulator does not take off, or ullage does not wait for it, fails or does not end.
    """
    scene, (x, y, z) = WORLDS[world].scene(), np.array(WORLDS[world].start)[:3]
    over_m = float(Raycaster(scene).distances(np.array([[x, y, z]]), np.array([[0.0, 0.0, -1.0]]))[0])
    gcs, port, origin = free_port(), free_port(), np.array([x, y, z - over_m])
    parameters = PARAMETERS | {"PRX1_TYPE": 0, "AVOID_ENABLE": 0}
    place = f"mavlink:udpin://127.0.0.1:{port}?origin={','.join(f'{value:.4f}' for value in origin)}"
    words = [sys.executable, "-m", "ullage", "explore", world, "--vehicle", place, "--time", f"{seconds:g}", "--seed",
             str(seed), "--out", str(runs), "-o", f"flight.speed_m_s={SPEED_M_S}", "-o", f"sensing.rate_hz={RATE_HZ}",
             "-o", "sensing.max_bounces=1"]  # fmt: skip
    log, started = runs / f"{world}-{seed}-{ends}.log", list[subprocess.Popen[bytes]]()
    with tempfile.TemporaryDirectory(prefix="autopilot") as folder, log.open("w") as out:
        try:
            started.append(simulator(binary, folder, parameters, gcs, port, subprocess.DEVNULL))
            pilot = Pilot(gcs)
            if failed := pilot.take_off(over_m):
                raise RuntimeError(f"{failed}: {pilot.texts[-3:]}")
            pilot.command(176, 1, BRAKE)
            started.append(subprocess.Popen(words, stdout=out, stderr=out))
            if not pilot.fly(READY_S, until=lambda: "waiting: " in log.read_text()):
                raise RuntimeError(f"ullage does not wait: {log.read_text()}")
            pilot.fly(30.0, lambda: pilot.command(176, 1, MODES["guided"]), until=lambda: pilot.mode == MODES["guided"])
            begun = time.monotonic()
            _until_it_ends(pilot, started, seconds, ends)
            after = _after(pilot)
        finally:
            for one in started[::-1]:
                end(one)
    truth, estimate = (
        np.array([row for row in rows if row[0] >= begun]) + np.append(0.0, origin)
        for rows in (pilot.truth, pilot.estimate)
    )
    clock = np.array([row for row in pilot.clock if row[0] >= begun])
    pace = float(np.polyfit(clock[:, 0], clock[:, 1], 1)[0])
    if started[1].returncode not in (0, 130):
        raise RuntimeError(f"ullage failed, and then the vehicle: {after}\n{log.read_text()[-2000:]}")
    run = max(runs.glob("*/verdict.txt"), key=os.path.getmtime)
    metrics = {name: one["value"] for name, one in json.loads((run.parent / "metrics.json").read_text()).items()}
    return Flown(truth, estimate, pace, metrics, run.read_text(), log.read_text(), after)


def _until_it_ends(pilot: Pilot, started: list[subprocess.Popen[bytes]], seconds: float, ends: str) -> None:
    """Fly until ullage has ended, or break off the flight halfway."""
    theirs, ours = started
    ended: Callable[[], bool] = lambda: ours.poll() is not None  # noqa: E731
    if ends != "itself":
        pilot.fly(seconds / 2, until=ended)
        if ends == "ctrl-c":
            ours.send_signal(signal.SIGINT)
        else:
            theirs.kill()
    if not pilot.fly(seconds + LATE_S, until=ended):
        raise RuntimeError("ullage did not end")


def _after(pilot: Pilot) -> str:
    """What the vehicle does in the 5 s after ullage has ended, in words."""
    here = np.array(pilot.at)
    pilot.fly(5.0)
    moved_m = float(np.linalg.norm(np.array(pilot.at) - here))
    names = {number: name for name, number in MODES.items()} | {BRAKE: "brake", LAND: "land"}
    return f"mode {names.get(pilot.mode, pilot.mode)}, {'armed' if pilot.armed else 'disarmed'}, moved {moved_m:.2f} m"


def row_of(scene: Scene, seen: Flown, load: float) -> list[str]:
    """Cells of a flight after the first."""
    height_m = float(np.median(seen.truth[:, 3]))
    aloft = seen.truth[: 1 + int(np.flatnonzero(seen.truth[:, 3] > height_m - LANDING_M)[-1])]
    still = rpy_quat(0, 0, np.zeros(len(aloft)))
    gaps = clearances_m(scene, Trajectory((aloft[:, 0] * 1e9).astype(np.int64), aloft[:, 1:], still), "hector")
    contacts = sum(bool(touches) for touches, _ in groupby(gaps <= 0.0))
    delays = re.search(r"Set-points left (\d+) ms \(median\) and (\d+) ms", seen.verdict)
    late = re.search(r"up to ([\d.]+) s behind", seen.verdict)
    return [
        f"{seen.metrics['duration']:.0f}", f"{seen.metrics.get('explored', 0):.2f}",
        f"{contacts}; {gaps.min():.2f}",
        "; ".join(delays.groups()) if delays else "", f"{load:.1f}; {late[1] if late else 0}",
    ]  # fmt: skip


def pose_error_m(seen: Flown) -> float:
    """Return the greatest distance of a reported place from the true one [m]."""
    same = np.stack([np.interp(seen.estimate[:, 0], seen.truth[:, 0], seen.truth[:, k]) for k in (1, 2, 3)], 1)
    return float(np.linalg.norm(seen.estimate[:, 1:] - same, axis=1).max())


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--binary", type=Path, required=True, help="ArduCopter's software-in-the-loop build")
    parser.add_argument("--seconds", type=float, default=60.0)
    parser.add_argument("--seeds", type=int, nargs="+", default=[1])
    parser.add_argument("--worlds", nargs="+", default=["ntnu-room", "ballast-tank", "lying-tank"])
    parser.add_argument("--end", choices=("itself", "ctrl-c", "killed"), default="itself")
    parser.add_argument("--out", type=Path, default=Path("runs/autopilot"), help="folder for runs")
    given = parser.parse_args()
    given.out.mkdir(parents=True, exist_ok=True)
    file = RESULTS / f"{NAME}.csv"
    rows = [*csv.reader(line for line in file.open() if not line.startswith("# "))][1:] if file.exists() else []
    for seed in given.seeds:
        for world in given.worlds:
            if f"{world}, {seed}" in [row[0] for row in rows] and given.end == "itself":
                continue
            load = os.getloadavg()[0]
            seen = flown(given.binary.resolve(), world, seed, given.seconds, given.end, given.out)
            row = [f"{world}, {seed}", *row_of(WORLDS[world].scene(), seen, max(load, os.getloadavg()[0]))]
            after = (f"Poses erred by up to {pose_error_m(seen):.2f} m, at {seen.pace:.3f} of real time. "
                     f"Then the vehicle: {seen.after}.")  # fmt: skip
            print(" | ".join(row), seen.verdict, after, sep="\n", flush=True)
            if given.end == "itself":
                rows.append(row)
                save(NAME, [HEADER, *rows], "python -m studies.tables.autopilot --binary PATH")


if __name__ == "__main__":
    main()
