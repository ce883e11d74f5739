"""The cargo hold (thesis 6.3): along its walls, 0.1 m cells; and what a mapper costs where nothing is in range."""

from __future__ import annotations

import numpy as np

from ullage.experiments.laws import radars
from ullage.experiments.reproduce.bench import Bench, Flown
from ullage.experiments.reproduce.maps import HEAD, row_of, show_world, walls_of
from ullage.grids import Grid
from ullage.processing.metrics import map_cost
from ullage.processing.occupancy import Mapper, Method
from ullage.radar.simulate import Fidelity, simulate
from ullage.specs import Rig
from ullage.view.thesis_maps import Panel, draw_panels
from ullage.world import scenes
from ullage.world.scene import Scene

LEG = "flight.waypoints=[[-11.5, -7, 4, 0], [-9, -7, 4, 0]]"
"""The first metres of the flight, for the small run."""
THESIS_RATIO = 128 / 0.4 / 15
"""CPU of the thesis' mapping node in the hold over that in the NTNU room, both at real time (tables 6.2, 6.4)."""


def run(bench: Bench) -> None:
    """The flight both ways, figures 6.15 to 6.18, and the cost far from everything."""
    show_world(
        bench, "cargo-hold", bench.folder / "world.png",
        "figures 6.15 to 6.17", "The hold, cut open, and the path flown.",
    )  # fmt: skip
    less = [LEG] if bench.quick else []
    rays = bench.fly("cargo-hold", less)
    waves = bench.fly("cargo-hold-physical", less)
    panels, rows = [], []
    for name, flown in (("Elfes, thesis law", rays), ("ullage, physical law", waves)):
        if flown.omap is not None:
            panels.append(Panel(name, flown.omap, flown.track))
            rows.append(row_of(name, flown.omap, flown.metrics))
    path = bench.folder / "maps.png"
    draw_panels(path, [panels], walls=walls_of(rays), title="The cargo hold mapped", width_in=6.4)
    bench.findings.show(
        path, "figure 6.18", "The hold mapped in flying along its walls, 0.1 m: the thesis' method on ray frames, "
        "ullage's mapper on physical frames of the same flight, ten a second. A straight line in the middle, where "
        "nothing stands, is a far wall: what comes from beyond 9.87 m the X4 hears at its range less 9.87 m; most of "
        "it is left ambiguous.",
    )  # fmt: skip
    bench.findings.tabulate("Scores", HEAD, rows)
    hold = bench.findings.hold
    hold("ullage: surface declared free (share)", "beyond", waves.number("surface_declared_free"), high=0.01)
    hold(
        "ullage: cells held known over 0.3 m behind a surface (share)",
        "beyond",
        waves.number("known_behind"),
        high=0.005,
    )
    if not bench.quick:
        hold("ullage's F1 over Elfes'", "beyond", waves.number("f1") - rays.number("f1"), low=0.0)
    _far(bench, rays)


def _far(bench: Bench, flown: Flown) -> None:
    """The same track in a room of 8 x 6 m and in empty space: CPU of each mapper for a profile."""
    bench.say("cost of a profile near and far")
    loud, _ = radars()
    rig = Rig.preset("thesis-4", radar=loud)
    track = flown.track[: 60 if bench.quick else 200]
    around = scenes.room(size_m=(8, 6, 3))
    middle = track.position.mean(0)
    shifted = Scene(around.vertices + middle, around.faces, around.face_object, around.objects)
    grid = Grid.covering(np.stack([track.position.min(0) - 12, track.position.max(0) + 12]), 0.1)
    rows = []
    methods: tuple[tuple[Method, str], ...] = (("elfes", "Elfes"), ("ullage", "ullage"))
    for method, name in methods:
        law: Fidelity = "thesis" if method == "elfes" else "physical"
        heard = [simulate(scene, track, rig, fidelity=law, seed=7) for scene in (shifted, Scene.empty())]
        taken = [
            [map_cost(Mapper(grid, method=method), frames)["cpu_mean"].value for frames in heard] for _ in range(5)
        ]
        costs = np.min(taken, axis=0)  # by turns, the least of five: other work on the machine only adds
        rows.append((name, f"{costs[0]:.3f}", f"{costs[1]:.3f}", f"{costs[1] / costs[0]:.2f}"))
        bench.findings.numbers[f"{method} far over near"] = costs[1] / costs[0]
    bench.findings.tabulate(
        "CPU for a profile [ms]", ("mapper", "walls 3 to 4 m away", "nothing in range", "far over near"), rows,
        note=f"The thesis' mapping node took {THESIS_RATIO:.0f} times as much in the hold as in the NTNU room, both at "
        "real time.",
    )  # fmt: skip
    far = bench.findings.numbers
    bench.findings.hold(
        "Elfes: a profile costs more where nothing is in range", "7.3", far["elfes far over near"], low=1.2
    )
    bench.findings.hold(
        "ullage: a profile costs no more where nothing is in range", "7.3", far["ullage far over near"], high=1.3
    )
