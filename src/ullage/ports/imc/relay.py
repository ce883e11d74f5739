"""Relay of bus messages that are no frames to ROS and from there to a bus: the thesis' broker and interpreter.

Messages of a bus go out under `imc/`: the ROS messages of the table (interpreter.py), and the whole packet as
`imc_msgs/Raw` on `imc/packet`, which another bus receives. ROS nodes publish messages for a bus under
`to_imc/`: the same topics as under `imc/`, `imc_msgs/Raw` on `to_imc/packet`, or any message of `imc_msgs`. Set-points
under `desired/` are taken without `to_imc/` too.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import NamedTuple

from ullage.errors import InputError
from ullage.ports import schema as ros
from ullage.ports.imc import broker
from ullage.ports.imc.codec import NOBODY, Malformed, Message, Packet, encode
from ullage.ports.imc.interpreter import PAIRS, Ros, imc_of, interpreted, rows_of
from ullage.ports.imc.table import own
from ullage.ports.intake import Log, Once
from ullage.ports.protocol import Passed
from ullage.ports.schema import decoded, encoded

FROM_IMC, TO_IMC, WANTED = "imc", "to_imc", "desired"
PACKET = "packet"
LOCAL = {"Heartbeat", "Announce", "EntityInfo", "EntityList", "QueryEntityInfo", "QueryEntityState"}
"""Messages about a system itself or between two systems: ROS gets them, another bus does not."""
FRAMES = (b"ullage_msgs/",)
"""First bytes of a DevDataBinary that holds a frame."""
LATEST_NS = 2**31 * 10**9
UNREADABLE = (
    AttributeError,
    IndexError,
    KeyError,
    OverflowError,
    TypeError,
    UnicodeError,
    ValueError,
    ZeroDivisionError,
)


class Outgoing(NamedTuple):
    """A message to send, with the header fields of its packet if it came in one."""

    message: Message
    t_s: float | None
    part: str  # of the sending system; empty for ROS
    dst: int = NOBODY
    dst_ent: int = 255


def passed(packet: Packet, at_ns: int, *, typed: bool = False) -> Iterator[Passed]:
    """Give a packet as ROS messages, and last as a raw packet; give nothing for our own frames.

    Args:
        packet: of any system; its time goes into the headers.
        at_ns: its time on the clock of the poses; the clock of another system may be anywhere.
        typed: also as the message of `imc_msgs` that has its fields.
    """
    if packet.name == "DevDataBinary" and bytes(packet["value"]).startswith(FRAMES):
        return
    t_ns = round(packet.t_s * 1e9) if math.isfinite(packet.t_s) else 0
    t_ns = t_ns if 0 <= t_ns < LATEST_NS else 0
    frame_id = f"imc_{packet.src:04x}"
    for topic, fields in _interpreted(packet.message).items():
        kind = _full(PAIRS[packet.name].ros[topic])
        try:
            data = encoded(kind, fields, t_ns=t_ns, frame_id=frame_id)
        except InputError:
            continue  # the ROS type cannot hold this number; the raw packet has it
        yield Passed(at_ns, f"{FROM_IMC}/{topic}", kind, data)
    if typed and packet.name in own().by_name:
        try:
            data = encoded(broker.register(packet.name), broker.to_ros(packet) | {"header": ros.header(t_ns, frame_id)})
            yield Passed(at_ns, f"{FROM_IMC}/typed/{packet.name}", f"{broker.PACKAGE}/msg/{packet.name}", data)
        except (InputError, *UNREADABLE):
            pass
    data = encoded(ros.RAW, broker.to_raw(packet), t_ns=t_ns, frame_id=frame_id)
    yield Passed(at_ns, f"{FROM_IMC}/{PACKET}", ros.RAW, data)


def _interpreted(message: Message) -> Ros:
    try:
        return interpreted(message) or {}
    except UNREADABLE:
        return {}  # numbers without a meaning; the raw packet has them


def _full(kind: str) -> str:
    return kind.replace("/", "/msg/")


class RosToImc:
    """Convert ROS messages to IMC messages.

    Args:
        own_id: our number on the bus; our own messages are not repeated.
        log: takes a line for a message that is not valid.
    """

    def __init__(self, own_id: int, log: Log) -> None:
        self._own, self._once = own_id, Once(log)
        self._latest: Ros = {}  # parts of messages that are made of several

    def take(self, item: Passed) -> list[Outgoing]:
        """Return the messages to send for a ROS message."""
        area, _, topic = item.topic.partition("/")
        try:
            found = self._made(area, topic, item)
            for one in found:
                encode(Packet(one.message))  # a number that does not fit is refused here
        except (InputError, Malformed, *UNREADABLE) as error:
            self._once(f"{item.topic} cannot be sent: {error}")
            return []
        return found

    def _made(self, area: str, topic: str, item: Passed) -> list[Outgoing]:
        if topic == PACKET and area in (FROM_IMC, TO_IMC):
            return self._packet(item, checked=area == FROM_IMC)
        if area == TO_IMC and item.kind.startswith(f"{broker.PACKAGE}/msg/") and item.kind != ros.RAW:
            name = item.kind.rpartition("/")[2]
            broker.register(name)
            return [_outgoing(broker.to_imc(name, decoded(item.kind, item.data)), "")]
        return self._from_topic(item.topic if area == WANTED else topic, item) if area in (TO_IMC, WANTED) else []

    def _packet(self, item: Passed, *, checked: bool) -> list[Outgoing]:
        """Read a raw packet; ignore messages in `LOCAL` and our own if it came from a bus."""
        if item.kind != ros.RAW:
            raise InputError(f"it carries {item.kind}", where=item.topic, allowed=ros.RAW)
        packet = broker.of_raw(decoded(item.kind, item.data))
        if not checked:
            return [_outgoing(packet, "")]
        if packet.src == self._own or packet.name in LOCAL:
            return []
        return [_outgoing(packet, f"{packet.src:#06x}/{packet.src_ent}")]

    def _from_topic(self, topic: str, item: Passed) -> list[Outgoing]:
        """Return the IMC message of a topic in the table; keep other topics of the same message until then."""
        row = rows_of(topic)
        if row is None:
            raise InputError(f"no IMC message has the topic {topic!r}", allowed="see docs/dune.md")
        wanted = _full(next(part.kind for part in row.parts if part.topic == topic))
        if item.kind != wanted:
            raise InputError(f"it carries {item.kind}", where=item.topic, allowed=wanted)
        self._latest[topic] = decoded(item.kind, item.data)
        if topic != row.parts[0].topic:
            return []
        there = {part.topic: self._latest[part.topic] for part in row.parts if part.topic in self._latest}
        for part in row.parts:
            if not part.kept:
                self._latest.pop(part.topic, None)
        return [Outgoing(imc_of(row.name, there), None, "")]


def _outgoing(packet: Packet, part: str) -> Outgoing:
    return Outgoing(packet.message, packet.t_s or None, part, packet.dst, packet.dst_ent)
