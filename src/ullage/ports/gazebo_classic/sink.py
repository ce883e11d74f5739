"""Publish frames from any source on gzserver's topics."""

from __future__ import annotations

from typing import Any

from pydantic import Field

from ullage.data import Frames
from ullage.ports.cosimulation import PacedSink, SimulatorSinkOptions, options_of
from ullage.ports.gazebo_classic.peer import ClassicPeer
from ullage.ports.gazebo_classic.topics import RadarTopics
from ullage.ports.gazebo_classic.wire import master_of


class SinkOptions(SimulatorSinkOptions):
    """Options of `--to gazebo-classic:`."""

    gazebo_world: str = Field("default", min_length=1, description="topics are /gazebo/WORLD/MODEL/radar/SENSOR/...")


class ClassicSink(PacedSink):
    """Publish frames at the rate of their own clock.

    Args:
        address: of the master; empty: GAZEBO_MASTER_URI, or this machine's usual port.
        options: as listed in `SinkOptions`.

    Raises:
        InputError: an option cannot be used.
        MissingExtra: protobuf is not installed.
    """

    def __init__(self, address: str, options: dict[str, Any]) -> None:
        chosen = options_of(SinkOptions, options, f"gazebo-classic:{address}")
        super().__init__(chosen.pace)
        self._peer = ClassicPeer(master_of(address), chosen.host)
        self._topics = RadarTopics(self._peer, chosen.gazebo_world, chosen.model)

    def give(self, frames: Frames) -> None:
        """Publish some frames."""
        self._topics.write(frames)

    def close(self) -> None:
        """Let go of the sockets."""
        self._peer.close()
