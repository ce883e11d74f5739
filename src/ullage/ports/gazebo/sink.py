"""Publish frames from any source on the topics of either Gazebo."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, Literal

from pydantic import Field

from ullage.data import Frames
from ullage.flow import Sink
from ullage.ports.gazebo.classic import ClassicPeer, master_of
from ullage.ports.gazebo.messages import gz
from ullage.ports.gazebo.topics import CLASSIC, RadarTopics
from ullage.ports.gazebo.transport import TransportPeer
from ullage.ports.live import options_of
from ullage.ports.protocol import Item
from ullage.ports.publisher import RateLimiter
from ullage.specs import Spec


class SimulatorSinkOptions(Spec):
    """Options of a sink that gives frames to a simulator."""

    model: str = Field("ullage", min_length=1, description="the model that is said to carry the radars")
    pace: float = Field(1.0, ge=0, le=1000, description="times real time; 0: as fast as can be")
    host: str = Field("127.0.0.1", description="address of the interface to use")


class TransportSinkOptions(SimulatorSinkOptions):
    """Options of `--to gazebo:`."""

    messages: Literal["gz", "ignition"] = Field("gz", description="ignition for Fortress and before")
    clock: str = Field("/clock", description="topic of the frames' clock; empty: none")
    partition: str | None = Field(None, description="none: GZ_PARTITION, or this host and user")


class ClassicSinkOptions(SimulatorSinkOptions):
    """Options of `--to gazebo-classic:`."""

    gazebo_world: str = Field("default", min_length=1, description="topics are /gazebo/WORLD/MODEL/radar/SENSOR/...")


class GazeboSink(Sink):
    """Publish frames at the rate of their own clock, in order of time; ignore everything else.

    Args:
        topics: take the frames; their peer is closed with the sink.
        pace: times real time; 0: as fast as can be.
        clock: topic of the frames' clock, which Transport alone takes; empty: none.
    """

    def __init__(self, topics: RadarTopics, pace: float, *, clock: str = "") -> None:
        self._limiter = RateLimiter(pace)
        self._topics, self._peer, self._clock = topics, topics.peer, clock
        if clock:
            self._peer.advertise(clock, f"{topics.package}.Clock")

    def write(self, item: Item) -> None:
        """Take frames."""
        parts = [item] if isinstance(item, Frames) else list(item.values()) if isinstance(item, Mapping) else []
        moments = [(int(part.t_ns[k]), n, k) for n, part in enumerate(parts) for k in range(len(part))]
        for t_ns, n, k in sorted(moments):
            self._limiter.wait(t_ns)
            if self._clock:
                self._peer.publish(self._clock, gz().Clock(sim=gz().Time(sec=t_ns // 10**9, nsec=t_ns % 10**9)))
            self._topics.write(parts[n][k : k + 1])

    def close(self) -> None:
        """Leave the network."""
        self._peer.close()


def open_transport_sink(address: str, options: dict[str, Any]) -> GazeboSink:
    """Open Gazebo's topics for frames from any source: `gazebo:?model=NAME&key=value`.

    Raises:
        InputError: an option is not valid.
        MissingExtra: pyzmq or protobuf is not installed.
    """
    chosen = options_of(TransportSinkOptions, options, f"gazebo:{address}")
    peer = TransportPeer(chosen.host, chosen.partition)
    topics = RadarTopics(peer, f"/model/{chosen.model}", f"{chosen.messages}.msgs")
    return GazeboSink(topics, chosen.pace, clock=chosen.clock)


def open_classic_sink(address: str, options: dict[str, Any]) -> GazeboSink:
    """Open gzserver's topics for frames from any source: `gazebo-classic:HOST:PORT?model=NAME&key=value`.

    Raises:
        InputError: an option or the address is not valid.
        MissingExtra: protobuf is not installed.
    """
    chosen = options_of(ClassicSinkOptions, options, f"gazebo-classic:{address}")
    peer = ClassicPeer(master_of(address), chosen.host)
    return GazeboSink(RadarTopics(peer, f"/gazebo/{chosen.gazebo_world}/{chosen.model}", CLASSIC), chosen.pace)
