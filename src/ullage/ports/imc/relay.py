"""Messages of a bus that are no frames, carried to ROS and from there to a bus: the thesis' broker and interpreter.

What is said on a bus goes out under `imc/`: the ROS messages of its pair (interpreter.py), then `imc/packet`, which
says what they were and holds the CRC-32 of each, by which they are put together again whatever order they come in.
What ROS nodes want said they publish under `desired/`; it is sent as it comes.
"""

from __future__ import annotations

import json
import time
from collections import deque
from collections.abc import Callable, Iterator
from typing import Any, NamedTuple
from zlib import crc32

from ullage.errors import InputError
from ullage.ports.imc.codec import Message, Packet
from ullage.ports.imc.interpreter import PAIRS, Ros, imc_of, interpreted
from ullage.ports.plain import decoded, encoded
from ullage.ports.protocol import Passed

SAID, WANTED = "imc", "desired"
PACKET, ABOUT = f"{SAID}/packet", "diagnostic_msgs/msg/DiagnosticStatus"
HELD, PATIENCE_S = 256, 2.0
ALL_SIX = 0x3F
"""Flags of DesiredVelocity and DesiredControl: every component counts."""


class Told(NamedTuple):
    """A message to send, and what the packet was that it came in, where it came in one."""

    message: Message
    t_s: float | None
    part: str  # of the system that said it; empty where ROS did


def kind_of(topic: str) -> str | None:
    """The ROS type of a topic of the table, `package/msg/Name`."""
    stem = topic.rpartition("/")[0] if topic.rpartition("/")[2].isdecimal() else topic  # units beyond those named
    found = next((pair.ros[stem] for pair in PAIRS.values() if stem in pair.ros), None)
    return found and found.replace("/", "/msg/")


def passed(packet: Packet, at_ns: int) -> Iterator[Passed]:
    """A packet in ROS' words, and last what it was; nothing where the table has no words for it.

    Args:
        packet: whoever said it; its time goes into the headers.
        at_ns: when that was by the clock of those whose poses are followed: a stranger's may be anywhere.
    """
    if not 0 <= packet.t_s < 2**31:
        return
    try:
        notes = interpreted(packet.message)
    except (AttributeError, KeyError, TypeError, ValueError, IndexError):
        return  # numbers of a stranger that say nothing
    part, t_ns, sums = f"{packet.src:#06x}/{packet.src_ent}", round(packet.t_s * 1e9), {}
    for topic, fields in (notes or {}).items():
        kind = kind_of(topic)
        assert kind is not None  # the table names every topic that it gives
        data = encoded(kind, fields, t_ns=t_ns, frame_id=f"imc_{packet.src:04x}")
        sums[topic] = crc32(data)
        yield Passed(at_ns, f"{SAID}/{topic}", kind, data)
    if sums:
        facts = {"t_s": packet.t_s, "src": packet.src, "src_ent": packet.src_ent, "dst": packet.dst,
                 "dst_ent": packet.dst_ent, "parts": sums}  # fmt: skip
        values = [{"key": key, "value": json.dumps(value)} for key, value in facts.items()]
        about = {"name": packet.name, "hardware_id": part, "values": values}
        yield Passed(at_ns, PACKET, ABOUT, encoded(ABOUT, about))


class _Packet(NamedTuple):
    """What `imc/packet` said, and until when its parts are waited for."""

    name: str
    part: str
    facts: dict[str, Any]
    until_s: float


class Joiner:
    """Makes IMC messages of ROS messages again.

    Args:
        own: our number on the bus; what we said ourselves is not said again.
        say: told of what cannot be used.
    """

    def __init__(self, own: int, say: Callable[[str], None]) -> None:
        self._own, self._say = own, say
        self._parts: dict[str, deque[tuple[int, dict[str, Any]]]] = {}
        self._packets: deque[_Packet] = deque(maxlen=HELD)
        self._flags: dict[str, dict[str, Any]] = {}
        self._told: set[str] = set()

    def take(self, item: Passed) -> list[Told]:
        """The messages that this one makes whole."""
        area, _, topic = item.topic.partition("/")
        wanted = ABOUT if item.topic == PACKET else kind_of(item.topic if area == WANTED else topic)
        if wanted is None or area not in (SAID, WANTED):
            return []
        try:
            if item.kind != wanted:
                raise InputError(f"it carries {item.kind}", where=item.topic, allowed=wanted)
            fields = decoded(item.kind, item.data)
            if area == WANTED:
                return self._wish(item.topic, fields)
            if item.topic == PACKET:
                self._announced(fields)
            else:
                kept = self._parts.setdefault(topic, deque(maxlen=HELD))
                kept.append((crc32(encoded(item.kind, fields)), fields))
        except (InputError, AttributeError, KeyError, TypeError, ValueError) as error:
            self._once(f"{item.topic} cannot be sent: {error}")
            return []
        return self._whole()

    def _announced(self, fields: dict[str, Any]) -> None:
        facts = {pair["key"]: json.loads(pair["value"]) for pair in fields["values"]}
        if fields["name"] not in PAIRS:
            raise InputError(f"no pair for {fields['name']!r}", allowed=", ".join(PAIRS))
        if int(facts["src"]) != self._own:
            until = time.monotonic() + PATIENCE_S
            self._packets.append(_Packet(fields["name"], str(fields["hardware_id"]), facts, until))

    def _whole(self) -> list[Told]:
        out, now = [], time.monotonic()
        for packet in list(self._packets):
            notes = self._notes(packet.facts["parts"])
            if notes is not None:
                out.append(Told(imc_of(packet.name, notes), float(packet.facts["t_s"]), packet.part))
            elif now > packet.until_s:
                self._once(f"parts of a {packet.name} of {packet.part} did not come; it is left out")
            else:
                continue
            self._packets.remove(packet)
        return out

    def _notes(self, sums: dict[str, int]) -> Ros | None:
        """The parts of a packet; None while one is still to come."""
        found: Ros = {}
        for topic, wanted in sums.items():
            fields = next((fields for kept, fields in self._parts.get(topic, ()) if kept == wanted), None)
            if fields is None:
                return None
            found[topic] = fields
        return found

    def _wish(self, topic: str, fields: dict[str, Any]) -> list[Told]:
        if topic.endswith("/flags"):
            self._flags[topic] = fields
            return []
        name, pair = next((name, pair) for name, pair in PAIRS.items() if topic in pair.ros)
        notes, flags = {topic: fields}, f"{topic}/flags"
        if flags in pair.ros:
            notes[flags] = self._flags.get(flags, {"data": ALL_SIX})
        return [Told(imc_of(name, notes), None, "")]

    def _once(self, text: str) -> None:
        if text not in self._told and len(self._told) < 100:
            self._told.add(text)
            self._say(text)
