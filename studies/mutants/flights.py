"""Which broken method, world or flight fells which statement about detection, maps and causes (thesis 4 to 7)."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np

from studies.mutants.spoilt import (
    Fleet,
    Material,
    Mutant,
    Patch,
    Section,
    again,
    elfes_as,
    far_apex,
    lobe,
    longer,
    no_average,
    no_max_range,
    no_noise,
    parabola,
    part_of,
    ranges_too_long,
    rays_as,
    short_axis,
    term,
)
from studies.thesis import (
    baseline,
    cpu_causes,
    detection,
    detection_laws,
    hall,
    hold,
    image_causes,
    map_causes,
    room,
)
from studies.thesis.targets import TARGETS, radars, strafe
from studies.thesis.variants import without_models
from studies.thesis.workspace import Flown, Workspace
from ullage.processing.elfes import ElfesMapper
from ullage.processing.occupancy import Mapper
from ullage.radar.simulate import simulate
from ullage.world.library import WORLDS, World
from ullage.world.materials import material
from ullage.world.scene import Scene


def world_as(change: Callable[[str, Scene], Scene]) -> Callable[[Patch], None]:
    """Other things in the worlds that are loaded."""

    def spoil(patch: Patch) -> None:
        kept = World.scene
        patch.setattr(World, "scene", lambda world: change(world.name, kept(world)))

    return spoil


def unturned(patch: Patch) -> None:
    """The plate at 45 deg stands as the facing one."""
    kept = World.scene
    patch.setattr(World, "scene", lambda world: kept(replace(world, name=world.name.replace("45", ""))))


def thick_wire(_: str, scene: Scene) -> Scene:
    return replace(scene, wires=replace(scene.wires, radius_m=np.full(len(scene.wires), 0.05)))


def steel_floor(scene: Scene) -> Scene:
    things = tuple(replace(t, material=material("metal")) if t.name.startswith("floor") else t for t in scene.objects)
    return replace(scene, objects=things)


# --- baseline: every term of the ray model, of Elfes' grid and of the apex


def part_of_baseline(name: str, part: Callable[[Workspace], None], *mutants: Mutant) -> Section:
    """Statements of one part of the baseline: a mutant is put into no other."""
    return Section(name, "baseline", lambda work, _: part(work), mutants)


BASELINE = (
    part_of_baseline("baseline: eq. 4.2", baseline.intensity,
        Mutant("eq. 4.2 without its cosine", ("turned by 45 deg",), term(cosine=0.0)),
        Mutant("eq. 4.2 without its range", ("the ray's area grows",), term(spread=0.0)),
        Mutant("eq. 4.2 with the range once", ("the ray's area grows",), term(spread=1.0)),
        Mutant("eq. 4.2 without the coefficient", ("a wooden plate",), term(coefficient=False)),
        Mutant("ranges 0.25 m too long", ("lie at their ranges",), ranges_too_long),
        Mutant("no moving average", ("local maxima", "white noise"), no_average),
        Mutant("no noise", ("white noise",), no_noise)),
    part_of_baseline("baseline: R_max", baseline.axis,
        Mutant("an axis that ends at 9.61 m", ("at 9.7 m, within R_max",), short_axis),
        Mutant("no maximum range", ("at 10.3 m, beyond R_max",), no_max_range)),
    part_of_baseline("baseline: openings", baseline.opening,
        Mutant("rays over 20 deg", ("rays: headings between",), rays_as(fov_deg=20.0)),
        Mutant("Elfes' lobe of 20 deg", ("part of the circle",), lobe(20.0)),
        Mutant("more than three times as many rays a side", ("no ray meets the post",), rays_as(rays_per_side=100))),
    part_of_baseline("baseline: readings", baseline.readings,
        Mutant("Elfes' lobe of 20 deg", ("cell by cell",), lobe(20.0)),
        Mutant("no cancelling by emptiness", ("cell by cell",), elfes_as(cancel=False)),
        Mutant("no normalising", ("cell by cell",), elfes_as(normalise=False)),
        Mutant("densities flat across the lobe", ("cell by cell",), elfes_as(flat=True)),
        Mutant("nothing is ever occupied", ("more likely occupied",), elfes_as(arc=False))),
    part_of_baseline("baseline: apex", baseline.vertex,
        Mutant("a parabola for the hyperbola", ("the apex of the fitted hyperbola",), parabola),
        Mutant("an apex 0.25 m too far", ("the apex of the fitted hyperbola",), far_apex)),
)  # fmt: skip


# --- detection: four targets, flown past and alone

TargetFlights = dict[str, dict[str, Flown]]


def four_targets(fleet: Fleet) -> TargetFlights:
    laws = {"thesis law": "", "physical law": "-physical"}
    return {world: {law: fleet(world + tail) for law, tail in laws.items()} for world in TARGETS}


def state_targets(work: Workspace, flights: TargetFlights) -> None:
    detection.ranges(work, flights)
    detection.places(work, flights)
    detection.levels(work, flights)


def all_longer(flights: TargetFlights) -> TargetFlights:
    return {world: {law: changed(one, longer(0.25)) for law, one in laws.items()} for world, laws in flights.items()}


def changed(flown: Flown, change: Callable[[Any], Any]) -> Flown:
    """Frames changed, the map left as it is."""
    return replace(flown, frames={name: change(part) for name, part in flown.frames.items()})


def wire_pass(_: Fleet) -> Scene:
    return WORLDS["ntnu-wire"].scene()


def state_clutter(work: Workspace, scene: Scene) -> None:
    detection_laws.clutter(work, scene, strafe("ntnu-wire"), np.array([0.0, 0.0, 1.1]))


def floor_stays(patch: Patch) -> None:
    patch.setattr(detection_laws, "suppress_floor", lambda frames: frames)


def no_wire(patch: Patch) -> None:
    kept = detection_laws.alone
    patch.setattr(detection_laws, "alone", lambda scene, name: Scene.empty() if "wire" in name else kept(scene, name))


def noise_stays(patch: Patch) -> None:
    patch.setattr(detection_laws, "radars", lambda: radars()[:1] * 2)


def one_reflection(patch: Patch) -> None:
    kept = detection_laws.simulate
    patch.setattr(
        detection_laws, "simulate", lambda *a, **k: kept(*a, **{x: y for x, y in k.items() if x != "max_bounces"})
    )


def state_tail(work: Workspace, scene: Scene) -> None:
    detection_laws.tail(work, scene, strafe("ntnu-plate"))


DETECTION = (
    Section("targets, flown past", "detection", state_targets, (
        Mutant("ranges 0.25 m too long", (
            "facing plate, thesis law: the maximum", "facing plate, physical law: the maximum", "square pole, physical",
            "wire, physical law: the maximum", "the wall behind the plate", "ray law: the apex of the hyperbola finds",
            "facing plate: back-projection", "plate at 45 deg: back-projection", "square pole: back-projection",
            "wire: back-projection",
        ), change=all_longer),
        Mutant("the plate at 45 deg is not turned", ("the facing plate over the turned one in",),
               change=lambda flights: flights | {"ntnu-plate45": flights["ntnu-plate"]}),
    ), four_targets),
    Section("targets alone", "detection", lambda work, _: detection_laws.brightness(work), (
        Mutant("the plate at 45 deg is not turned", (
            "the brightest target, thesis law", "the brightest target, physical law", "physical law: the turned plate",
            "turning the plate costs less",
        ), unturned),
        Mutant("eq. 4.2 without its cosine", ("the same, summed over range",), term(cosine=0.0)),
        Mutant("a wire of 5 cm radius", ("the wire is faint",), world_as(thick_wire)),
    )),
    Section("floor and wire", "detection", state_clutter, (
        Mutant("rays over 20 deg", ("the floor is received at the wire's range",), rays_as(fov_deg=20.0)),
        Mutant("a wire of 5 cm radius", ("the wire itself is mostly missed",), change=lambda s: thick_wire("", s)),
        Mutant("a floor of steel", ("as strong as the wire",), change=steel_floor),
        Mutant("the wire is not received", ("it is the wire that is received",), no_wire),
        Mutant("the floor is not suppressed", (
            "what is left of the floor's echo", "of the floor alone", "the floor's part in the whole room",
        ), floor_stays),
    ), wire_pass),
    Section("behind the last wall", "detection", state_tail, (
        Mutant("the radar's noise stays", ("nothing comes from beyond",), noise_stays),
        Mutant("one reflection only", ("echoes drag on",), one_reflection),
    ), lambda _: WORLDS["ntnu-plate"].scene()),
)  # fmt: skip


# --- maps: the NTNU room, the cluttered room, the hold

STEPS = {0.5: "ntnu-mapping-50cm", 0.2: "ntnu-mapping-20cm", 0.1: "ntnu-mapping", 0.05: "ntnu-mapping-5cm"}
Room = tuple[dict[float, Flown], Flown]


def four_grids(fleet: Fleet) -> Room:
    return {step: fleet(name) for step, name in STEPS.items()}, fleet("ntnu-mapping-physical")


def state_room(work: Workspace, material: Room) -> None:
    rays, waves = material
    assert waves.omap is not None
    room.state(work, rays, (waves.omap, waves.metrics))


def rays_again(change: Callable[[Any], Any] = lambda part: part) -> Callable[[Room], Room]:
    return lambda both: ({step: again(flown, change) for step, flown in both[0].items()}, both[1])


def waves_longer(both: Room) -> Room:
    return both[0], again(both[1], longer(0.4))


def fixed_bits(bits: int) -> Callable[[Patch], None]:
    return lambda patch: patch.setattr(room, "ElfesMapper", lambda grid, **_: ElfesMapper(grid, bits=bits))


ROOM = Section("maps of the NTNU room", "room", state_room, (
    Mutant("every map in cells of 0.1 m", ("0.5 m is unclear", "0.2 m gives more"),
           change=lambda both: (dict.fromkeys(both[0], both[0][0.1]), both[1])),
    Mutant("ray law, ranges 0.25 m too long", (
        "Elfes: the plate is on the map at 0.1 m", "the plate is on the map at 0.05 m",
        "from the true surface, median", "surface found at 0.1 m", "few falsely occupied cells",
    ), change=rays_again(longer(0.25))),
    Mutant("ray law, ranges 0.5 m too long", ("the plate is on the map at 0.2 m",), change=rays_again(longer(0.5))),
    Mutant("Elfes' lobe of 20 deg", ("space behind walls is mapped",), lobe(20.0), rays_again()),
    Mutant("physical law, ranges 0.4 m too long", (
        "ullage: the plate is on the map", "ullage's F1 over", "ullage: cells held known", "ullage: surface declared",
    ), change=waves_longer),
    Mutant("always one byte a cell", ("two values of 32 bits a cell",), fixed_bits(8)),
    Mutant("always 32 bits a value", ("the same with one byte a cell",), fixed_bits(32)),
), four_grids)  # fmt: skip

Hall = tuple[list[Flown], list[Flown]]


def two_runs(fleet: Fleet) -> Hall:
    return [fleet("cluttered-room"), fleet("cluttered-room-again")], [fleet("cluttered-room-physical")]


def state_hall(work: Workspace, both: Hall) -> None:
    hall.things(work, both[0][0], both[1][0])
    hall.smears(work, *both)


def nothing_there(flown: Flown) -> Flown:
    """The same flight round an empty hall, judged by the one with the seven things."""
    plan = flown.simulated
    bare = simulate(
        without_models(flown.scene, *hall.THINGS), flown.track, plan.rig, fidelity="thesis", seed=plan.scenario.seed
    )
    return again(replace(flown, frames=dict(bare)))


HALL = Section("maps of the cluttered room", "hall", state_hall, (
    Mutant("the seven things are not there", (
        "the stop sign is on the map", "the robot is on the map", "the control panel is on the map",
        "part of the postbox is on the map", "part of the dumpster is on the map", "smears the stop sign",
    ), change=lambda both: ([nothing_there(flown) for flown in both[0]], both[1])),
    Mutant("the same noise twice", ("two runs with other noise differ",),
           change=lambda both: ([both[0][0]] * 2, both[1])),
    Mutant("physical law, ranges 0.5 m too long", (
        "ullage: cells held known", "ullage's F1 over",
    ), change=lambda both: (both[0], [again(both[1][0], longer(0.5))])),
), two_runs)  # fmt: skip

Hovers = dict[str, Callable[[], hall.Hover]]
ENDING = slice(-120, None)


def three_hovers(fleet: Fleet) -> Hovers:
    rays, waves = fleet("cluttered-room"), part_of(fleet("cluttered-room-physical"), ENDING)
    return {
        hall.BY_FORMULAS: hall.hovered(rays, "elfes"),
        hall.CAPPED: hall.hovered(rays, "elfes", certain=hall.LIMITED),
        hall.OURS: hall.hovered(waves, "likelihood", count=60),
        "without a limit": hall.hovered(rays, "elfes", certain=1.0),
        "Elfes for ullage": hall.hovered(waves, "elfes", count=60),
    }


HOVER = Section("hovering in the cluttered room", "hall", hall.state_hovers, (
    Mutant("no reading counts while the drone stands", ("Elfes: hovering makes false cells",),
           change=lambda found: {k: replace(h, after=h.before, false=h.false[:1] * 2, at_person=h.at_person[:1] * 2)
                                 for k, h in found.items()}),
    Mutant("certainty without a limit", ("hovering beside the person makes cells",),
           change=lambda found: found | {hall.CAPPED: found["without a limit"]}),
    Mutant("Elfes' grid in place of ullage's mapper", ("ullage: hovering makes no false cell",),
           change=lambda found: found | {hall.OURS: found["Elfes for ullage"]}),
), three_hovers)  # fmt: skip


def hold_part(fleet: Fleet) -> tuple[Flown, Flown]:
    return fleet("cargo-hold", hold.LEG), fleet("cargo-hold-physical", hold.LEG)


HOLD = Section("the cargo hold", "hold", lambda work, both: hold.state(work, *both), (
    Mutant("ranges 0.5 m too long", ("cells held known", "ullage's F1 over"),
           change=lambda both: (both[0], again(both[1], longer(0.5)))),
    Mutant("ranges 0.4 m too long", ("surface declared free",),
           change=lambda both: (both[0], again(both[1], longer(0.4)))),
), hold_part)  # fmt: skip


def whole_lobe(patch: Patch) -> None:
    """Every reading looks at all cells within R_max."""

    class Whole(ElfesMapper):
        def update(self, frames):
            super().update(frames)
            self.traversed = slice(0, 200), slice(0, 200)

    patch.setattr(hold, "ElfesMapper", Whole)


def elfes_costs(patch: Patch) -> None:
    patch.setattr(hold, "Mapper", lambda grid, **_: Mapper(grid, method="elfes"))


FAR = Section("cost of a profile", "hold", lambda work, fleet: hold.far(work, fleet("cargo-hold", hold.LEG).track), (
    Mutant("every reading looks at the whole lobe", ("cells that a reading traverses",), whole_lobe),
    Mutant("Elfes' grid in place of ullage's mapper", ("a profile costs no more",), elfes_costs),
), lambda fleet: fleet)  # fmt: skip


# --- causes: one change at a time


def nothing_removed(patch: Patch) -> None:
    for module in (image_causes, map_causes):
        patch.setattr(module, "without_models", lambda scene, *_: scene)


def threshold_ignored(patch: Patch) -> None:
    patch.setattr(map_causes, "ElfesMapper", lambda grid, threshold=None, **options: ElfesMapper(grid, **options))


def steady_hand(patch: Patch) -> None:
    kept = image_causes.find_scenario
    patch.setattr(image_causes, "find_scenario", lambda name, options=(): kept(
        name, options=[*options, "flight.vehicle=ideal", "flight.wander_m=0", "flight.wander_deg=0"]))  # fmt: skip


def state_causes(work: Workspace, _: Material) -> None:
    for part in (image_causes.brightness, image_causes.wire, map_causes.east_wall, map_causes.cluttered):
        part(work)


CAUSES = (
    Section("one change at a time", "causes", state_causes, (
        Mutant("nothing is taken out of the world", (
            "the wall behind the targets outshines", "the half-pipe at the wire is worth", "without floor and ceiling",
        ), nothing_removed),
        Mutant("a wire of 5 cm radius", ("the wire adds to the image",), world_as(thick_wire)),
        Mutant("the threshold is not changed", ("with twice the threshold", "a quarter of the threshold"),
               threshold_ignored),
    )),
    Section("flown by hand", "causes", lambda work, _: image_causes.by_hand(work), (
        Mutant("an ideal vehicle that does not wander", ("the wire's place in the image darkens",), steady_hand),
    )),
)  # fmt: skip


READING_COSTS = {"compiled": {"NTNU room": (17e-6, 834.0), "cargo hold": (40e-6, 3350.0),
                              "cargo hold, no echoes": (66e-6, 8337.0)},
                 "plain": {"NTNU room": (1.12e-3, 834.0), "cargo hold": (4.17e-3, 3350.0),
                           "cargo hold, no echoes": (6.63e-3, 8337.0)}}  # fmt: skip
"""CPU of a reading [s] and its cells, as on the page."""

CPU = Section("CPU of a reading", "causes", lambda work, costs: cpu_causes.state(work, **costs), (
    Mutant("readings without echoes end where walls are", ("without echoes passes",),
           change=lambda costs: costs | {"compiled": costs["compiled"] | {
               "cargo hold, no echoes": costs["compiled"]["cargo hold"]}}),
), lambda _: READING_COSTS)  # fmt: skip


FLIGHTS: tuple[Section, ...] = (*DETECTION, ROOM, HALL, HOVER, HOLD, FAR, *CAUSES, CPU)
