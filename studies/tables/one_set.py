"""Fit what the thesis leaves open to all its statements at once: python -m studies.tables.one_set FILE.json.

A set names a world (floor, coefficients), a scale of the threshold, a level of noise and a path for each flight. Every
set is simulated by the thesis' ray model and mapped by Elfes' grid, at the whole frame rate and with one seed. A
statement adds z^2 to a set's misfit, where z counts standard deviations beyond the statement's limit. The posterior is
exp(-misfit / 2) over sets that are equally likely before, with all variances widened by the best set's misfit for each
statement: no set fits, so the stated deviations are too narrow.
"""

from __future__ import annotations

import itertools
import json
import sys
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np

from studies.thesis.hall import SMALL_THINGS, THINGS, Hover, _at_end, _near, _unlike, on_map
from studies.thesis.map_causes import flown_to
from studies.thesis.maps import middle_of
from studies.thesis.targets import CELL_M, TARGETS, level_db, strafe, strafe_image, target_place
from studies.thesis.variants import OPENINGS, WALLS, with_ray_settings, without_models
from studies.thesis.workspace import Flown
from ullage.data import Frames
from ullage.experiments.catalog import find_scenario
from ullage.experiments.simulated import Simulated, prepare
from ullage.grids import Grid, OccupancyMap
from ullage.processing.echoes import first_echo
from ullage.processing.elfes import ElfesMapper
from ullage.processing.metrics import MATCH_M, cell_centres, map_quality
from ullage.processing.sar import focus
from ullage.processing.truth import surface_of
from ullage.radar.simulate import simulate
from ullage.specs import RadarSpec, Rig
from ullage.world.library import WORLDS
from ullage.world.scene import Scene

PRINTED = 0.038
FACTORS = (0.25, 0.5, 0.9, 1.0, 1.1, 2.0, 4.0)
FLOORS = {"floor and ceiling": False, "no floor or ceiling": True}
COEFFICIENTS = ("shipped", "all steel", "steel in weak walls")
NOISES = (0.002, 0.01)
TURNS_M, HEIGHTS_M = (0.2, 1.0), (4.0, 6.0)
SEED = 7
LEVEL = ("floor", "ceiling", "inner_bottom", "deck")
SHELL = (*WALLS, *OPENINGS, *LEVEL, "gate", "hopper", "side", "topside", "strake", "coamings", "frames", "bulkhead",
         "lower_stool", "upper_stool")  # fmt: skip
WEAK = 0.1  # coefficient of the walls of the third kind


@dataclass(frozen=True, slots=True)
class Wanted:
    """A statement of the thesis: what it says, where, its limits and one standard deviation."""

    where: str
    text: str
    sigma: float
    low: float = -np.inf
    high: float = np.inf

    def z(self, value: float) -> float:
        """Count the standard deviations beyond the limits; a number that is not known counts five."""
        return min(max(self.low - value, value - self.high, 0) / self.sigma, 5.0) if np.isfinite(value) else 5.0


SHARE, LEVEL_DB = 0.15, 6.0
STATEMENTS = {
    "plate_20": Wanted("7.2", "the plate is on the map at 0.2 m [m]", 0.1, high=0.05),
    "plate_10": Wanted("7.2", "the plate is on the map at 0.1 m [m]", 0.1, high=0.05),
    "plate_5": Wanted("7.2", "the plate is on the map at 0.05 m [m]", 0.1, high=0.05),
    "unclear_50": Wanted("7.2", "0.5 m is unclear: cells lie farther off than at 0.1 m [m]", 0.05, low=0.1),
    "false_20": Wanted("7.2", "0.2 m makes more false area than 0.1 m [m²]", 1.0, low=1.0),
    "walls_20": Wanted("6.13 b", "the least mapped wall at 0.2 m", SHARE, low=0.7),
    "walls_10": Wanted("6.13 c", "the least mapped wall at 0.1 m", SHARE, low=0.7),
    "walls_5": Wanted("6.13 d", "the least mapped wall at 0.05 m", SHARE, low=0.7),
    "precision_10": Wanted("7.2", "few false cells at 0.1 m: precision", 0.1, low=0.8),
    "precision_5": Wanted("7.2", "few false cells at 0.05 m: precision", 0.1, low=0.8),
    "behind": Wanted("7.2", "space behind walls is mapped: share of known cells", 0.01, low=0.02),
    "sar_plate": Wanted("6.9", "the plate in the room's image [dB]", LEVEL_DB, low=-6.0),
    "sar_ntnu-plate": Wanted("6.7 b", "the facing plate in its image [dB]", LEVEL_DB, low=-6.0),
    "sar_ntnu-plate45": Wanted("6.7 d", "the turned plate in its image [dB]", LEVEL_DB, low=-6.0),
    "sar_ntnu-pole": Wanted("6.8 b", "the pole in its image [dB]", LEVEL_DB, low=-6.0),
    "sar_wire_adds": Wanted("6.8 d", "what the wire adds at its place [dB]", 1.0, low=1.0),
    **{f"thing_{name}": Wanted("6.14", f"outline of the {name.replace('_', ' ')}", 0.2,
                               low=0.2 if name in SMALL_THINGS else 0.5) for name in THINGS},
    "smear_stop_sign": Wanted("7.2", "false cells that the stop sign makes", 3.0, low=5.0),
    "smear_postbox": Wanted("7.2", "false cells that the postbox makes", 3.0, low=3.0),
    "unlike": Wanted("6.14", "share of cells in which two runs differ", 0.003, low=0.005),
    "hover": Wanted("6.14", "new cells at the person while hovering", 3.0, low=5.0),
    "hold_empty": Wanted("7.3", "share of the hold's profiles with an echo", SHARE, high=0.1),
    "cpu_hall": Wanted("6.3", "cells of a reading, cluttered over NTNU room; thesis 7.3", 1.5, low=7.3),
    "cpu_hold": Wanted("6.4", "cells of a reading, hold over NTNU room; thesis 21", 4.0, low=21.0),
}  # fmt: skip


def kind_of(scene: Scene, bare: bool, kind: str) -> Scene:
    """Return a world with other coefficients, and without floor and ceiling."""

    def changed(name: str, material: Any) -> Any:
        shell = name.startswith(SHELL)
        value = {"shipped": material.reflection, "all steel": 1.0}.get(kind, WEAK if shell else 1.0)
        return material.but(reflection=value)

    things = tuple(replace(t, material=changed(t.name, t.material)) for t in scene.objects)
    models = {t.name.split("::")[0] for t in things}
    return without_models(replace(scene, objects=things), *(name for name in LEVEL if bare and name in models))


@dataclass(frozen=True, slots=True)
class Kind:
    """World and noise of a set."""

    bare: bool
    coefficients: str
    noise: float

    def rig(self, rig: Rig) -> Rig:
        return with_ray_settings(rig, noise_sigma=self.noise)

    def of(self, scene: Scene) -> Scene:
        return kind_of(scene, self.bare, self.coefficients)


Values = dict[str, float]
turned = cache(flown_to)  # the drone is flown once


@cache
def flown(name: str) -> Simulated:
    return prepare(find_scenario(name))


def heard(simulated: Simulated, scene: Scene, rig: Rig, seed: int = SEED) -> dict[str, Frames]:
    return dict(simulate(scene, simulated.flown, rig, fidelity="thesis", seed=seed))


def mapped(frames: dict[str, Frames], grid: Grid, factor: float) -> tuple[OccupancyMap, ElfesMapper]:
    mapper = ElfesMapper(grid, threshold=factor * PRINTED)
    mapper.update(frames)
    return mapper.map(), mapper


def cells_of(grid: Grid, frames: dict[str, Frames], factor: float) -> float:
    """Return the mean number of cells about the lobe (thesis 5.3.2) over 80 readings."""
    mapper, counts = ElfesMapper(grid, threshold=factor * PRINTED), []
    for part in frames.values():
        for i in np.linspace(0, len(part) - 1, 20).astype(int):
            mapper.update(part[i : i + 1])
            if mapper.traversed is not None:
                counts.append(np.prod([cut.stop - cut.start for cut in mapper.traversed]))
    return float(np.mean(counts)) if counts else float("nan")


def room(kind: Kind, turn_m: float) -> Iterator[tuple[float, Values]]:
    """Measure the NTNU room's statements at every threshold."""
    flight = turned(turn_m)
    box, plate = WORLDS["ntnu-mapping"].scene().bounds, middle_of(flight.scene, "steel_plate")
    frames = heard(flight, kind.of(flight.scene), kind.rig(flight.rig))
    image = focus(frames, Grid.covering(box, CELL_M, z_m=flight.flown.position[0, 2]), method="summation")
    bright = {"sar_plate": level_db(image, plate)}
    few = {name: part[::40] for name, part in frames.items()}
    for factor in FACTORS:
        maps = {
            step: mapped(frames, Grid.covering(box, step, margin_m=1.0), factor)[0] for step in (0.5, 0.2, 0.1, 0.05)
        }
        scores = {s: {k: m.value for k, m in map_quality(o, flight.scene, few).items()} for s, o in maps.items()}
        area = {s: scores[s]["false_occupied"] * s**2 for s in maps}
        yield factor, bright | {
            **{f"plate_{100 * s:.0f}": gap(maps[s], plate) for s in (0.2, 0.1, 0.05)},
            **{f"walls_{100 * s:.0f}": min(walls(maps[s], box)) for s in (0.2, 0.1, 0.05)},
            "unclear_50": scores[0.5]["accuracy_mean"] - scores[0.1]["accuracy_mean"],
            "false_20": area[0.2] - area[0.1], "behind": scores[0.1]["known_behind"],
            "precision_10": scores[0.1]["precision"], "precision_5": scores[0.05]["precision"],
            "cells": cells_of(maps[0.1].grid, frames, factor),
        }  # fmt: skip


def gap(omap: OccupancyMap, point: np.ndarray) -> float:
    """Return the distance from a point to the nearest occupied cell's border [m]."""
    y, x = np.nonzero(omap.occupied)
    away = [np.maximum(abs(axis - at) - omap.grid.step_m / 2, 0) for axis, at in
            ((omap.grid.x_m[x], point[0]), (omap.grid.y_m[y], point[1]))]  # fmt: skip
    return float(np.hypot(*away).min()) if len(x) else 9.0


def walls(omap: OccupancyMap, box: np.ndarray) -> Iterator[float]:
    """Return the share of each wall with an occupied cell within 0.21 m, 0.1 m off the corners."""
    axes = omap.grid.x_m, omap.grid.y_m
    for across in (0, 1):
        along = (axes[1 - across] > box[0, 1 - across] + 0.1) & (axes[1 - across] < box[1, 1 - across] - 0.1)
        for end in (0, 1):
            near = abs(axes[across] - box[end, across]) < max(0.21, 0.51 * omap.grid.step_m)
            rows, columns = (along, near) if across == 0 else (near, along)
            yield float(omap.occupied[np.ix_(rows, columns)].any(1 - across).mean())


def images(kind: Kind) -> Values:
    """Measure each target's level in its summation image."""
    spec = RadarSpec.preset("x4m05")
    spec = spec.but(thesis=spec.thesis.but(noise_sigma=kind.noise))

    def level(world: str, *gone: str) -> float:
        scene = without_models(kind.of(WORLDS[world].scene()), *gone)
        frames = simulate(scene, strafe(world), spec, fidelity="thesis", seed=SEED)
        return level_db(strafe_image(frames), target_place(world))

    out = {f"sar_{world}": level(world) for world in TARGETS if world != "ntnu-wire"}
    return out | {"sar_wire_adds": level("ntnu-wire") - level("ntnu-wire", "steel_wire::wire")}


def hall(kind: Kind) -> Iterator[tuple[float, Values]]:
    """Measure the cluttered room's statements at every threshold."""
    flight = flown("cluttered-room")
    box = np.stack([np.minimum(flight.scene.bounds[0], flight.flown.position.min(0)),
                    np.maximum(flight.scene.bounds[1], flight.flown.position.max(0))])  # fmt: skip
    grid, scene, rig = Grid.covering(box, 0.1, margin_m=1.0), kind.of(flight.scene), kind.rig(flight.rig)
    frames, again = heard(flight, scene, rig), heard(flight, scene, rig, SEED + 1)
    bare = {name: heard(flight, scene.without(name), rig) for name in SMALL_THINGS}
    posed = replace(flight, scene=scene, rig=rig)
    wait = _at_end(Flown("cluttered-room", posed, frames, None, None, {}), 340)
    truth = surface_points(
        flight.scene, grid, {name: part[:: max(1, len(part) // 50)] for name, part in frames.items()}
    )

    def false(omap: OccupancyMap, name: str) -> int:
        from scipy.spatial import cKDTree

        cells = cell_centres(omap.grid.at_height(1.1), np.flatnonzero(omap.occupied))[:, :2]
        if not len(cells):
            return 0
        near = np.linalg.norm(cells - middle_of(flight.scene, name), axis=1) < 1.2
        return int(np.sum(near & (cKDTree(truth).query(cells)[0] > MATCH_M)))

    for factor in FACTORS:
        omap, mapper = mapped(frames, grid, factor)
        done = Flown("cluttered-room", flight, frames, None, omap, {})
        smears = {f"smear_{name}": false(omap, name) - false(mapped(part, grid, factor)[0], name)
                  for name, part in bare.items()}  # fmt: skip
        mapper.update(wait)
        hovered = Hover(omap, mapper.map(), (0, 0), (_near(omap, done, "person"), _near(mapper.map(), done, "person")))
        yield factor, {f"thing_{name}": on_map(done, name) for name in THINGS} | smears | {
            "unlike": _unlike(omap, mapped(again, grid, factor)[0]), "hover": hovered.new_at_person,
            "cells": cells_of(grid, frames, factor),
        }  # fmt: skip


def surface_points(scene: Scene, grid: Grid, frames: dict[str, Frames]) -> np.ndarray:
    return surface_of(scene, grid.at_height(1.1), frames).points[:, :2]


def hold(kind: Kind, height_m: float) -> Iterator[tuple[float, Values]]:
    """Measure the hold's statements at every threshold, of every fourth frame."""
    flight = flown("cargo-hold")
    rise = np.array([0.0, 0.0, height_m - flight.flown.position[:, 2].mean()])
    path = replace(flight.flown, position=flight.flown.position + rise)[::4]
    frames = heard(replace(flight, flown=path), kind.of(flight.scene), kind.rig(flight.rig))
    grid = Grid.covering(np.stack([path.position.min(0) - 12, path.position.max(0) + 12]), 0.1)
    for factor in FACTORS:
        share = np.mean([first_echo(part, threshold=factor * PRINTED)[1].mean() for part in frames.values()])
        yield factor, {"hold_empty": float(share), "cells": cells_of(grid, frames, factor)}


def measure(file: Path, log: Callable[[str], None]) -> None:
    """Write every set: what it assumes, and its values; the file grows world by world."""
    sets: list[dict[str, Any]] = []
    for (floor, bare), kind_name, noise in itertools.product(FLOORS.items(), COEFFICIENTS, NOISES):
        kind = Kind(bare, kind_name, noise)
        log(f"{floor}, {kind_name}, noise {noise:g}")
        strafes, cluttered = images(kind), dict(hall(kind))
        rooms = {turn: dict(room(kind, turn)) for turn in TURNS_M}
        holds = {height: dict(hold(kind, height)) for height in HEIGHTS_M}
        for factor, turn, height in itertools.product(FACTORS, TURNS_M, HEIGHTS_M):
            near, far = rooms[turn][factor], holds[height][factor]
            values = strafes | cluttered[factor] | near | far
            values |= {"cpu_hall": cluttered[factor]["cells"] / near["cells"], "cpu_hold": far["cells"] / near["cells"]}
            assumed = {"floor": floor, "coefficients": kind_name, "noise": noise, "threshold": factor,
                       "turn at [m]": turn, "height in the hold [m]": height}  # fmt: skip
            sets.append({"set": assumed, "values": {name: float(values[name]) for name in STATEMENTS}})
        file.write_text(json.dumps(sets))


@cache
def chosen() -> dict[str, Any]:
    """Return what this project ships."""
    return {"floor": "floor and ceiling", "coefficients": "shipped", "noise": NOISES[0], "threshold": 1.0,
            "turn at [m]": TURNS_M[0], "height in the hold [m]": HEIGHTS_M[0]}  # fmt: skip


def table(sets: list[dict[str, Any]]) -> str:
    """Return the best set, the posterior of each assumption, and each statement in the sets, as Markdown."""
    z = np.array([[w.z(each["values"][name]) for name, w in STATEMENTS.items()] for each in sets])
    misfit = (z**2).sum(1)
    widened = max(misfit.min() / len(STATEMENTS), 1.0)
    weight = np.exp(-(misfit - misfit.min()) / 2 / widened)
    weight /= weight.sum()
    best, ours = int(misfit.argmin()), next(i for i, each in enumerate(sets) if each["set"] == chosen())
    most = int((z == 0).sum(1).argmax())
    lines = ["| assumption | shipped | best set | posterior |", "|---|---|---|---|"]
    for name in chosen():
        options = list(dict.fromkeys(each["set"][name] for each in sets))
        shares = [weight[[each["set"][name] == option for each in sets]].sum() for option in options]
        told = ", ".join(f"{o} {s:.2f}" for o, s in zip(options, shares, strict=True) if s >= 0.005)
        lines.append(f"| {name} | {chosen()[name]} | {sets[best]['set'][name]} | {told} |")
    lines.append(f"| misfit | {misfit[ours]:.1f} | {misfit[best]:.1f} | |")
    lines.append(f"| statements met, of {len(STATEMENTS)} | {(z[ours] == 0).sum()} | {(z[best] == 0).sum()} | "
                 f"most in any set: {(z[most] == 0).sum()} |")  # fmt: skip
    lines += ["", "| thesis | statement | wanted | shipped | best set | sets that meet it | shipped: at thresholds |",
              "|---|---|---|---|---|---|---|"]  # fmt: skip
    for k, (name, w) in enumerate(STATEMENTS.items()):
        wanted = f">= {w.low:g}" if np.isfinite(w.low) else f"<= {w.high:g}"
        lines.append(f"| {w.where} | {w.text} | {wanted}, σ {w.sigma:g} | {sets[ours]['values'][name]:.3g} | "
                     f"{sets[best]['values'][name]:.3g} | {100 * (z[:, k] == 0).mean():.0f} % | "
                     f"{span(sets, name, w)} |")  # fmt: skip
    return "\n".join(lines)


def span(sets: list[dict[str, Any]], name: str, wanted: Wanted) -> str:
    """Return the thresholds about the printed one between which a statement holds in the shipped set."""
    values = {f: next(e["values"][name] for e in sets if e["set"] == chosen() | {"threshold": f}) for f in FACTORS}
    holds = {factor: wanted.z(value) == 0 for factor, value in values.items()}
    if not holds[1.0]:
        return "never" if not any(holds.values()) else ", ".join(f"{f:g}" for f in FACTORS if holds[f]) + " times"
    low = list(itertools.takewhile(lambda f: holds[f], [f for f in FACTORS[::-1] if f <= 1]))[-1]
    high = list(itertools.takewhile(lambda f: holds[f], [f for f in FACTORS if f >= 1]))[-1]
    return f"{low:g} to {high:g} times"


if __name__ == "__main__":
    if len(sys.argv) != 2:
        sys.exit(__doc__)
    file = Path(sys.argv[1])
    if not file.exists():
        measure(file, lambda text: print(text, file=sys.stderr, flush=True))
    print(table(json.loads(file.read_text())))
