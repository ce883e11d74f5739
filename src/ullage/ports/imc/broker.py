"""IMC messages as ROS messages of the same fields, as the broker of the thesis carried them [Billdal2018, 3.5.2].

Every IMC message has such a ROS message (`definition`), and `to_ros` and `to_imc` lose nothing. ROS messages are plain
dicts here, so that any binding can take them. What says the same in ROS' own words is in interpreter.py.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

from ullage.ports.imc.codec import Message, Packet, body, encode
from ullage.ports.imc.table import Field, Kind, Table, own

TYPES = {
    "u8": "uint8", "i8": "int8", "u16": "uint16", "i16": "int16", "u32": "uint32", "i32": "int32", "i64": "int64",
    "f32": "float32", "f64": "float64", "text": "string", "raw": "uint8[]",
}  # fmt: skip
PACKAGE = "imc_msgs"
HEADER = """\
std_msgs/Header header   # time of the packet
uint16 src               # system and part it came from
uint8 src_ent
uint16 dst               # and that it goes to
uint8 dst_ent
"""


def definition(name: str, *, table: Table | None = None) -> str:
    """The ROS message definition of an IMC message: its header, then its fields; what it holds by kind in text form."""
    kind = (table or own()).named(name)
    return HEADER + "".join(_line(part) for part in kind.fields)


def _line(part: Field) -> str:
    if part.kind in TYPES:
        return f"{TYPES[part.kind]} {part.name}\n"
    of = f"{PACKAGE}/{part.of}" if part.of else f"{PACKAGE}/Packed"
    return f"{of}[] {part.name}" + ("   # one or none\n" if part.kind == "message" else "\n")


PACKED = "uint16 id      # number of the message\nuint8[] data   # its fields, little endian\n"
"""`imc_msgs/Packed`: a message of any kind within another."""


def to_ros(packet: Packet, *, table: Table | None = None) -> dict[str, Any]:
    """The broker's message of a packet."""
    seconds = math.floor(packet.t_s)
    stamp = {"sec": seconds, "nanosec": round((packet.t_s - seconds) * 1e9)}
    head = {"header": {"stamp": stamp, "frame_id": ""}}
    where = {"src": packet.src, "src_ent": packet.src_ent, "dst": packet.dst, "dst_ent": packet.dst_ent}
    return head | where | _fields_out((table or own()).named(packet.name), packet.message.values, table or own())


def _fields_out(kind: Kind, values: Mapping[str, Any], table: Table) -> dict[str, Any]:
    out: dict[str, Any] = {}
    for part in kind.fields:
        value = values[part.name]
        if part.kind in TYPES:
            out[part.name] = value
            continue
        held = [] if value is None else [value] if part.kind == "message" else list(value)
        out[part.name] = [_held_out(part, one, table) for one in held]
    return out


def _held_out(part: Field, one: Message | None, table: Table) -> dict[str, Any]:
    if one is None:
        return {"id": 65535, "data": b""}
    if not one.name:
        return {"id": one["id"], "data": one["payload"]}
    if part.of == one.name:
        return _fields_out(table.named(one.name), one.values, table)
    return {"id": table.named(one.name).id, "data": encode(Packet(one), table=table)[20:-2]}


def to_imc(name: str, note: Mapping[str, Any], *, table: Table | None = None) -> Packet:
    """The packet of a broker's message."""
    table = table or own()
    stamp = note["header"]["stamp"]
    return Packet(
        _fields_in(table.named(name), note, table), stamp["sec"] + stamp["nanosec"] * 1e-9, note["src"],
        note["src_ent"], note["dst"], note["dst_ent"],
    )  # fmt: skip


def _fields_in(kind: Kind, note: Mapping[str, Any], table: Table) -> Message:
    values: dict[str, Any] = {}
    for part in kind.fields:
        value = note[part.name]
        if part.kind in TYPES:
            values[part.name] = value
            continue
        held = tuple(_held_in(part, one, table) for one in value)
        values[part.name] = (held[0] if held else None) if part.kind == "message" else held
    return Message(kind.name, values)


def _held_in(part: Field, one: Mapping[str, Any], table: Table) -> Message | None:
    if part.of and set(one) != {"id", "data"}:
        return _fields_in(table.named(part.of), one, table)
    return None if one["id"] == 65535 else body(one["id"], bytes(one["data"]), False, table)
