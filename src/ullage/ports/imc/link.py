"""A live link: a thread that keeps the connection, announces us, and bounds the queues."""

from __future__ import annotations

import time
from collections.abc import Iterator
from typing import Literal

from ullage.flow import Closing
from ullage.ports.imc.codec import NOBODY, Message, Packet, compile_kernels, encode, make, readable
from ullage.ports.imc.options import LinkOptions, endpoint
from ullage.ports.imc.wires import OUTBOX_BYTES, Entity, Identity, TcpWire, UdpWire
from ullage.ports.intake import Counters, Inbox, Log, Once, Worker
from ullage.ports.network import SharedLinks

NORMAL = 1
QUERY = 1
INBOX = 20_000
AT_ONCE = 256
"""Most packets that are used at once, so that what follows does not get old meanwhile."""
TICK_S = 0.05


class Link(Closing):
    """Send and receive messages in the background.

    Args:
        wire: carries the bytes; its table, log and counters are the link's too.
        me: our identity.
        listens: whether the caller takes what arrives.
    """

    def __init__(self, wire: TcpWire | UdpWire, me: Identity, *, listens: bool = True) -> None:
        self.wire, self.me, self.listens = wire, me, listens
        self.table, self._log, self.counters = wire.table, wire.log, wire.counters
        self.out: Inbox[bytes] = Inbox(self.counters, most_bytes=OUTBOX_BYTES, received=False)
        self.events: Inbox[Packet] = Inbox(self.counters, most=INBOX, received=False)
        self._ending = False
        self._once = Once(self._log)
        compile_kernels()
        self._worker = Worker(self._run, "imc")
        self._worker.start()

    def send(
        self, message: Message, *, entity: int = 255, t_s: float | None = None, dst: int = NOBODY, dst_ent: int = 255
    ) -> None:
        """Queue a message; drop the oldest if the peer does not take them.

        Raises:
            InputError: a value does not fit its field.
        """
        stamp = time.time() if t_s is None else t_s
        self._queue(encode(Packet(message, stamp, self.me.system_id, entity, dst, dst_ent), table=self.table))
        if self.out.lost:
            self._once("the peer reads too slowly; the oldest messages to it are dropped")
        self.wire.wake()

    def enter(self, entity: Entity) -> None:
        """Announce a part of us."""
        self.me.entities = [*self.me.entities, entity]
        self._queue(self._pack(self.me.entity_list(self.table)), self._info(entity), self._state(entity))

    def _queue(self, *packets: bytes) -> None:
        for data in packets:
            self.out.put(data, topic="packets to the peer", size=len(data))

    def join(self, me: Identity, *, listens: bool) -> None:
        """Let another part of this program use the link under the same name and number."""
        if (me.lat_rad, me.lon_rad, me.height_m) != (0.0, 0.0, 0.0):
            self.me.lat_rad, self.me.lon_rad, self.me.height_m = me.lat_rad, me.lon_rad, me.height_m
        for entity in me.entities:
            if entity not in self.me.entities:
                self.enter(entity)
        self.listens = self.listens or listens

    def arriving(self, timeout_s: float) -> Iterator[Packet]:
        """Give the packets that wait, `AT_ONCE` at most; wait for one until the timeout. What is not taken waits on."""
        for count in range(AT_ONCE):
            packet = self.events.get(0.0 if count or self._ending else timeout_s)
            if packet is None:
                break
            yield packet
        self._worker.check()

    @property
    def finished(self) -> bool:
        """Whether no more messages can come."""
        return self.wire.finished or self._ending

    @property
    def connected(self) -> bool:
        """Whether a peer is connected."""
        return self.wire.connected

    def flush(self, timeout_s: float = 2.0) -> bool:
        """Wait until the network has every queued packet; return false after the timeout."""
        until = time.monotonic() + timeout_s
        while time.monotonic() < until:
            if not len(self.out):
                return True
            time.sleep(0.01)
        return False

    def close(self) -> None:
        """End the thread and close the sockets; queued packets are sent if the peer takes them soon."""
        if self._ending:
            return
        if self.wire.connected:
            self.flush(1.0)
        self._ending = True
        self.wire.wake()
        self._worker.join(3.0)
        self.wire.close()

    def _run(self) -> None:
        try:
            self._loop()
        finally:
            self._ending = True

    def _loop(self) -> None:
        next_beat = next_announce = 0.0
        there = False
        while not self._ending:
            now = time.monotonic()
            if self.wire.connected and not there:
                next_beat = next_announce = 0.0
            elif there and not self.wire.connected:
                self._log("the peer has gone" + ("" if self.wire.finished else "; waiting for it to come back"))
                self.out.clear()
            there = self.wire.connected
            if now >= next_announce:
                next_announce = now + (10.0 if there else 1.0)
                self._introduce()
            if there and now >= next_beat:
                next_beat = now + 1.0
                self._queue(self._pack(make("Heartbeat", table=self.table)), *map(self._state, self.me.entities))
            self._take(self.wire.exchange(self.out, TICK_S))

    def _take(self, packets: list[Packet]) -> None:
        for packet in packets:
            self._answer(packet)
            if not packet.name and packet.id in self.table.by_id:
                self.counters.drop(self.table.by_id[packet.id].name, "bad", "its bytes do not fit its fields")
        if not self.listens:
            return
        for packet in packets:
            self.events.put(packet, topic=packet.name or f"message {packet.id}", size=memory_bytes(packet))
        if self.events.lost:
            self._once("messages come faster than they are used; the oldest are dropped")

    def _pack(self, message: Message, entity: int = 255) -> bytes:
        return encode(Packet(message, time.time(), self.me.system_id, entity), table=self.table)

    def _introduce(self) -> None:
        hello = self._pack(self.me.announce(self.wire.services, self.table))
        self.wire.greet(hello)
        if not self.wire.connected:
            return
        self._queue(hello, self._pack(self.me.entity_list(self.table)), *map(self._info, self.me.entities))

    def _info(self, e: Entity) -> bytes:
        info = make("EntityInfo", table=self.table, id=e.id, label=e.label, component=e.component)
        return self._pack(info, e.id)

    def _state(self, e: Entity) -> bytes:
        return self._pack(make("EntityState", table=self.table, state=NORMAL, description="active"), e.id)

    def _answer(self, packet: Packet) -> None:
        """Answer the requests that every system must answer."""
        if packet.src == self.me.system_id:
            if packet.name == "Announce" and not self.me.shared and self.me.uid not in packet["services"]:
                other = f"{readable(packet['sys_name'])!r} also uses the address {packet.src:#06x}"
                self._once(f"{other}; give one of us another: system_id=", kind="twin")
            return
        if packet.dst not in (self.me.system_id, NOBODY):
            return
        if packet.name == "EntityList" and packet["op"] == QUERY:
            self._queue(self._pack(self.me.entity_list(self.table)))
        elif packet.name == "QueryEntityInfo":
            self._queue(*(self._info(e) for e in self.me.entities if e.id in (packet.dst_ent, packet["id"])))
        elif packet.name == "QueryEntityState":
            self._queue(*(self._state(e) for e in self.me.entities if packet.dst_ent in (e.id, 255)))


def memory_bytes(packet: Packet) -> int:
    """Estimate the memory of a packet [bytes]: its texts and raw data, and a constant."""
    values = packet.message.values.values()
    return 500 + sum(len(value) for value in values if isinstance(value, (str, bytes)))


Role = Literal["source", "sink", "vehicle"]
_links: SharedLinks[Link] = SharedLinks()


def open_link(place: str, options: LinkOptions, me: Identity, *, role: Role, log: Log) -> Link:
    """Open a link to a place; `leave` closes it.

    Args:
        place: `tcp://host:port`, `udp://host:port`, or nothing.
        options: options of the link; an open link keeps the options that it was opened with.
        me: our identity.
        role: a source and a sink share a link; a vehicle has its own, since it takes another address.
        log: takes lines for the user.

    Raises:
        InputError: the place is not valid.
    """
    kind, host, port = where = endpoint(place)
    key = (where, me.system_id, me.name, options.interface, options.port, options.xml)

    def make_link() -> Link:
        common = options, options.table(), log, Counters(log)
        wire = TcpWire((host, port), *common) if kind == "tcp" else UdpWire((host, port) if kind else None, me, *common)
        return Link(wire, me, listens=role != "sink")

    if role == "vehicle":
        return make_link()
    link, joined = _links.get(key, role, make_link, usable=lambda link: not link.finished)
    if joined:
        link.join(me, listens=role == "source")
    return link


leave = _links.leave
"""Closes a link, unless its other role still uses it."""
