"""CPU-ms per frame of the physical radar by scene, bounce order, world size and sensors; both cores; where time goes.

    python benchmarks/bench_physical.py [scenes] [grow] [cores] [stages]

Without words all four tables. CPU times are the least of several short runs, since machines are shared.
"""

import argparse
import contextlib
import os
import resource
import sys
import time
from collections import defaultdict
from pathlib import Path

import numpy as np

import ullage as ul
from ullage.kernels import beams, bounces, double_edge_diffraction, edge_diffraction, edges, facets, outlines, pulse
from ullage.radar import context, multipath, physical, visibility
from ullage.radar.physical import echoes
from ullage.world.library import WORLDS

sys.path.insert(0, str(Path(__file__).parents[1] / "tools"))
import results

RADAR = ul.RadarSpec.preset("x4m05", noise=None)


def cost(scene, bounces_, path, count=4, times=5):
    """CPU-ms a frame."""
    echoes(scene, path[:1], RADAR, max_bounces=bounces_)
    best = np.inf
    for start in range(times):
        track = path[start : start + count]
        began = time.process_time()
        echoes(scene, track, RADAR, max_bounces=bounces_)
        best = min(best, (time.process_time() - began) / len(track))
    return 1e3 * best


def worlds():
    line = ul.Trajectory.line((0.1, 0.1, 0.0), (0.6, 0.3, 0.1), 0.5, 50)
    plate = {"width_m": 0.5, "height_m": 0.5, "distance_m": 2.0}
    yield "plate in a 6x4x3 m room", ul.scenes.room((6, 4, 3), plate=plate), line
    yield "the same, 60 m long", ul.scenes.room((60, 4, 3), plate=plate), line
    yield "sphere", ul.scenes.sphere(0.3, 3.0), line
    for name in ("ntnu-room", "cluttered-room"):
        scene = ul.load_scene(WORLDS[name].path)
        middle = scene.bounds.mean(0)
        yield name, scene, ul.Trajectory.line(middle, middle + np.array([0.5, 0.2, 0.1]), 0.5, 50)
    hold = ul.load_scene(WORLDS["cargo-hold"].path)
    yield "cargo-hold, in its middle", hold, ul.Trajectory.line((0.1, 0, 6.6), (0.6, 0.2, 6.7), 0.5, 50)
    yield "cargo-hold, as it is flown", hold, _flown(100, 50)


def _flown(start, count):
    """A piece of the main job's flight along the hold, as one radar of it."""
    whole = ul.Trajectory.line((-11.5, -7, 4), (11, -7, 4), 0.5, 17)
    return whole[start : start + count]


def scenes():
    rows = [["world", "faces", "1 bounce", "2 bounces", "3 bounces"]]
    print(f"{'world':28s}{'faces':>7s}" + "".join(f"{b:>8d} b." for b in (1, 2, 3)) + "   [CPU-ms a frame]")
    for name, scene, path in worlds():
        row = [cost(scene, b, path) for b in (1, 2, 3)]
        print(f"{name:28s}{len(scene.faces):7d}" + "".join(f"{v:11.2f}" for v in row), flush=True)
        rows.append([name, str(len(scene.faces)), *(f"{v:.2g}" for v in row)])
    return rows


def grow():
    print("hold, x1 and x10 in length, and their ratio [CPU-ms a frame]")
    short, long = ul.scenes.hold(), ul.scenes.hold(length_m=300.0)
    path = ul.Trajectory.line((0.1, -7, 4), (0.6, -7, 4), 0.5, 50)
    for b in (1, 3):
        one, ten = cost(short, b, path), cost(long, b, path)
        print(f"  {b} bounces: {one:.2f}, {ten:.2f} ({len(short.faces)} and {len(long.faces)} faces): {ten / one:.2f}")


def spent_s():
    """CPU seconds of this process and of those it has ended."""
    return sum(resource.getrusage(who).ru_utime + resource.getrusage(who).ru_stime
               for who in (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN))  # fmt: skip


def cores():
    print("four radars over a piece of the cargo-hold flight, 3 bounces, wall-clock frames a second")
    hold = ul.load_scene(WORLDS["cargo-hold"].path)
    rig, path = ul.Rig.preset("thesis-4"), _flown(100, 340)
    have = sorted(os.sched_getaffinity(0))
    ul.simulate(hold, path[:2], rig, max_bounces=3)
    rates = []
    for use in (have[:1], have):
        os.sched_setaffinity(0, use)
        began, cpu = time.perf_counter(), spent_s()
        ul.simulate(hold, path, rig, max_bounces=3)
        wall, cpu = time.perf_counter() - began, spent_s() - cpu
        rates.append(4 * len(path) / wall)
        print(f"  {len(use)} core(s): {rates[-1]:.0f} frames/s, {1e3 * cpu / (4 * len(path)):.2f} CPU-ms a frame, "
              f"{rates[-1] / (4 * 17):.2f} times real time at 17 FPS each")  # fmt: skip
    print(f"  {len(have)} cores over one: {rates[-1] / rates[0]:.2f}")
    print("every radar of the rig alone [CPU-ms a frame]:", end="")
    for name, spec in rig.sensors.items():
        print(f" {name} {cost(hold, 3, path[::10].mounted(spec.mount.body_from_sensor())):.2f}", end="")
    print()


STAGES = (
    (edges, "cut", "cut outlines"),
    (outlines, "accumulate_outlines", "outlines"),
    (edge_diffraction, "accumulate_edge_diffraction", "conducting edges"),
    (double_edge_diffraction, "accumulate_doubles", "conducting edges"),
    (edge_diffraction, "audible", "conducting edges"),
    (facets, "split", "split triangles"),
    (facets, "accumulate", "triangles"),
    (pulse, "convolve", "pulse"),
    (beams, "trace", "trace beams"),
    (bounces, "reflect", "follow paths"),
    (bounces, "legs", "follow paths"),
    (bounces, "stand_ins", "follow paths"),
    (bounces, "cover", "follow paths"),
    (context, "seen", "rays, first"),
    (multipath, "between", "rays, bounces"),
    (visibility, "_through", "sheets"),
    (physical, "accumulate", "rest"),
)


@contextlib.contextmanager
def watched():
    """Seconds by stage, those of inner stages taken out of outer ones."""
    spent, inner, kept = defaultdict(float), [], []
    for module, name, stage in STAGES:
        call = getattr(module, name)
        kept.append((module, name, call))

        def timed(*words, call=call, stage=stage, **more):
            began = time.perf_counter()
            inner.append(0.0)
            try:
                return call(*words, **more)
            finally:
                took = time.perf_counter() - began
                spent[stage] += took - inner.pop()
                if inner:
                    inner[-1] += took

        setattr(module, name, timed)
    try:
        yield spent
    finally:
        for module, name, call in kept:
            setattr(module, name, call)


def stages():
    print("where the time goes, in percent")
    for name, scene, path in worlds():
        for b in (1, 3):
            echoes(scene, path[:1], RADAR, max_bounces=b)
            with watched() as spent:
                echoes(scene, path[:10], RADAR, max_bounces=b)
            total = sum(spent.values())
            shares = sorted(spent.items(), key=lambda pair: -pair[1])
            told = ", ".join(f"{stage} {100 * s / total:.0f}" for stage, s in shares if s > 0.02 * total)
            print(f"  {name}, {b} b.: {told}", flush=True)


if __name__ == "__main__":
    tables = {"scenes": scenes, "grow": grow, "cores": cores, "stages": stages}
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("table", nargs="*", help=", ".join(tables))
    parser.add_argument("--publish", action="store_true", help="write the table of scenes to studies/results")
    given = parser.parse_args()
    asked = given.table or list(tables)
    if unknown := [word for word in asked if word not in tables]:
        parser.error(f"no table {unknown[0]!r}; there are {', '.join(tables)}")
    for word in asked:
        rows = tables[word]()
        if rows and given.publish:
            print(results.save("physical_frame", rows, "python benchmarks/bench_physical.py scenes --publish"))
