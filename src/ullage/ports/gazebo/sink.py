"""Publish frames from any source on Gazebo's topics."""

from __future__ import annotations

from typing import Any, Literal

from pydantic import Field

from ullage.data import Frames
from ullage.ports.cosimulation import PacedSink, SimulatorSinkOptions, options_of
from ullage.ports.gazebo.peer import Peer
from ullage.ports.gazebo.topics import RadarTopics
from ullage.ports.gazebo.wire import gz


class SinkOptions(SimulatorSinkOptions):
    """Options of `--to gazebo:`."""

    messages: Literal["gz", "ignition"] = Field("gz", description="ignition for Fortress and before")
    clock: str = Field("/clock", description="topic of the frames' clock; empty: none")
    partition: str | None = Field(None, description="none: GZ_PARTITION, or this host and user")


class GazeboSink(PacedSink):
    """Publish frames at the rate of their own clock.

    Args:
        address: unused; `gazebo:` alone.
        options: as listed in `SinkOptions`.

    Raises:
        InputError: an option is not valid.
        MissingExtra: pyzmq or protobuf is not installed.
    """

    def __init__(self, address: str, options: dict[str, Any]) -> None:
        chosen = options_of(SinkOptions, options, f"gazebo:{address}")
        super().__init__(chosen.pace)
        package = "gz.msgs" if chosen.messages == "gz" else "ignition.msgs"
        self._peer, self._clock = Peer(chosen.host, chosen.partition), chosen.clock
        self._topics = RadarTopics(self._peer, chosen.model, package)
        if self._clock:
            self._peer.advertise(self._clock, f"{package}.Clock")

    def tick(self, t_ns: int) -> None:
        """Publish the clock."""
        if self._clock:
            self._peer.publish(self._clock, gz().Clock(sim=gz().Time(sec=t_ns // 10**9, nsec=t_ns % 10**9)))

    def give(self, frames: Frames) -> None:
        """Publish some frames."""
        self._topics.write(frames)

    def close(self) -> None:
        """Leave the network."""
        self._peer.close()
