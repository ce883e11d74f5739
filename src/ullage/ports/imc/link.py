"""A live link: a thread that keeps the connection, announces us, and bounds the queues."""

from __future__ import annotations

import threading
import time
import uuid
import warnings
from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Protocol

from ullage.errors import UllageWarning
from ullage.ports.imc.codec import NOBODY, Message, Packet, Parser, compile_kernels, encode, make, readable
from ullage.ports.imc.table import Table, own
from ullage.ports.intake import Counters, Inbox, Log

MOBILE_SENSOR, UAV = 7, 4
NORMAL = 1
REPORT, QUERY = 0, 1
INBOX, OUTBOX_BYTES = 20_000, 8_000_000
AT_ONCE = 256
"""Most packets that are used at once, so that what follows does not get old meanwhile."""
TICK_S = 0.05


@dataclass(frozen=True, slots=True)
class Entity:
    """A part of a system that others see by its label."""

    id: int
    label: str
    component: str = ""


@dataclass(slots=True)
class Identity:
    """Our identity on the wire."""

    system_id: int
    name: str
    sys_type: int = MOBILE_SENSOR
    entities: list[Entity] = field(default_factory=list)
    shared: bool = False  # another system on the bus has our address on purpose
    uid: str = field(default_factory=lambda: uuid.uuid4().hex[:16])
    lat_rad: float = 0.0
    lon_rad: float = 0.0
    height_m: float = 0.0

    def announce(self, services: Sequence[str], table: Table) -> Message:
        """Return the message that announces us."""
        known = [f"ullage://0.0.0.0/uid/{self.uid}", "imc+info://0.0.0.0/version/5.4.31", *services]
        return make(
            "Announce", table=table, sys_name=self.name, sys_type=self.sys_type, owner=NOBODY, lat=self.lat_rad,
            lon=self.lon_rad, height=self.height_m, services=";".join(known),
        )  # fmt: skip

    def entity_list(self, table: Table) -> Message:
        """Return the labels and numbers of our parts."""
        text = ";".join(f"{e.label}={e.id}" for e in self.entities)
        return make("EntityList", table=table, op=REPORT, list=text)


class Outbox:
    """Packets that wait to be sent; if there are too many, the oldest are dropped."""

    def __init__(self) -> None:
        self._waiting: deque[bytes] = deque()
        self._lock = threading.Lock()
        self._size = self.dropped = 0

    def put(self, data: bytes) -> None:
        """Add one at the end."""
        with self._lock:
            self._waiting.append(data)
            self._size += len(data)
            while self._size > OUTBOX_BYTES:
                self._size -= len(self._waiting.popleft())
                self.dropped += 1

    @property
    def waiting_bytes(self) -> int:
        """Size of all that waits."""
        return self._size

    def take(self) -> bytes | None:
        """Return the oldest one, or None if none waits."""
        with self._lock:
            if not self._waiting:
                return None
            data = self._waiting.popleft()
            self._size -= len(data)
            return data

    def clear(self) -> None:
        """Forget them all."""
        with self._lock:
            self._waiting.clear()
            self._size = 0

    def __len__(self) -> int:
        return len(self._waiting)


class Wire(Protocol):
    """Carry bytes to one or more peers; every call returns at once or within its timeout."""

    @property
    def services(self) -> Sequence[str]:
        """Our services, as URIs."""

    @property
    def connected(self) -> bool:
        """Whether a peer is connected."""

    @property
    def finished(self) -> bool:
        """Whether the peer has gone for good."""

    def exchange(self, out: Outbox, timeout_s: float) -> list[Packet]:
        """Send and receive what is possible; wait until the timeout if nothing is."""

    def greet(self, announce: bytes) -> None:
        """Announce us to all listeners."""

    def wake(self) -> None:
        """End a running `exchange` early."""

    def close(self) -> None:
        """Close the sockets."""


class Link:
    """Send and receive messages in the background.

    Args:
        wire: carries the bytes.
        me: our identity.
        table: the messages.
        log: takes lines for the user: that the link waits, that a peer has gone.
        listens: whether the caller uses `receive`.
        counters: count damaged and dropped messages.
        most_waiting: messages that may wait to be received; beyond that the oldest are lost.
    """

    def __init__(
        self, wire: Wire, me: Identity, *, table: Table | None = None, log: Log | None = None,
        listens: bool = True, counters: Counters | None = None, most_waiting: int = INBOX,
    ):  # fmt: skip
        self.wire, self.me, self.table = wire, me, table or own()
        self.listens = listens
        self._log = log or (lambda text: warnings.warn(text, UllageWarning, stacklevel=2))
        self.out = Outbox()
        self.counters = counters or Counters(self._log)
        self.events: Inbox[Packet] = Inbox(self.counters, most=most_waiting, received=False)
        self._ending = False
        self._reported: set[str] = set()
        self._error: BaseException | None = None
        compile_kernels()
        self._thread = threading.Thread(target=self._run, name="imc", daemon=True)
        self._thread.start()

    def send(
        self, message: Message, *, entity: int = 255, t_s: float | None = None, dst: int = NOBODY, dst_ent: int = 255
    ) -> None:
        """Queue a message; drop the oldest if the peer does not take them.

        Raises:
            InputError: a value does not fit its field.
        """
        stamp = time.time() if t_s is None else t_s
        data = encode(Packet(message, stamp, self.me.system_id, entity, dst, dst_ent), table=self.table)
        self.out.put(data)
        if self.out.dropped:
            self._once("slow", "the peer reads too slowly; the oldest messages to it are dropped")
        self.wire.wake()

    def enter(self, entity: Entity) -> None:
        """Announce a part of us."""
        self.me.entities = [*self.me.entities, entity]
        for data in (self._pack(self.me.entity_list(self.table)), self._info(entity), self._state(entity)):
            self.out.put(data)

    def join(self, me: Identity, *, listens: bool) -> None:
        """Let another part of this program use the link under the same name and number."""
        if (me.lat_rad, me.lon_rad, me.height_m) != (0.0, 0.0, 0.0):
            self.me.lat_rad, self.me.lon_rad, self.me.height_m = me.lat_rad, me.lon_rad, me.height_m
        for entity in me.entities:
            if entity not in self.me.entities:
                self.enter(entity)
        self.listens = self.listens or listens

    def receive(self, timeout_s: float = 0.25) -> list[Packet]:
        """Return the packets that wait, `AT_ONCE` at most; wait for one until the timeout."""
        found: list[Packet] = []
        while len(found) < AT_ONCE and (packet := self.events.get(0.0 if found or self._ending else timeout_s)):
            found.append(packet)
        if self._error is not None:
            raise self._error
        return found

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
        self._thread.join(3.0)
        self.wire.close()

    def _once(self, key: str, text: str) -> None:
        if key not in self._reported:
            self._reported.add(key)
            self._log(text)

    def _run(self) -> None:
        try:
            self._loop()
        except BaseException as error:  # `receive` raises it
            self._error = error
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
                self._beat()
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
            self._once("full", "messages come faster than they are used; the oldest are dropped")

    def _pack(self, message: Message, entity: int = 255) -> bytes:
        return encode(Packet(message, time.time(), self.me.system_id, entity), table=self.table)

    def _introduce(self) -> None:
        hello = self._pack(self.me.announce(self.wire.services, self.table))
        self.wire.greet(hello)
        if not self.wire.connected:
            return
        for data in (hello, self._pack(self.me.entity_list(self.table)), *map(self._info, self.me.entities)):
            self.out.put(data)

    def _info(self, e: Entity) -> bytes:
        info = make("EntityInfo", table=self.table, id=e.id, label=e.label, component=e.component)
        return self._pack(info, e.id)

    def _state(self, e: Entity) -> bytes:
        return self._pack(make("EntityState", table=self.table, state=NORMAL, description="active"), e.id)

    def _beat(self) -> None:
        for data in (self._pack(make("Heartbeat", table=self.table)), *map(self._state, self.me.entities)):
            self.out.put(data)

    def _answer(self, packet: Packet) -> None:
        """Answer the requests that every system must answer."""
        if packet.src == self.me.system_id:
            if packet.name == "Announce" and not self.me.shared and self.me.uid not in packet["services"]:
                other = f"{readable(packet['sys_name'])!r} also uses the address {packet.src:#06x}"
                self._once("twin", f"{other}; give one of us another: system_id=")
            return
        if packet.dst not in (self.me.system_id, NOBODY):
            return
        answers: list[bytes] = []
        if packet.name == "EntityList" and packet["op"] == QUERY:
            answers = [self._pack(self.me.entity_list(self.table))]
        elif packet.name == "QueryEntityInfo":
            answers = [self._info(e) for e in self.me.entities if e.id in (packet.dst_ent, packet["id"])]
        elif packet.name == "QueryEntityState":
            answers = [self._state(e) for e in self.me.entities if packet.dst_ent in (e.id, 255)]
        for data in answers:
            self.out.put(data)


def memory_bytes(packet: Packet) -> int:
    """Estimate the memory of a packet [bytes]: its texts and raw data, and a constant."""
    values = packet.message.values.values()
    return 500 + sum(len(value) for value in values if isinstance(value, (str, bytes)))


def report_foreign_bytes(parser: Parser, where: str, log: Log, reported: set[str]) -> None:
    """Log once that a peer speaks another version, or no IMC at all."""
    if parser.strange > 1 and parser.version and "version" not in reported:
        reported.add("version")
        major, minor = parser.version
        log(f"{where} speaks IMC {major}.{minor}; this port speaks 5.4")
    elif parser.garbage > 4096 and "garbage" not in reported:
        reported.add("garbage")
        log(f"{where} sends bytes that are no IMC; they are passed over")
