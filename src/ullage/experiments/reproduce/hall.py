"""Mapping the cluttered room (thesis 6.2): twice with other noise; smears, ghosts in hover, space behind walls."""

from __future__ import annotations

import numpy as np

from ullage.data import Frames, Trajectory
from ullage.experiments.reproduce.bench import Bench, Flown
from ullage.experiments.reproduce.maps import HEAD, false_cells, middle_of, row_of, show_world, walls_of
from ullage.grids import OccupancyMap
from ullage.processing.occupancy import Mapper
from ullage.radar.simulate import simulate
from ullage.view.thesis_maps import Panel, draw_panels

SMALL_THINGS = ("postbox", "stop_sign")
HOVER_S = 20.0


def run(bench: Bench) -> None:
    """Two runs with each method, then a while of hovering; figures 6.11, 6.12b and 6.14."""
    show_world(
        bench, "cluttered-room", bench.folder / "world.png", "figures 6.11 and 6.12b",
        "The cluttered room without near walls and roof, and the path flown.",
    )  # fmt: skip
    seconds = ("", "-again")[: 1 if bench.quick else 2]
    rays = [bench.fly(f"cluttered-room{tail}") for tail in seconds]
    waves = [] if bench.quick else [bench.fly(f"cluttered-room-physical{tail}") for tail in seconds]
    marks = np.array([middle_of(rays[0].scene, name) for name in SMALL_THINGS])
    panels, rows = [], []
    for method, runs in (("Elfes", rays), ("ullage", waves)):
        line = []
        for number, flown in enumerate(runs, 1):
            if flown.omap is not None:
                line.append(Panel(f"{method}, run {number}", flown.omap, flown.track, marks))
                rows.append(row_of(f"{method}, run {number}", flown.omap, flown.metrics))
        panels += [line] if line else []
    path = bench.folder / "maps.png"
    draw_panels(path, panels, walls=walls_of(rays[0]), title="The cluttered room mapped, two runs", width_in=5.0)
    bench.findings.show(
        path, "figure 6.14", "The cluttered room mapped twice, 0.1 m. Above, Elfes' grid on ray frames; below, "
        "ullage's mapper on physical frames. Circled: postbox and stop sign.",
    )  # fmt: skip
    bench.findings.tabulate("Scores", HEAD, rows)
    _smears(bench, rays, waves)
    _hovering(bench, rays[0], waves[0] if waves else None)


def _smears(bench: Bench, rays: list[Flown], waves: list[Flown]) -> None:
    hold = bench.findings.hold
    smear = {}
    for method, runs in (("Elfes", rays), ("ullage", waves)):
        for name in SMALL_THINGS:
            counts = [false_cells(f.omap, f, around=[middle_of(f.scene, name)]) for f in runs if f.omap is not None]
            smear[method, name] = float(np.mean(counts)) if counts else np.nan
            bench.findings.numbers[f"{method} smear {name}"] = smear[method, name]
    for name in SMALL_THINGS:
        if waves:
            hold(f"ullage: false cells round the {name.replace('_', ' ')} over Elfes'", "7.2",
                 smear["ullage", name] - smear["Elfes", name], "cells", high=0)  # fmt: skip
    hold("Elfes smears or doubles postbox and stop sign (false cells within 1.2 m)", "7.2",
         sum(smear["Elfes", name] for name in SMALL_THINGS), "cells", low=5)  # fmt: skip
    if len(rays) > 1 and rays[0].omap is not None and rays[1].omap is not None:
        hold("Elfes: two runs with other noise differ (cells that are occupied in one of them only, share)", "7.2",
             _unlike(rays[0].omap, rays[1].omap), low=0.005)  # fmt: skip
    hold("Elfes: cells held known over 0.3 m behind a surface (share)", "7.2", rays[0].number("known_behind"), high=1)
    if waves:
        hold(
            "ullage: cells held known over 0.3 m behind a surface (share)",
            "beyond",
            waves[0].number("known_behind"),
            high=0.005,
        )
        hold("ullage's F1 over Elfes'", "beyond", waves[0].number("f1") - rays[0].number("f1"), low=0.0)


def _unlike(first: OccupancyMap, second: OccupancyMap) -> float:
    either = first.occupied | second.occupied
    return float(np.sum(first.occupied ^ second.occupied) / max(either.sum(), 1))


def _hovering(bench: Bench, rays: Flown, waves: Flown | None) -> None:
    """The drone waits where the flight ends: what that does to the map already made."""
    rows, panels = [], []
    for method, flown in (("elfes", rays), ("ullage", waves)):
        if flown is None or flown.omap is None:
            continue
        name = "Elfes" if method == "elfes" else "ullage"
        bench.say(f"hovering, {name}")
        still = _at_end(flown, HOVER_S if method == "elfes" else 5.0)
        mapper = Mapper(flown.omap.grid, method=method)  # type: ignore[arg-type]
        mapper.update(flown.frames)
        before = mapper.map()
        mapper.update(still)
        after = mapper.map()
        grown = false_cells(after, flown) - false_cells(before, flown)
        rows.append(
            (
                name,
                f"{len(next(iter(still.values())))}",
                str(false_cells(before, flown)),
                str(false_cells(after, flown)),
            )
        )
        panels += [
            Panel(f"{name}, on arrival", before, flown.track),
            Panel(f"{name}, after hovering", after, flown.track),
        ]
        if method == "elfes":
            bench.findings.hold("Elfes: hovering makes false cells", "7.2", grown, "cells", low=1)
        else:
            bench.findings.hold("ullage: hovering makes no false cell", "beyond", grown, "cells", high=0)
    path = bench.folder / "hover.png"
    pairs = [panels[k : k + 2] for k in range(0, len(panels), 2)]
    draw_panels(path, pairs, walls=walls_of(rays), title="Waiting at the end of the flight", width_in=5.0)
    bench.findings.show(
        path, "figure 6.14", "The same maps before and after the drone waits at the end of its path: the thesis "
        "reports cells along the lobe that become occupied.",
    )  # fmt: skip
    bench.findings.tabulate(
        "Hovering", ("method", "frames of each radar", "false cells on arrival", "after hovering"), rows
    )


def _at_end(flown: Flown, hover_s: float) -> dict[str, Frames]:
    """Frames of a while of standing still at the end of a flight."""
    rate = 1e9 / float(np.median(np.diff(flown.track.t_ns)))
    count = round(hover_s * rate)
    end = flown.track[-1:]
    spread = np.zeros((count, 3))
    path = Trajectory(
        end.t_ns[0] + (np.arange(1, count + 1) * 1e9 / rate).astype(np.int64), end.position + spread,
        np.repeat(end.quat_xyzw, count, axis=0), spread, spread,
    )  # fmt: skip
    scenario = flown.simulated.scenario
    found = simulate(
        flown.scene, path, flown.simulated.rig, fidelity=scenario.sensing.fidelity, seed=scenario.seed + 1000
    )
    return dict(found)
