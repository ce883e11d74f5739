"""IMC messages as ROS messages of the same fields, as the broker of the thesis carried them [Billdal2018, 3.5.2].

`imc_msgs/Raw` holds any packet without loss. Beside it every IMC message has a ROS message of its own (`definition`),
and `to_ros` and `to_imc` lose nothing. ROS messages are plain dicts here, so that any binding can take them. What says
the same in ROS' own words is in interpreter.py.

`passed` relays a bus's messages that are no frames to ROS, under `imc/`: the ROS messages of the table of
interpreter.py, and the whole packet as `imc_msgs/Raw` on `imc/packet`, which another bus receives. ROS nodes publish
messages for a bus under `to_imc/`, for `RosToImc`: the same topics as under `imc/`, `imc_msgs/Raw` on `to_imc/packet`,
or any message of `imc_msgs`. Set-points under `desired/` are taken without `to_imc/` too.

`python -m ullage.ports.imc.broker DIR` writes the ament package `imc_msgs` with all of its messages, or with those that
are named.
"""

from __future__ import annotations

import math
import re
import sys
from collections.abc import Iterable, Iterator, Mapping
from contextlib import suppress
from functools import cache
from pathlib import Path
from typing import Any, NamedTuple

from ullage.errors import InputError, UllageError
from ullage.ports import ament
from ullage.ports import schema as ros
from ullage.ports.imc.codec import NOBODY, Malformed, Message, Packet, body, decode, encode
from ullage.ports.imc.interpreter import PAIRS, Ros, imc_of, interpreted, rows_of, stamp_of
from ullage.ports.imc.table import Field, Kind, own
from ullage.ports.intake import Log, Once
from ullage.ports.protocol import Passed
from ullage.ports.schema import decoded, encoded

TYPES = {
    "u8": "uint8", "i8": "int8", "u16": "uint16", "i16": "int16", "u32": "uint32", "i32": "int32", "i64": "int64",
    "f32": "float32", "f64": "float64", "text": "string", "raw": "uint8[]",
}  # fmt: skip
PACKAGE = "imc_msgs"
ABOUT = "The messages of IMC, the protocol of DUNE and Neptus, field by field."
BUILT_ON = ("std_msgs",)
HEADER = """\
std_msgs/Header header   # time of the packet
uint16 src               # system and part it came from
uint8 src_ent
uint16 dst               # and that it goes to
uint8 dst_ent
"""
PACKED = "uint16 id      # number of the message\nuint8[] data   # its fields, little endian\n"
"""`imc_msgs/Packed`: a message of any kind within another."""


@cache
def ros_name(name: str) -> str:
    """The name of a field as ROS allows it: lower case with underscores."""
    return re.sub(r"(?<=[a-z0-9])(?=[A-Z])", "_", name).lower()


def definition(name: str) -> str:
    """The ROS message definition of an IMC message: its header, then its fields; what it holds by kind in text form."""
    return HEADER + "".join(line for part in own().named(name).fields for line in _lines(part))


def _lines(part: Field) -> Iterator[str]:
    """The constants and the line of a field."""
    unit = f"   # [{part.unit}]" if part.unit else ""
    if part.kind in TYPES:
        if part.values is not None:
            yield from _constants(part)
        yield f"{TYPES[part.kind]} {ros_name(part.name)}{unit}\n"
        return
    of = part.of or "Packed"
    yield f"{PACKAGE}/{of}[] {ros_name(part.name)}" + ("   # one or none\n" if part.kind == "message" else "\n")


def _constants(part: Field) -> Iterator[str]:
    values = part.values.numbers if part.values is not None else {}
    for name, number in values.items():
        word = re.sub(r"\W+", "_", name).strip("_").upper()
        yield f"{TYPES[part.kind]} {ros_name(part.name).upper()}_{word}={number}\n"


def package_files(names: Iterable[str] = ()) -> dict[str, str]:
    """The files of the ament package `imc_msgs`, by their paths in it.

    Args:
        names: of the messages; those that they hold, `Raw` and `Packed` are added. Empty: every message.

    Raises:
        InputError: the table has no message of a name.
    """
    texts = {f"{PACKAGE}/msg/{name}": definition(name) for name in _held(names or own().by_name)}
    texts |= {ros.RAW: ros.DEFINITIONS[ros.RAW], f"{PACKAGE}/msg/Packed": PACKED}
    return ament.package_files(PACKAGE, texts, about=ABOUT, built_on=BUILT_ON)


def _held(names: Iterable[str]) -> list[str]:
    """These messages and those within them, each once."""
    found: dict[str, None] = {}
    waiting = list(names)
    while waiting:
        name = waiting.pop(0)
        if name not in found:
            waiting += [part.of for part in own().named(name).fields if part.of]
            found[name] = None
    return list(found)


@cache
def register(name: str) -> str:
    """Make the message of an IMC message, and those within it, known to `ports.schema`; its type's full name."""
    from rosbags.typesys import get_types_from_msg

    kind, full = own().named(name), f"{PACKAGE}/msg/{name}"
    for part in kind.fields:
        if part.of:
            register(part.of)
    known = ros.typestore()
    packed = f"{PACKAGE}/msg/Packed"
    for text, one in ((PACKED, packed), (definition(name), full)):
        if one not in known.types:
            known.register(get_types_from_msg(text, one))
    return full


ros.LEARN[PACKAGE] = register


def to_raw(packet: Packet) -> dict[str, Any]:
    """`imc_msgs/Raw` of a packet, less its ROS header."""
    data = _bytes(packet)
    number = int.from_bytes(data[2:4], "big" if data[0] == 0xFE else "little")
    where = {"src": packet.src, "src_ent": packet.src_ent, "dst": packet.dst, "dst_ent": packet.dst_ent}
    return {"name": packet.name, "id": number, **where, "data": data}


def _bytes(packet: Packet) -> bytes:
    """The packet in the byte order of the messages of unknown kind that it holds, if any; else little endian."""
    try:
        return encode(packet, big=not packet.name and bool(packet["big"]))
    except InputError:
        return encode(packet, big=True)


def of_raw(message: Mapping[str, Any]) -> Packet:
    """The packet in an `imc_msgs/Raw`.

    Raises:
        Malformed: its data are no packet.
    """
    return decode(bytes(message["data"]))


def to_ros(packet: Packet) -> dict[str, Any]:
    """The broker's message of a packet."""
    head = {"header": {"stamp": stamp_of(packet.t_s), "frame_id": ""}}
    where = {"src": packet.src, "src_ent": packet.src_ent, "dst": packet.dst, "dst_ent": packet.dst_ent}
    return head | where | _fields_out(own().named(packet.name), packet.message.values)


def _fields_out(kind: Kind, values: Mapping[str, Any]) -> dict[str, Any]:
    out: dict[str, Any] = {}
    for part in kind.fields:
        value, name = values[part.name], ros_name(part.name)
        if part.kind in TYPES:
            out[name] = value
            continue
        held = [] if value is None else [value] if part.kind == "message" else list(value)
        out[name] = [_held_out(part, one) for one in held]
    return out


def _held_out(part: Field, one: Message | None) -> dict[str, Any]:
    if one is None:
        return {"id": 65535, "data": b""}
    if not one.name:
        return {"id": one["id"], "data": one["payload"]}
    if part.of == one.name:
        return _fields_out(own().named(one.name), one.values)
    return {"id": own().named(one.name).id, "data": encode(Packet(one))[20:-2]}


def to_imc(name: str, message: Mapping[str, Any]) -> Packet:
    """The packet of a broker's message."""
    stamp = message["header"]["stamp"]
    return Packet(
        _fields_in(own().named(name), message), stamp["sec"] + stamp["nanosec"] * 1e-9, message["src"],
        message["src_ent"], message["dst"], message["dst_ent"],
    )  # fmt: skip


def _fields_in(kind: Kind, message: Mapping[str, Any]) -> Message:
    values: dict[str, Any] = {}
    for part in kind.fields:
        value = message[ros_name(part.name)]
        if part.kind in TYPES:
            values[part.name] = value
            continue
        held = tuple(_held_in(part, one) for one in value)
        values[part.name] = (held[0] if held else None) if part.kind == "message" else held
    return Message(kind.name, values)


def _held_in(part: Field, one: Mapping[str, Any]) -> Message | None:
    if part.of and set(one) != {"id", "data"}:
        return _fields_in(own().named(part.of), one)
    return None if one["id"] == 65535 else body(one["id"], bytes(one["data"]), False, own())


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
        with suppress(InputError, *UNREADABLE):
            data = encoded(register(packet.name), to_ros(packet) | {"header": ros.header(t_ns, frame_id)})
            yield Passed(at_ns, f"{FROM_IMC}/typed/{packet.name}", f"{PACKAGE}/msg/{packet.name}", data)
    data = encoded(ros.RAW, to_raw(packet), t_ns=t_ns, frame_id=frame_id)
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
        if area == TO_IMC and item.kind.startswith(f"{PACKAGE}/msg/") and item.kind != ros.RAW:
            name = item.kind.rpartition("/")[2]
            register(name)
            return [_outgoing(to_imc(name, decoded(item.kind, item.data)), "")]
        return self._from_topic(item.topic if area == WANTED else topic, item) if area in (TO_IMC, WANTED) else []

    def _packet(self, item: Passed, *, checked: bool) -> list[Outgoing]:
        """Read a raw packet; ignore messages in `LOCAL` and our own if it came from a bus."""
        if item.kind != ros.RAW:
            raise InputError(f"it carries {item.kind}", where=item.topic, allowed=ros.RAW)
        packet = of_raw(decoded(item.kind, item.data))
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


def main(words: list[str] | None = None) -> int:
    """Write the package `imc_msgs` into a folder.

    Args:
        words: of the command line, a folder and names of messages; None: this program's.
    """
    words = sys.argv[1:] if words is None else words
    if not words or any(word.startswith("-") for word in words):
        usage = "usage: python -m ullage.ports.imc.broker DIR [NAME ...]   (writes DIR/imc_msgs; no NAME: all messages)"
        sys.stderr.write(usage + "\n")
        return 2
    try:
        files = package_files(words[1:])
        place = ament.write(files, Path(words[0], PACKAGE))
    except UllageError as error:
        sys.stderr.write(f"ullage: {error}\n")
        return 2
    sys.stdout.write(f"wrote {sum(path.endswith('.msg') for path in files)} messages: {place}\n")
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
