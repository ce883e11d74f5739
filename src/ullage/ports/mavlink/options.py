"""Options of a MAVLink port: `mavlink:place?key=value`."""

from __future__ import annotations

import re
from typing import Literal

from pydantic import Field

from ullage.ports import network
from ullage.ports.cosimulation import RadarOptions
from ullage.ports.drone import VehicleOptions
from ullage.ports.network import MOST_PORT, Place
from ullage.specs import Spec

PORTS = {"udp": 0, "udpin": 0, "tcp": 0}
SERIAL = re.compile(r"serial://(/?[^\s?]+)")
PLACES = "udp://HOST:PORT (send there), udpin://HOST:PORT (listen there), tcp://HOST:PORT, or serial:///dev/NAME"
OBSTACLE_AVOIDANCE = 196
"""MAV_COMP_ID_OBSTACLE_AVOIDANCE."""


def place_of(text: str) -> Place:
    """Return the place of an autopilot; of a serial line its host is the device.

    Raises:
        InputError: it is none, or its port is out of range.
    """
    if serial := SERIAL.fullmatch(text):
        return Place("serial", serial[1])
    return network.place_of(text, PORTS, where="mavlink", allowed=PLACES)


class LinkOptions(Spec):
    """The connection, and the ids on it."""

    vehicle: int = Field(0, ge=0, le=255, description="system id of the autopilot; 0: the first that sends HEARTBEAT")
    system_id: int = Field(0, ge=0, le=255, description="our own system id; 0: that of the autopilot")
    component_id: int = Field(OBSTACLE_AVOIDANCE, ge=1, le=255, description="our own component id")
    port: int = Field(0, ge=0, le=MOST_PORT, description="local UDP port; 0: any that is free")
    interface: str = Field("", description="local address for UDP; none: the one that reaches the place")
    baud: int = Field(57600, ge=1200, le=4_000_000, description="speed of the serial line")
    heartbeat_s: float = Field(5.0, gt=0.1, le=3600, description="without HEARTBEAT for so long the autopilot is lost")


class PoseOptions(LinkOptions):
    """Poses that come from the autopilot."""

    poses: Literal["auto", "odometry", "local"] = Field(
        "auto", description="ODOMETRY, or LOCAL_POSITION_NED with ATTITUDE; auto: ODOMETRY where it comes"
    )
    origin: str = Field("", description="the autopilot's local origin in the world: x,y,z [m] and, if given, yaw [deg]")
    request_hz: float = Field(50.0, ge=0, le=500, description="poses a second that are asked for; 0: do not ask")
    wait_s: float = Field(30.0, gt=0, le=86400, description="without a first HEARTBEAT for so long the run ends")


class SourceOptions(RadarOptions, PoseOptions):
    """Radars simulated along the autopilot's poses."""

    stagger: bool = Field(
        True, description="another pulse interval in every second frame, so that folded echoes jump from frame to frame"
    )


class DroneOptions(VehicleOptions, PoseOptions):
    """The autopilot's vehicle, commanded by set-points."""


class SinkOptions(LinkOptions):
    """Options of the distances sent to the autopilot."""

    pace: float = Field(1.0, ge=0, le=1000, description="times real time, for frames that are not of the present")
    obstacle_hz: float = Field(20.0, ge=1, le=200, description="most OBSTACLE_DISTANCE a second; autopilots want 10")
    sensors: bool = Field(True, description="DISTANCE_SENSOR for each radar too")
    guard: Literal["off", "brake"] = Field(
        "off", description="brake: switch ArduCopter from Auto, Guided or Loiter to BRAKE before an obstacle"
    )
    hull_m: float = Field(0.4, gt=0, le=10, description="of the guard: from the body's centre to its farthest part")
    stop_s: float = Field(
        1.5, gt=0, le=5, description="of the guard: time constant of a stop in BRAKE, 7.5 m/s^2 / PSC_JERK_XY"
    )
    wait_s: float = Field(
        0.0, ge=0, le=86400, description="wait so long for a first HEARTBEAT and end without one; 0: send at once"
    )
