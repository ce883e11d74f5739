"""What IMC commands ask of a multirotor, each against what it means in ENU."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest

from ullage.flight.live import Steered, Wish
from ullage.ports.imc.codec import Message, Packet, make
from ullage.ports.imc.helm import MANEUVERS, Commands
from ullage.ports.ned import Geodetic

ORIGIN = Geodetic.degrees(63.4185, 10.4009, 40.0)
CONTROLLER = 0x0803


class Craft:
    """Stands still and remembers."""

    def __init__(self, wish: Wish | None = None) -> None:
        self.wish, self.position = wish or Wish(), np.array([1.0, 2.0, 3.0])


def commands(craft: Craft | None = None, said: list[str] | None = None) -> Commands:
    return Commands(craft or Craft(), ORIGIN, (said if said is not None else []).append)


def asked(message: Message, craft: Craft | None = None) -> Wish | None:
    return commands(craft).wish(Packet(message, 1.7e9, CONTROLLER))


def at(east: float, north: float) -> dict[str, float]:
    there = ORIGIN.moved(np.array([north, east, 0.0]))
    return {"lat": there.lat_rad, "lon": there.lon_rad}


@pytest.mark.parametrize(
    ("name", "fields", "wish"),
    [
        ("DesiredZ", {"value": 42.5, "z_units": 3}, Wish(height_m=2.5)),
        ("DesiredZ", {"value": 2.5, "z_units": 2}, Wish(height_m=2.5)),
        ("DesiredZ", {"value": 2.5, "z_units": 1}, Wish(height_m=-2.5)),
        ("DesiredZ", {"value": 2.5, "z_units": 0}, None),
        ("DesiredSpeed", {"value": 0.5}, Wish(velocity_m_s=(0.5, 0.0))),
        ("DesiredSpeed", {"value": 50.0, "speed_units": 2}, None),
        ("DesiredHeading", {"value": 0.0}, Wish(heading_rad=math.pi / 2)),
        ("DesiredHeadingRate", {"value": 0.25}, Wish(turn_rad_s=-0.25)),
        ("DesiredVerticalRate", {"value": 0.5}, Wish(climb_m_s=0.5)),
        ("DesiredVelocity", {"u": 0.5, "v": 0.25, "flags": 3}, Wish(velocity_m_s=(0.5, -0.25))),
        ("DesiredVelocity", {"w": 0.5, "r": 0.25, "flags": 36},
         Wish(velocity_m_s=(0.0, 0.0), climb_m_s=-0.5, turn_rad_s=-0.25)),
        ("DesiredControl", {"z": -2.0, "flags": 4}, Wish(force_n=(0.0, 0.0, 2.0))),
        ("DesiredControl", {"k": -2.0, "flags": 8}, None),
        ("Abort", {}, Wish(height_m=3.0, velocity_m_s=(0.0, 0.0), turn_rad_s=0.0)),
        ("Brake", {"op": 1}, Wish(height_m=3.0, velocity_m_s=(0.0, 0.0), turn_rad_s=0.0)),
        ("Brake", {"op": 0}, None),
        ("IdleManeuver", {}, Wish(height_m=3.0, velocity_m_s=(0.0, 0.0), turn_rad_s=0.0)),
        ("DesiredZ", {"value": math.nan, "z_units": 3}, None),
        ("Temperature", {"value": 5.0}, None),
    ],
)  # fmt: skip
def test_set_points(name: str, fields: dict[str, Any], wish: Wish | None) -> None:
    assert asked(make(name, **fields)) == wish


@pytest.mark.parametrize("name", ["Goto", "Loiter", "StationKeeping", "StationKeepingExtended", "Takeoff"])
def test_maneuvers_go_to_a_place(name: str) -> None:
    wish = asked(make(name, **at(30.0, -20.0), z=45.0, z_units=3, speed=0.75))
    assert wish.position_m == pytest.approx((30.0, -20.0, 5.0), abs=1e-3)
    assert wish.speed_m_s == 0.75
    level = asked(make(name, **at(30.0, -20.0)))
    assert level.position_m == pytest.approx((30.0, -20.0, 3.0), abs=1e-3)  # as high as it is


def test_a_path_begins_here_or_where_it_says() -> None:
    there = at(10.0, 0.0)
    fields = {"end_lat": there["lat"], "end_lon": there["lon"], "end_z": 4.0, "end_z_units": 2, "speed": 0.5}
    wish = asked(make("DesiredPath", **fields))
    assert wish.position_m == pytest.approx((10.0, 0.0, 4.0), abs=1e-3)
    assert wish.from_m == (1.0, 2.0, 3.0)
    first = at(0.0, 5.0)
    fields |= {"start_lat": first["lat"], "start_lon": first["lon"], "start_z": 6.0, "start_z_units": 2, "flags": 1}
    assert asked(make("DesiredPath", **fields)).from_m == pytest.approx((0.0, 5.0, 6.0), abs=1e-3)
    level = asked(make("DesiredPath", **(fields | {"flags": 5})))
    assert (level.position_m[2], level.from_m[2]) == (3.0, 3.0)


def test_on_the_way_to_a_place_speeds_and_heights_change_the_way_there() -> None:
    craft = Craft(Wish(position_m=(5.0, 6.0, 7.0), speed_m_s=0.5))
    assert asked(make("DesiredSpeed", value=0.75), craft) == Wish(speed_m_s=0.75)
    faster = craft.wish.then(Wish(speed_m_s=0.75))
    assert (faster.position_m, faster.speed_m_s) == ((5.0, 6.0, 7.0), 0.75)
    higher = asked(make("DesiredZ", value=9.0, z_units=2), craft)
    assert (higher.position_m, higher.speed_m_s) == ((5.0, 6.0, 9.0), 0.5)


def test_a_reference_says_where_its_flags_are_set() -> None:
    z, speed = make("DesiredZ", value=4.0, z_units=2), make("DesiredSpeed", value=0.75)
    whole = asked(make("Reference", flags=7, z=z, speed=speed, **at(30.0, -20.0)))
    assert whole.position_m == pytest.approx((30.0, -20.0, 4.0), abs=1e-3)
    assert whole.speed_m_s == 0.75
    assert asked(make("Reference", flags=4, z=z)) == Wish(height_m=4.0)
    assert asked(make("Reference", flags=0, z=z)) is None
    there = Craft(Wish(position_m=(5.0, 6.0, 7.0)))
    assert asked(make("Reference", flags=4, z=z), there).position_m == (5.0, 6.0, 4.0)


@pytest.mark.parametrize("name", MANEUVERS)
def test_maneuvers_are_started_by_a_command_or_a_plan_and_answered(name: str) -> None:
    for request in (
        make("VehicleCommand", request_id=9, maneuver=make(name)),
        make("PlanControl", request_id=9, plan_id="p", arg=make(name)),
    ):
        wish, reply = commands().answer(Packet(request, 1.7e9, CONTROLLER))
        assert wish is not None
        assert (reply.name, reply["type"], reply["request_id"], reply["info"]) == (request.name, 1, 9, "")


def test_what_cannot_be_flown_is_refused_with_the_reason() -> None:
    rows = Packet(make("VehicleCommand", request_id=9, maneuver=make("Rows")), 1.7e9, CONTROLLER)
    wish, reply = commands().answer(rows)
    assert (wish, reply["type"]) == (None, 2)
    assert "does not fly Rows: Goto, Loiter" in reply["info"]
    wish, reply = commands().answer(Packet(make("VehicleCommand", command=2), 1.7e9, CONTROLLER))
    assert (wish, reply["info"]) == (None, "not supported")
    wish, reply = commands().answer(Packet(make("PlanControl", op=1), 1.7e9, CONTROLLER))
    assert (wish.velocity_m_s, reply["type"]) == ((0.0, 0.0), 1)
    assert commands().answer(Packet(make("VehicleCommand", type=1), 1.7e9, CONTROLLER)) is None
    assert commands().answer(Packet(make("DesiredZ"), 1.7e9, CONTROLLER)) is None


def test_other_units_of_speed_are_said_once() -> None:
    said: list[str] = []
    read = commands(said=said)
    for _ in range(3):
        read.wish(Packet(make("DesiredSpeed", value=50.0, speed_units=2), 1.7e9, CONTROLLER))
    assert said == ["DesiredSpeed is taken in m/s only"]


def test_our_multirotor_stays_on_the_path() -> None:
    """The rigid body itself, from beside a path of 8 m."""
    vehicle = Steered(start=(0.0, 1.0, 2.0))
    read = Commands(vehicle, ORIGIN, [].append)
    first, last = at(0.0, 0.0), at(8.0, 0.0)
    vehicle.ask(read.wish(Packet(make(
        "DesiredPath", start_lat=first["lat"], start_lon=first["lon"], start_z=2.0, start_z_units=2,
        end_lat=last["lat"], end_lon=last["lon"], end_z=2.0, end_z_units=2, speed=0.8, flags=1,
    ), 1.7e9, CONTROLLER)))  # fmt: skip
    path = []
    for k in range(1, 16 * 20):
        vehicle.advance(k * 50_000_000)
        path.append(vehicle.position)
    flown = np.array(path)
    assert np.abs(flown[flown[:, 0] > 4.0, 1]).max() < 0.05
    assert flown[-1] == pytest.approx([8.0, 0.0, 2.0], abs=0.05)
