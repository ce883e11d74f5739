"""How often wires and poles are missed, and how often nothing alarms, by range, angle and tilt, from simulation.

python -m studies.tables.wire_table [--runs 10] [--figure docs/pictures/wires.png] [--room]
"""

from __future__ import annotations

import argparse

import numpy as np

import ullage as ul
from studies.thesis.flights import SIZE, level_round, received
from ullage.data import Frames, Trajectory
from ullage.world.scene import Scene

OBJECTS = {"3 mm wire": 0.0015, "1 cm pole": 0.005, "5 cm pole": 0.025}
RANGES = (1.0, 2.0, 4.0, 6.0, 8.0)
CASES = {  # label: boresight off the object [deg], tilt of the object about the line of sight [deg]
    "on boresight, upright": (0, 0),
    "30° off, upright": (30, 0),
    "60° off, upright": (60, 0),
    "on boresight, 45° tilt": (0, 45),
    "on boresight, level": (0, 90),
    "60° off, level": (60, 90),
}
NEAR, OFF = ((0.5, 1.5), (1.5, 3.0), (3.0, 5.0)), ((0, 15), (15, 32.5), (32.5, 60))
METHODS = ("first_peak", "cfar", "track")
GATE_M, PFA = 0.15, 1e-4
RADAR = ul.RadarSpec.preset("x4m05")
NOWHERE = ul.scenes.wire(0.001, 1.0, 60.0)


def passing(angle_deg: float) -> Trajectory:
    """0.6 m across the line to the object at 0.5 m/s, looking `angle_deg` past it."""
    return Trajectory.line((0, -0.3, 0), (0, 0.3, 0), speed_m_s=0.5, rate_hz=25, yaw_deg=angle_deg)


def flights(radius_m: float, range_m: float, angle_deg: float, tilt_deg: float, runs: int):
    scene = ul.scenes.wire(radius_m, 3.0, range_m, tilt_deg)
    for seed in range(runs):
        yield ul.simulate(scene, passing(angle_deg), RADAR, seed=seed)


def hits_of(frames: Frames, method: str, pfa: float = PFA):
    return ul.detect(frames, method=method, pfa=pfa)


def found(frames: Frames, range_m: float, tilt_deg: float, method: str, pfa: float = PFA) -> np.ndarray:
    """Whether each frame has a detection at the object."""
    hits = hits_of(frames, method, pfa)
    y = frames.believed.position[:, 1] * np.cos(np.radians(tilt_deg))  # across the object
    near = abs(hits.range_m - np.hypot(range_m, y)[hits.frame]) <= GATE_M
    return np.isin(np.arange(len(frames)), hits.frame[near])


def misses(runs: int) -> dict[str, dict[tuple[str, float, str], float]]:
    table: dict[str, dict[tuple[str, float, str], float]] = {name: {} for name in OBJECTS}
    for name, radius in OBJECTS.items():
        for case, (angle, tilt) in CASES.items():
            for range_m in RANGES:
                seen: dict[str, list[np.ndarray]] = {m: [] for m in METHODS}
                for frames in flights(radius, range_m, angle, tilt, runs):
                    for method in METHODS:
                        seen[method].append(found(frames, range_m, tilt, method))
                for method in METHODS:
                    table[name][case, range_m, method] = 1 - float(np.concatenate(seen[method]).mean())
    return table


def false_alarms(runs: int) -> dict[str, float]:
    """Detections for each bin and frame where there is nothing."""
    out = dict.fromkeys(METHODS, 0)
    bins = 0
    for seed in range(runs):
        frames = ul.simulate(NOWHERE, passing(0), RADAR, seed=1000 + seed)
        bins += len(frames) * int((frames.range_m >= 0.45).sum())
        for method in METHODS:
            out[method] += len(hits_of(frames, method))
    return {method: count / bins for method, count in out.items()}


def curve(range_m: float, method: str, runs: int, case: str) -> np.ndarray:
    """Detection against false alarms of a 3 mm wire for rising pfa, where there were false alarms to count."""
    angle, tilt = CASES[case]
    with_ = list(flights(0.0015, range_m, angle, tilt, runs))
    without = [ul.simulate(NOWHERE, passing(0), RADAR, seed=2000 + s) for s in range(runs)]
    bins = sum(len(f) * int((f.range_m >= 0.45).sum()) for f in without)
    points = []
    for pfa in np.geomspace(1e-4, 0.1, 7):
        alarms = sum(len(hits_of(f, method, pfa)) for f in without)
        hit = np.concatenate([found(f, range_m, tilt, method, pfa) for f in with_]).mean()
        points.append((alarms / bins if alarms else np.nan, hit))
    return np.array(points)


def draw(table, path: str, runs: int) -> None:
    import matplotlib

    matplotlib.use("Agg")
    import matplotlib.pyplot as plt

    figure, axes = plt.subplots(1, 2, figsize=(11, 4.2), layout="constrained")
    case = "60° off, level"
    for name, color in zip(OBJECTS, ("tab:blue", "tab:orange", "tab:green"), strict=True):
        for method, line in (("cfar", ":"), ("track", "-")):
            chance = [1 - table[name][case, r, method] for r in RANGES]
            axes[0].plot(RANGES, chance, line, color=color, marker="o", ms=4, label=f"{name}, {method}")
    axes[0].set(xlabel="range [m]", ylabel="chance of detection in a frame", ylim=(-0.03, 1.03), title=f"{case}")
    hard = {"on boresight, level": 8.0, "60° off, upright": 8.0, "60° off, level": 4.0}
    for (case, range_m), color in zip(hard.items(), ("tab:blue", "tab:orange", "tab:green"), strict=True):
        for method, line in (("cfar", ":"), ("track", "-")):
            points = curve(range_m, method, runs, case)
            axes[1].semilogx(*points.T, line, color=color, marker=".", label=f"{case}, {range_m:.0f} m, {method}")
    axes[1].set(xlabel="false alarms for each bin and frame", ylabel="chance of detection in a frame")
    axes[1].set(ylim=(-0.03, 1.03), title="3 mm wire")
    for a in axes:
        a.grid(alpha=0.3)
        a.legend(fontsize=7, loc="upper center", ncols=3, bbox_to_anchor=(0.5, -0.14))
    figure.savefig(path, dpi=100)


def room(runs: int) -> None:
    """The three in a room with walls, floor and ceiling: on the map, and missed in flight by range and angle."""
    places = {"3 mm wire": (-0.7, 0.3), "1 cm pole": (0.1, -0.2), "5 cm pole": (-1.4, -0.1)}
    things = [Scene.of_wires((x, y, -1.5), (x, y, 1.5), OBJECTS[n], name=n) for n, (x, y) in places.items()]
    scene = Scene.union([ul.scenes.room(SIZE), *things])
    grid = ul.Grid.covering(scene.bounds, 0.1, margin_m=1.0)
    on_map = dict.fromkeys(places, 0)
    tally = {name: np.zeros((len(NEAR), len(OFF), 2), int) for name in places}
    false = []
    for seed in range(runs):
        frames = received(scene, level_round(seed), seed)
        score = ul.metrics.map_quality(ul.map_occupancy(frames, grid, method="likelihood"), scene, frames)
        false.append(int(score["false_occupied"].value))
        for part in frames.values():
            hits = hits_of(part, "track")
            for name, place in places.items():
                tally[name] += lit_and_missed(part, hits, np.array(place))
        for name in places:
            on_map[name] += int(score[f"found:{name}"].value)
    bins = [f"{a:g} to {b:g} m, {c:g} to {d:g}°" for a, b in NEAR for c, d in OFF]
    print("| object | on the map, flights |", " | ".join(bins), "|\n|---|---|" + "---|" * len(bins))
    for name, counts in tally.items():
        cells = [f"{missed / lit:.3f} ({lit})" if lit else "-" for lit, missed in counts.reshape(-1, 2)]
        print(f"| {name} | {on_map[name]} of {runs} |", " | ".join(cells), "|")
    print(f"\ncells held occupied over 0.15 m from everything, by flight: {false}")


def lit_and_missed(part: Frames, hits: ul.Detections, place: np.ndarray) -> np.ndarray:
    """Frames that had an object in these ranges and angles, and how many of them did not flag it (near, off, 2)."""
    away = place - part.believed.position[:, :2]
    reach, off = np.linalg.norm(away, axis=1), np.degrees(angles(part, away))
    seen = np.isin(np.arange(len(part)), hits.frame[abs(hits.range_m - reach[hits.frame]) <= GATE_M])
    out = np.zeros((len(NEAR), len(OFF), 2), int)
    for i, (a, b) in enumerate(NEAR):
        for j, (c, d) in enumerate(OFF):
            mine = (reach >= a) & (reach < b) & (off >= c) & (off < d)
            out[i, j] = mine.sum(), (mine & ~seen).sum()
    return out


def angles(part: Frames, away: np.ndarray) -> np.ndarray:
    from ullage.geometry import quat_matrix

    ahead = quat_matrix(part.believed.quat_xyzw)[:, :2, 0]
    return np.arccos(np.clip(np.einsum("ij,ij->i", ahead, away) / np.linalg.norm(away, axis=1), -1, 1))


def main() -> None:
    parser = argparse.ArgumentParser()
    parser.add_argument("--runs", type=int, default=10)
    parser.add_argument("--figure")
    parser.add_argument("--room", action="store_true")
    options = parser.parse_args()
    if options.room:
        room(options.runs)
        return
    table = misses(options.runs)
    print("| object | geometry |", " | ".join(f"{r:.0f} m" for r in RANGES), "|")
    print("|---|---|" + "---|" * len(RANGES))
    for name, rates in table.items():
        for case in CASES:
            cells = [" / ".join(f"{100 * rates[case, r, m]:.0f}" for m in METHODS) for r in RANGES]
            print(f"| {name} | {case} |", " | ".join(cells), "|")
    print("\nfalse alarms for each bin and frame:")
    for method, rate in false_alarms(max(40, 4 * options.runs)).items():
        print(f"  {method}: {rate:.2e}")
    if options.figure:
        draw(table, options.figure, options.runs)


if __name__ == "__main__":
    main()
