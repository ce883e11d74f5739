"""Send frames on the bus, so that DUNE's tasks and Neptus see each radar like any other sensor."""

from __future__ import annotations

import time

from ullage.flow import Sink
from ullage.ports.imc.codec import readable
from ullage.ports.imc.frames import BODY, MessageEncoder, TimedMessage
from ullage.ports.imc.link import Link, leave, open_link
from ullage.ports.imc.options import SinkOptions
from ullage.ports.imc.relay import Outgoing, RosToImc
from ullage.ports.imc.wires import Entity, Identity
from ullage.ports.intake import Log, warn
from ullage.ports.protocol import Item, Passed
from ullage.ports.publisher import RateLimiter

FIRST_RELAYED, LAST_RELAYED = 100, 254
"""Entity numbers of relayed systems; radars have numbers from 10."""
EPOCH_S = 1e9
"""Times earlier than 2001 count from the start of a flight, not from 1970."""


class ImcSink(Sink):
    """Send frames, paths and passed-on messages on an IMC bus.

    Args:
        place: `tcp://host:port`, `udp://host:port`, or nothing.
        options: select what is sent.
        log: takes lines for the user.

    Raises:
        InputError: the place is not valid.
    """

    settings = SinkOptions
    sends = True
    """Its messages leave this machine's process at once."""

    def __init__(self, place: str, options: SinkOptions, *, log: Log = warn) -> None:
        home = options.home()
        me = Identity(
            options.system_id, options.name, entities=[Entity(BODY, options.name, "ullage")], lat_rad=home.lat_rad,
            lon_rad=home.lon_rad, height_m=home.height_m,
        )  # fmt: skip
        self._limiter = RateLimiter(options.pace)
        self._link: Link = open_link(place, options, me, role="sink", log=log)
        self._encoder = MessageEncoder(options, home, self._link.enter)
        self._from_ros, self._relayed = RosToImc(options.system_id, log), dict[str, int]()
        self._shares = False  # the last entity stands for several parts
        self._epoch_s: float | None = None  # Unix time at 0 of the stream's clock [s]

    def write(self, item: Item) -> None:
        """Send frames, chunks of frames, the body's path, or ROS messages; ignore everything else."""
        if isinstance(item, Passed) and not self._link.listens:  # else it came from this bus
            for one in self._from_ros.take(item):
                self._relay(one)
        for timed in self._encoder.messages(item):
            self._send(timed)

    def _send(self, timed: TimedMessage) -> None:
        """Send a message when it is due: stream time runs `pace` times as fast as wall time."""
        t_s = timed.t_ns * 1e-9
        if self._epoch_s is None:
            self._epoch_s = 0.0 if t_s > EPOCH_S else time.time() - t_s
        self._limiter.wait(timed.t_ns)
        self._link.send(timed.message, entity=timed.entity, t_s=self._epoch_s + t_s)

    def _relay(self, one: Outgoing) -> None:
        """Send at once; each relayed part of another system is an entity of ours."""
        entity = self._relayed.get(one.part)
        if entity is None:
            entity = BODY if not one.part else min(FIRST_RELAYED + len(self._relayed), LAST_RELAYED)
            if entity < LAST_RELAYED:  # further ones share the last entity
                self._relayed[one.part] = entity
            if one.part and (entity < LAST_RELAYED or not self._shares):
                self._shares = entity == LAST_RELAYED
                self._link.enter(Entity(entity, readable(one.part), "ullage.relay"))
        self._link.send(one.message, entity=entity, t_s=one.t_s, dst=one.dst, dst_ent=one.dst_ent)

    def close(self) -> None:
        """Send the queued messages, if the peer takes them, and close the sockets."""
        leave(self._link, "sink")
