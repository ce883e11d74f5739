"""Check the thesis' statements on its targets (7.1) under both laws: each object alone, without noise."""

from __future__ import annotations

import numpy as np

from studies.thesis.targets import TAIL_M, TARGETS, decibel, radars, strafe
from studies.thesis.variants import alone, without_object
from studies.thesis.workspace import Workspace
from ullage.arrays import Bools, Floats
from ullage.config import Fidelity
from ullage.data import Frames, Trajectory
from ullage.processing.clean import suppress_floor
from ullage.radar.simulate import simulate
from ullage.world.library import WORLDS
from ullage.world.scene import Scene

LAWS: tuple[Fidelity, ...] = ("thesis", "physical")


def brightness(work: Workspace) -> None:
    """Check that the plate is brightest, the turned plate weak under the physical law only, and the wire faint."""
    best: dict[tuple[str, str], float] = {}
    opposite: dict[tuple[str, str], float] = {}
    summed: dict[tuple[str, str], float] = {}
    _, quiet = radars()
    for world, (name, _) in TARGETS.items():
        steel, path = alone(WORLDS[world].scene(), name), strafe(world, step_m=0.1 if work.quick else 0.05)
        ahead = int(np.argmin(abs(path.position[:, 1])))
        for law in LAWS:
            rows = simulate(steel, path, quiet, fidelity=law).amplitude
            best[world, law] = float(rows.max())
            opposite[world, law], summed[world, law] = float(rows[ahead].max()), float(rows[ahead].sum())
    hold = work.results.add_statement
    for law in LAWS:
        rest = max(value for (world, kind), value in best.items() if kind == law and world != "ntnu-plate")
        over = float(decibel(best["ntnu-plate", law] / rest))
        hold(f"the facing plate is the brightest target, {law} law", "7.1", over, "dB", low=3)
    drop = {law: float(decibel(opposite["ntnu-plate45", law] / opposite["ntnu-plate", law])) for law in LAWS}
    # "a very weak image of the plate": less than 1 % of the facing plate's power
    hold("physical law: the turned plate over the facing one, strongest bin of the frame taken opposite", "7.1",
         drop["physical"], "dB", high=-20)  # fmt: skip
    hold("ray law: turning the plate costs less than by the physical law, strongest bin", "7.1",
         drop["thesis"] - drop["physical"], "dB", low=3)  # fmt: skip
    total = float(decibel(summed["ntnu-plate45", "thesis"] / summed["ntnu-plate", "thesis"]))
    hold("ray law: the same, summed over range: 3 dB by the area and 3 by the cosine, which the thesis regrets", "7.1",
         total, "dB", low=-7, high=-5)  # fmt: skip
    faint = float(decibel(best["ntnu-wire", "physical"] / best["ntnu-plate", "physical"]))
    hold("physical law: the wire is faint, over the facing plate", "7.1", faint, "dB", high=-20)


def clutter(work: Workspace, scene: Scene, path: Trajectory, wire_m: Floats) -> None:
    """Check the floor's echo next to the wire, and its suppression when the height is known."""
    hold = work.results.add_statement
    _, quiet = radars()
    path = path[:: 4 if work.quick else 2]
    floor, steel = (alone(scene, name) for name in ("floor", TARGETS["ntnu-wire"][0]))
    apart = np.linalg.norm(path.position - wire_m, axis=1)[:, None]
    rays = [simulate(thing, path, quiet, fidelity="thesis") for thing in (floor, steel)]
    seen = [float(np.mean(np.where(abs(f.range_m - apart) < 0.6, f.amplitude, 0).max(1) > 0)) for f in rays]
    hold("ray law: the floor is received at the wire's range (share of frames)", "7.1", seen[0], low=0.9)
    hold("ray law: the wire itself is mostly missed (share of frames)", "7.1", seen[1], high=0.5)
    under, wires = (simulate(thing, path, quiet) for thing in (floor, steel))
    strong = float(decibel(under.amplitude.max() / wires.amplitude.max()))
    hold("physical law: the floor straight below is as strong as the wire", "7.1", strong, "dB", low=-6, high=6)
    there = np.where(abs(under.range_m - apart) < 0.3, under.amplitude, 0).max()
    hold("physical law: at the wire's own range it is the wire that is received, not the floor", "beyond",
         float(decibel(there / wires.amplitude.max())), "dB", high=-20)  # fmt: skip
    below = abs(under.range_m - path.position[:, 2:3]) < 0.15
    hold("physical law: what is left of the floor's echo when the height is known", "7.1",
         _left(under, suppress_floor(under), below), "dB", high=-15)  # fmt: skip
    whole = simulate(scene, path, quiet, fidelity="thesis")
    bare = simulate(without_object(scene, "floor"), path, quiet, fidelity="thesis")
    at_wire = abs(whole.range_m - apart) < 0.3
    hold("ray law: what is left of the floor alone at the wire's range, with height and antenna known", "7.1",
         _left(rays[0], suppress_floor(rays[0]), at_wire), "dB", high=-15)  # fmt: skip
    hold("ray law: what is left there of the floor's part in the whole room", "7.1",
         _left(whole, suppress_floor(whole), at_wire, less=bare), "dB", high=-6)  # fmt: skip


def _left(before: Frames, after: Frames, where: Bools, *, less: Frames | None = None) -> float:
    """Return the level that suppression leaves within some bins, rms over rms [dB]; `less` holds the wanted rest.

    NaN where there was no echo to suppress.
    """
    wanted = 0.0 if less is None else less.amplitude[where]
    rms = [float(np.sqrt(np.mean((f.amplitude[where] - wanted) ** 2))) for f in (before, after)]
    return float(decibel(rms[1] / rms[0])) if rms[0] else float("nan")


def tail(work: Workspace, scene: Scene, path: Trajectory) -> None:
    """Check the echoes from beyond the last wall: none under the ray law."""
    _, quiet = radars()
    few = path[:: max(1, len(path) // (2 if work.quick else 6))]
    rows = simulate(scene, few, quiet, fidelity="thesis"), simulate(scene, few, quiet, max_bounces=3)
    over = [float(np.sqrt(np.mean(f.amplitude[:, f.range_m > TAIL_M] ** 2)) / f.amplitude.max()) for f in rows]
    hold = work.results.add_statement
    hold("ray law: nothing comes from beyond the last wall (rms over the peak)", "7.1", over[0], high=0)
    hold("physical law: echoes drag on behind the wall (rms over the peak)", "7.1",
         float(decibel(over[1])), "dB", low=-70, high=-20)  # fmt: skip
