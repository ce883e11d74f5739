"""Gazebo (gz-sim, Fortress and later): follow a model in its world, simulate its radars, give back what they see."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from ullage.ports.drone import Drone, DroneOptions, Takes
    from ullage.ports.protocol import Sink, Source

__all__ = ["open_drone", "open_sink", "open_source"]


def open_source(address: str, options: dict[str, Any]) -> Source:
    """Frames of radars on a model in a running Gazebo: `gazebo:WORLD?model=NAME&key=value`."""
    from ullage.ports.gazebo.source import source_of

    return source_of(address, options)


def open_sink(address: str, options: dict[str, Any]) -> Sink:
    """A place on Gazebo's topics for frames from anywhere: `gazebo:?model=NAME&key=value`."""
    from ullage.ports.gazebo.sink import GazeboSink

    return GazeboSink(address, options)


def open_drone(address: str, options: DroneOptions, takes: Takes) -> Drone:
    """A model with a velocity controller, to be commanded: `gazebo:MODEL`.

    Raises:
        InputError: there is no model's name, or poses are asked for.
        MissingExtra: pyzmq or protobuf is not installed.
    """
    from ullage.errors import InputError
    from ullage.ports.gazebo.drone import GazeboDrone

    if takes == "pose":
        raise InputError("Gazebo's multicopters take no poses", where=f"gazebo:{address}", allowed="takes=velocity")
    return GazeboDrone(address, options)
