"""Entry points of the Gazebo port: `gazebo:WORLD?model=NAME&key=value`."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from ullage.ports.drone import Drone, DroneOptions, Takes
    from ullage.ports.protocol import Sink, Source

__all__ = ["open_drone", "open_sink", "open_source"]


def open_source(address: str, options: dict[str, Any]) -> Source:
    """Open radars on a model in a running Gazebo: `gazebo:WORLD?model=NAME&key=value`."""
    from ullage.ports.gazebo.source import source_of

    return source_of(address, options)


def open_sink(address: str, options: dict[str, Any]) -> Sink:
    """Open Gazebo's topics for frames from any source: `gazebo:?model=NAME&key=value`."""
    from ullage.ports.gazebo.sink import GazeboSink

    return GazeboSink(address, options)


def open_drone(address: str, options: DroneOptions, takes: Takes) -> Drone:
    """Open a model with a velocity controller: `gazebo:MODEL`.

    Raises:
        InputError: the model has no name, or `takes` is pose.
        MissingExtra: pyzmq or protobuf is not installed.
    """
    from ullage.errors import InputError
    from ullage.ports.gazebo.drone import GazeboDrone

    if takes == "pose":
        raise InputError("Gazebo's multicopters take no poses", where=f"gazebo:{address}", allowed="takes=velocity")
    return GazeboDrone(address, options)
