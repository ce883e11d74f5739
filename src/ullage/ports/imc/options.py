"""Options of an IMC port: `imc:place?key=value`."""

from __future__ import annotations

import re
from typing import Any, Literal

from pydantic import Field, field_validator

from ullage.errors import InputError
from ullage.ports import drone
from ullage.ports.cosimulation import SensingOptions
from ullage.ports.drone import CommandOptions, DroneOptions, Takes
from ullage.ports.imc.table import Table, from_xml, own
from ullage.ports.live import point_of
from ullage.ports.ned import TRONDHEIM, Geodetic, datum_of
from ullage.ports.network import Place, place_of
from ullage.specs import Spec

PLACES = "tcp://HOST:PORT (7001), udp://HOST:PORT (6002), or nothing: whoever announces itself"
PORTS = {"tcp": 7001, "udp": 6002}


class LinkOptions(Spec):
    """Our identity on the wire, and timeouts."""

    system_id: int = Field(0x9001, ge=1, lt=0xFFF0, description="our address; 0x9000 on: sensors of others than LSTS")
    name: str = Field("ullage", min_length=1, max_length=64, pattern=r"[^;=\n]+")
    port: int = Field(6101, ge=0, le=65535, description="where we listen for UDP; the next free one is taken")
    interface: str = Field("127.0.0.1", description="address of the interface for UDP and discovery")
    silence_s: float = Field(
        15.0, gt=0.1, le=3600, description="a peer that says nothing for so long is taken for dead"
    )
    reconnect: bool = True
    xml: str = Field("", description="an IMC.xml, for messages that our table lacks")

    @field_validator("system_id", mode="before")
    @classmethod
    def _hexadecimal(cls, value: Any) -> Any:
        hexadecimal = isinstance(value, str) and re.fullmatch(r"0[xX][0-9a-fA-F]{1,8}", value)
        return int(value, 16) if hexadecimal else value

    def table(self) -> Table:
        """The messages to speak."""
        return from_xml(self.xml) if self.xml else own()


class PlaceOptions(LinkOptions):
    """Geodetic place of the world."""

    origin: str = Field("", description="latitude, longitude [deg], height [m] of the world's origin")
    labels: str = Field("", description="names of the radars as others see them: front=Nose,left=Port")

    def place(self) -> Geodetic | None:
        """The origin, where it is given.

        Raises:
            InputError: it is not two or three numbers within bounds.
        """
        return datum_of(self.origin, "origin") if self.origin else None

    def entity_labels(self) -> dict[str, str]:
        """Label of each sensor that was given one."""
        pairs = [part.partition("=") for part in self.labels.split(",") if part]
        if bad := next((a for a, sign, b in pairs if not (a and sign and b)), None):
            raise InputError(f"labels at {bad!r}", where="imc", allowed="sensor=Label,sensor=Label")
        return {a.strip(): b.strip() for a, _, b in pairs}


class PoseOptions(PlaceOptions):
    """Options of the poses of a vehicle."""

    vehicle: str = Field(
        "", description="name or number of the system to follow; none: the first that says where it is"
    )
    state: Literal["EstimatedState", "SimulatedState"] = "EstimatedState"


class FollowOptions(PoseOptions):
    """A vehicle on the bus, and how heights are told to it."""

    z: Literal["height", "altitude", "depth"] = Field("height", description="how heights are told to the vehicle")


class VehicleOptions(FollowOptions, drone.VehicleOptions):
    """The same in the loop with radars and guard: it takes places."""

    takes: Takes = "pose"


class SourceOptions(FollowOptions, SensingOptions, DroneOptions, CommandOptions):
    """Options of a source on the bus."""

    world: str = Field(
        "", description="a library world or a file: radars are simulated; none: recorded frames are taken"
    )
    mission: str = Field(
        "", description="lead the vehicle along x,y,z;x,y,z... [m], or along the world's own waypoints: world"
    )
    relay: bool = Field(True, description="pass on every message to ROS, whole and as the type that ROS has for it")
    typed: bool = Field(False, description="pass it on as the message of imc_msgs with its fields too")
    speed_m_s: float = Field(0.5, gt=0, le=50)
    near_m: float = Field(1.0, gt=0, le=1000, description="a waypoint this near is reached")
    fly: str = Field(
        "", description="be the vehicle that DUNE's controllers fly: hector, or a drone of others, as ros2:NAMESPACE"
    )
    timeout_s: float = Field(2.5, gt=0, le=60, description="hover when the controller says nothing for so long")
    start: str = Field("0,0,1", description="where it hovers at first: x,y,z [m], and yaw [deg] or not")
    state_hz: float = Field(20.0, gt=0, le=250, description="EstimatedStates a second, when flying")
    pace: float = Field(1.0, gt=0, le=100, description="times real time, when flying")

    def waypoints(self) -> list[tuple[float, ...]]:
        """The points of the mission, none where there is no mission.

        Raises:
            InputError: they are no points.
        """
        if self.mission == "world":
            from ullage.world.library import WORLDS

            if self.world not in WORLDS:
                raise InputError("mission=world needs a world of the library", where="imc", allowed=", ".join(WORLDS))
            return [tuple(point[:3]) for point in WORLDS[self.world].path_xyzyaw]
        return [point_of(part, "mission", where="imc") for part in self.mission.split(";") if part.strip()]


class MessageOptions(PlaceOptions):
    """Options that select the messages for frames."""

    distance: Literal["first_peak", "off"] = "first_peak"
    profile: bool = Field(True, description="SonarData")
    exact: bool = Field(True, description="DevDataBinary with every bit of the frame")
    truth: bool = Field(False, description="true poses too: in exact frames, and as SimulatedState")
    state: bool = Field(False, description="the body's poses as EstimatedState")

    def home(self) -> Geodetic:
        """The world's origin."""
        return self.place() or TRONDHEIM


class SinkOptions(MessageOptions):
    """Options of a sink on the bus."""

    pace: float = Field(1.0, ge=0, le=1000, description="times real time; 0: as fast as it comes")


class LogOptions(MessageOptions):
    """Options of a log that is written."""

    state: bool = Field(True, description="the body's poses as EstimatedState")
    truth: bool = Field(True, description="true poses too: in exact frames, and as SimulatedState")
    overwrite: bool = False


class LogSourceOptions(Spec):
    """Options of a log that is read."""

    vehicle: str = Field("", description="name or number of the system to follow; none: the one that logged")
    state: Literal["EstimatedState", "SimulatedState"] = "EstimatedState"
    origin: str = Field("", description="latitude, longitude [deg], height [m] of the world's origin")
    xml: str = Field("", description="an IMC.xml, for messages that our table lacks")


def endpoint(text: str) -> Place:
    """Return kind, host and port of a place; all are empty where the text is.

    Raises:
        InputError: it is none.
    """
    return place_of(text, PORTS, where="imc", allowed=PLACES) if text else Place("", "")
