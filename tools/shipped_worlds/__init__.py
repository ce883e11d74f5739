"""What stands in each of the shipped worlds; `write_worlds` writes them as SDF."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial

from shipped_worlds.bodies import car, person, robot
from shipped_worlds.furniture import control_panel, dumpster, postbox, stop_sign
from shipped_worlds.plant import ballast_tank, lying_tank, pipe_rack, sewer, silo
from shipped_worlds.rooms import Opening, cameras, plate_parts, pole_parts, room_parts, wire_parts
from ullage.world.hold import HoldPlan, hold_parts
from ullage.world.solids import Part, Solid


@dataclass(frozen=True, slots=True)
class Model:
    """A thing of one or several solids, put down on the floor and turned about the vertical."""

    name: str
    solids: tuple[Solid, ...]
    position_m: tuple[float, float, float] = (0.0, 0.0, 0.0)
    yaw_deg: float = 0.0


NTNU_M = (8.0, 6.0, 3.0)
NTNU_OPENINGS = {
    "wall_south": (Opening("door", 2.6, 0.9, 2.1),),
    "wall_north": tuple(Opening(f"window_{k + 1}", 2.4 * (k - 1), 1.5, 1.3, sill_m=0.9) for k in range(3)),
}
CLUTTERED_M = (12.0, 10.0, 4.0)
CLUTTERED_OPENINGS: dict[str, tuple[Opening, ...]] = {"wall_west": (Opening("gate", -1.0, 2.4, 2.6, recess_m=0.2),)}


def apart(solids: list[Solid] | list[Part]) -> list[Model]:
    """Each solid as a model of its own."""
    return [Model(solid.name, (solid,)) for solid in solids]


def ntnu_room() -> list[Model]:
    """The motion-capture room, empty: concrete, a door, three windows, six cameras under the ceiling."""
    return [*apart(list(room_parts(NTNU_M, NTNU_OPENINGS))), Model("motion_capture", tuple(cameras(NTNU_M)))]


def ntnu_plate() -> list[Model]:
    """The room with a steel plate in its middle, facing west."""
    return [*ntnu_room(), Model("steel_plate", tuple(plate_parts()))]


def ntnu_plate45() -> list[Model]:
    """The room with the plate turned by 45 degrees."""
    return [*ntnu_room(), Model("steel_plate", tuple(plate_parts()), yaw_deg=45.0)]


def ntnu_pole() -> list[Model]:
    """The room with a square steel pole on a wooden box, held by a plastic half-pipe."""
    return [*ntnu_room(), Model("steel_pole", tuple(pole_parts()))]


def ntnu_wire() -> list[Model]:
    """The room with a steel wire against a plastic half-pipe."""
    return [*ntnu_room(), Model("steel_wire", tuple(wire_parts()))]


def ntnu_mapping() -> list[Model]:
    """The room with the plate toward its eastern end, for mapping."""
    return [*ntnu_room(), Model("steel_plate", tuple(plate_parts()), position_m=(1.6, 0.0, 0.0))]


def cluttered_room() -> list[Model]:
    """A hall with a car, a postbox, a stop sign, a person, a robot, a control panel and a dumpster."""
    things: list[tuple[Callable[[], list[Part]], float, float, float]] = [
        (car, 2.6, 3.5, 180.0),
        (postbox, -5.2, 4.2, -45.0),
        (stop_sign, 5.0, -4.0, 135.0),
        (person, -1.4, 0.1, 180.0),
        (robot, 1.4, -0.1, 60.0),
        (control_panel, 5.4, 0.2, 180.0),
        (dumpster, -4.7, -3.7, 45.0),
    ]
    room = apart(list(room_parts(CLUTTERED_M, CLUTTERED_OPENINGS)))
    return room + [Model(make.__name__, tuple(make()), (x, y, 0.0), yaw) for make, x, y, yaw in things]


def cargo_hold() -> list[Model]:
    """A bulk carrier's hold, 30 x 20 x 12 m."""
    return apart(hold_parts(HoldPlan()))


def _each_apart(make: Callable[[], list[Solid]]) -> list[Model]:
    return apart(make())


BUILDERS: dict[str, Callable[[], list[Model]]] = {
    make.__name__.replace("_", "-"): make
    for make in (
        ntnu_room, ntnu_plate, ntnu_plate45, ntnu_pole, ntnu_wire, ntnu_mapping, cluttered_room, cargo_hold,
    )
} | {
    make.__name__.replace("_", "-"): partial(_each_apart, make)
    for make in (ballast_tank, lying_tank, pipe_rack, sewer, silo)
}  # fmt: skip
