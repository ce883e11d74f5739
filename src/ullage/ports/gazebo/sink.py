"""Frames from anywhere on Gazebo's topics."""

from __future__ import annotations

import time
from collections.abc import Mapping
from typing import Any, Literal, Self

from pydantic import Field

from ullage.data import Frames
from ullage.ports.following import options_of
from ullage.ports.gazebo.peer import Peer
from ullage.ports.gazebo.topics import RadarTopics
from ullage.ports.gazebo.wire import gz
from ullage.ports.protocol import Item
from ullage.specs import Spec


class SinkOptions(Spec):
    """What can be set about `--to gazebo:`."""

    model: str = Field("ullage", min_length=1, description="topics are /model/MODEL/radar/SENSOR/...")
    messages: Literal["gz", "ignition"] = Field("gz", description="ignition for Fortress and before")
    pace: float = Field(1.0, ge=0, le=1000, description="times real time; 0: as fast as can be")
    clock: str = Field("/clock", description="topic of the frames' clock; empty: none")
    host: str = Field("127.0.0.1", description="address of the interface to use")
    partition: str | None = Field(None, description="none: GZ_PARTITION, or this host and user")


class GazeboSink:
    """Publishes frames, at the pace of their own clock.

    Args:
        address: unused; `gazebo:` alone.
        options: as `SinkOptions` lists them.

    Raises:
        InputError: an option cannot be used.
        MissingExtra: pyzmq or protobuf is not installed.
    """

    def __init__(self, address: str, options: dict[str, Any]) -> None:
        self._options = options_of(SinkOptions, options, f"gazebo:{address}")
        package = "gz.msgs" if self._options.messages == "gz" else "ignition.msgs"
        self._peer = Peer(self._options.host, self._options.partition)
        self._topics = RadarTopics(self._peer, self._options.model, package)
        self._start: tuple[float, int] | None = None
        if self._options.clock:
            self._peer.advertise(self._options.clock, f"{package}.Clock")

    def write(self, item: Item) -> None:
        """Publish frames; everything else passes by."""
        parts = [item] if isinstance(item, Frames) else list(item.values()) if isinstance(item, Mapping) else []
        if not parts:
            return
        for t_ns, part in sorted(((int(p.t_ns[k]), p[k : k + 1]) for p in parts for k in range(len(p))), key=_first):
            self._wait(t_ns)
            self._topics.write(part)

    def _wait(self, t_ns: int) -> None:
        """Until this moment of the frames' clock, which is published."""
        now = time.monotonic()
        if self._start is None:
            self._start = (now, t_ns)
        if self._options.pace:
            time.sleep(max(0.0, self._start[0] + (t_ns - self._start[1]) * 1e-9 / self._options.pace - now))
        if self._options.clock:
            stamp = gz().Time(sec=t_ns // 10**9, nsec=t_ns % 10**9)
            self._peer.publish(self._options.clock, gz().Clock(sim=stamp))

    def close(self) -> None:
        """Say goodbye."""
        self._peer.close()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *error: object) -> None:
        self.close()


def _first(pair: tuple[int, Frames]) -> int:
    return pair[0]
