"""Poses of a vehicle on the bus, for frames that come from elsewhere."""

from __future__ import annotations

from collections import deque

from ullage.errors import InputError
from ullage.ports.imc.assemble import Track
from ullage.ports.imc.link import leave, open_link
from ullage.ports.imc.options import PoseOptions
from ullage.ports.imc.wires import Entity, Identity
from ullage.ports.intake import warn
from ullage.ports.pose_events import BodyState


class PoseFeed:
    """Feed of a vehicle's poses.

    Args:
        place: `tcp://host:port`, `udp://host:port`, or nothing.
        options: name the vehicle and the origin of the world.

    Raises:
        InputError: the place cannot be opened.
    """

    settings = PoseOptions

    def __init__(self, place: str, options: PoseOptions) -> None:
        me = Identity(options.system_id, options.name, entities=[Entity(1, options.name, "ullage")])
        self._link = open_link(place, options, me, role="source", log=warn)
        self._track = Track(
            self._link.counters, state=options.state, origin=options.place(), vehicle=options.vehicle, keep=1
        )
        self._ready: deque[BodyState] = deque()

    def next(self, timeout_s: float) -> BodyState | None:
        """Return the next pose, or None if none came within the timeout.

        Raises:
            InputError: the bus is gone.
        """
        if not self._ready:
            for packet in self._link.arriving(timeout_s):
                self._ready += [found.item for found in self._track.take(packet)]
        if not self._ready:
            if self._link.finished:
                raise InputError("the bus is gone", where="imc")
            return None
        return self._ready.popleft()

    def close(self) -> None:
        """Let go of the link, unless a sink still uses it."""
        leave(self._link, "source")
