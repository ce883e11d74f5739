"""Find why the maps differ from the thesis' (figures 6.13 and 6.14), with one change at a time."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import replace
from typing import Any

import numpy as np

from studies.thesis.hall import THINGS, on_map
from studies.thesis.variants import OPENINGS, with_ray_settings, without_models
from studies.thesis.workspace import Flown, Workspace
from ullage.experiments.catalog import find_scenario
from ullage.experiments.simulated import Simulated, prepare
from ullage.grids import Grid
from ullage.processing.elfes import ElfesMapper
from ullage.radar.simulate import simulate
from ullage.specs import Rig
from ullage.world.library import WORLDS
from ullage.world.scene import Scene


def run(work: Workspace) -> None:
    """Run the experiments on the east wall of the NTNU room and on the objects in the cluttered room."""
    work.log("the east wall")
    east_wall(work)
    work.log("the cluttered room")
    cluttered(work)


def east_share(simulated: Simulated, *, step_m: float = 0.1, threshold: float | None = None) -> float:
    """Return the share of the east wall with an occupied cell of Elfes' map within two cells of 0.1 m."""
    scene, walls = simulated.scene, WORLDS["ntnu-mapping"].scene().bounds
    frames = simulate(scene, simulated.flown, simulated.rig, fidelity="thesis", seed=simulated.scenario.seed)
    mapper = ElfesMapper(Grid.covering(walls, step_m, margin_m=1.0), threshold=threshold)
    mapper.update(frames)
    omap = mapper.map()
    rows, columns = abs(omap.grid.y_m) < 2.9, abs(omap.grid.x_m - walls[1, 0]) < 0.21
    return float(omap.occupied[np.ix_(rows, columns)].any(1).mean())


def flown_to(x_m: float, y_m: float = 1.9, z_m: float = 1.1) -> Simulated:
    """Return the round through the NTNU room with other corners."""
    corners = [[-2.8, -y_m, z_m, 0], [x_m, -y_m, z_m, 0], [x_m, -y_m, z_m, 90], [x_m, y_m, z_m, 90],
               [x_m, y_m, z_m, 180], [-2.8, y_m, z_m, 180], [-2.8, y_m, z_m, 270], [-2.8, -y_m, z_m, 270]]  # fmt: skip
    return prepare(find_scenario("ntnu-mapping", options=[f"flight.waypoints={corners}"]))


def east_changes() -> Iterator[tuple[str, Callable[[], float]]]:
    """Return single changes, each with a function that measures the wall."""
    flight = prepare(find_scenario("ntnu-mapping"))

    def world(*names: str) -> Callable[[], float]:
        return lambda: east_share(replace(flight, scene=without_models(flight.scene, *names)))

    def rays(**changes: float) -> Callable[[], float]:
        return lambda: east_share(replace(flight, rig=with_ray_settings(flight.rig, **changes)))

    yield "as flown", lambda: east_share(flight)
    yield "without floor and ceiling", world("floor", "ceiling")
    yield "without the plate", world("steel_plate")
    yield "without the side walls", world("wall_north", "wall_south", *OPENINGS)
    yield "58 x 58 rays", rays(rays_per_side=58)
    yield "120 x 120 rays", rays(rays_per_side=120)
    yield "average over 9 bins", rays(smoothing_bins=9)
    yield "no noise", rays(noise_sigma=0.0)
    yield "threshold doubled, 0.076", lambda: east_share(flight, threshold=0.076)
    yield "threshold ten times, 0.38", lambda: east_share(flight, threshold=0.38)
    yield "cells of 0.2 m", lambda: east_share(flight, step_m=0.2)
    yield "cells of 0.05 m", lambda: east_share(flight, step_m=0.05)
    yield "0.4 m higher", lambda: east_share(flown_to(0.2, z_m=1.5))
    yield "0.7 m farther from the side walls", lambda: east_share(flown_to(0.2, y_m=1.2))
    yield "turning at x = 1 m in place of 0.2 m", lambda: east_share(flown_to(1.0))
    yield "turning at x = 2 m", lambda: east_share(flown_to(2.0))


IN_SMALL = ("as flown", "without floor and ceiling", "threshold doubled, 0.076")


def east_wall(work: Workspace) -> None:
    """Find why the east wall is not on the map (figure 6.13 c)."""
    found = {name: share() for name, share in east_changes() if not work.quick or name in IN_SMALL}
    work.results.add_table(
        "East wall occupied on Elfes' map, 0.1 m: one change at a time",
        ("change", "share"),
        [(name, f"{100 * share:.0f} %") for name, share in found.items()],
    )
    free, twice = found["without floor and ceiling"], found["threshold doubled, 0.076"]
    hold = work.results.add_statement
    hold("Elfes: without floor and ceiling the east wall is on the map (share)", "figure 6.13", free, low=0.9)
    hold("Elfes: with twice the threshold it is, too (share)", "figure 6.13", twice, low=0.9)
    also = ("turning at x = 1 m in place of 0.2 m", "turning at x = 2 m", "without the plate", "without the side walls")
    rest = "".join(f"{name[0].upper()}{name[1:]}: {100 * found[name]:.0f} %. " for name in also if name in found)
    work.results.add_difference(
        "figure 6.13 c", "\"the placement of the walls are correctly portrayed\"",
        f"{100 * found['as flown']:.0f} % of the east wall is occupied at 0.1 m",
        f"world and threshold: floor and ceiling echo before the wall, and pass 0.038. Without them "
        f"{100 * free:.0f} % of the wall is occupied, with twice the threshold {100 * twice:.0f} %. {rest}Ruled out: "
        "noise, cell size, a flight 0.4 m higher. More rays or a longer average help in part (table). "
        "The thesis prints neither the scale of its amplitudes nor the floor's coefficient, "
        "and its path only as a picture.",
    )  # fmt: skip


def cluttered(work: Workspace) -> None:
    """Find why car and person are hardly on the map (figure 6.14)."""
    flight = prepare(find_scenario("cluttered-room"))
    box = np.stack([np.minimum(flight.scene.bounds[0], flight.flown.position.min(0)),
                    np.maximum(flight.scene.bounds[1], flight.flown.position.max(0))])  # fmt: skip
    grid = Grid.covering(box, 0.1, margin_m=1.0)

    def mapped(
        scene: Scene = flight.scene, rig: Rig = flight.rig, by_turns: bool = False, **options: Any
    ) -> dict[str, float]:
        frames = dict(simulate(scene, flight.flown, rig, fidelity="thesis", seed=flight.scenario.seed))
        mapper, size = ElfesMapper(grid, **options), 1 if by_turns else len(flight.flown)
        for piece in zip(*(part.chunks(size) for part in frames.values()), strict=True):
            mapper.update(piece)
        done = Flown("cluttered-room", flight, frames, None, mapper.map(), {})
        return {name: on_map(done, name) for name in THINGS}

    found = {"as flown": mapped(), "a quarter of the threshold, 0.0095": mapped(threshold=0.0095)}
    if not work.quick:
        found |= {
            "half the threshold, 0.019": mapped(threshold=0.019), "twice the threshold, 0.076": mapped(threshold=0.076),
            "both values limited to 0.99": mapped(certain=0.99), "a lobe of 40 deg in the map": mapped(lobe_deg=40.0),
            "without floor and ceiling": mapped(without_models(flight.scene, "floor", "ceiling")),
            "58 x 58 rays": mapped(rig=with_ray_settings(flight.rig, rays_per_side=58)),
            "average over 9 bins": mapped(rig=with_ray_settings(flight.rig, smoothing_bins=9)),
            "no noise": mapped(rig=with_ray_settings(flight.rig, noise_sigma=0.0)),
            "the radars by turns, frame by frame": mapped(by_turns=True),
        }  # fmt: skip
    work.results.add_table(
        "Outlines on Elfes' map of the cluttered room: one change at a time",
        ("change", *(name.replace("_", " ") for name in THINGS)),
        [(name, *(f"{100 * share:.0f} %" for share in shares.values())) for name, shares in found.items()],
        note="Elfes' map depends on the order of the frames. Here each radar's whole record follows that of the radar "
        "before it. A run takes short pieces of all radars by turns, as the last row does.",
    )  # fmt: skip
    flown, low = found["as flown"], found["a quarter of the threshold, 0.0095"]
    work.results.add_statement(
        "Elfes: a quarter of the threshold brings the person on the map (share of its outline gained)",
        "figure 6.14",
        low["person"] - flown["person"],
        low=0.5,
    )
    work.results.add_difference(
        "figure 6.14", "\"most of the features in the room was still mapped accurately\"",
        f"stop sign, robot and panel are; of the car {100 * flown['car']:.0f} %, of the person "
        f"{100 * flown['person']:.0f} % of the outline at the height of the flight",
        f"threshold: at a quarter of 0.038 the person is mapped to {100 * low['person']:.0f} %, the car to "
        f"{100 * low['car']:.0f} %, but postbox to {100 * low['postbox']:.0f} and stop sign to "
        f"{100 * low['stop_sign']:.0f} %. Ruled out on arrival: the limit of 0.99, floor and ceiling, rays, average, "
        "noise. A narrower lobe helps the car (table). No one threshold maps all; the thesis' scale is not printed.",
    )  # fmt: skip
