"""IMC messages as ROS messages of the same fields, as the broker of the thesis carried them [Billdal2018, 3.5.2].

`imc_msgs/Raw` holds any packet without loss. Beside it every IMC message has a ROS message of its own (`definition`),
and `to_ros` and `to_imc` lose nothing. ROS messages are plain dicts here, so that any binding can take them. What says
the same in ROS' own words is in interpreter.py. `python -m ullage.ports.imc.broker DIR` writes the ament package
`imc_msgs` with all of them, or with those that are named.
"""

from __future__ import annotations

import re
import sys
from collections.abc import Iterable, Iterator, Mapping
from functools import cache
from pathlib import Path
from typing import Any

from ullage.errors import InputError, UllageError
from ullage.ports import ament
from ullage.ports import schema as ros
from ullage.ports.imc.codec import Message, Packet, body, decode, encode
from ullage.ports.imc.interpreter import stamp_of
from ullage.ports.imc.table import Field, Kind, own

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
