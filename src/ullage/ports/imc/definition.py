"""Our table as an IMC.xml, which lies beside a log and tells other programs how to read it.

Some of them want descriptions, enumerations and categories, so there are as many as they want.
"""

from __future__ import annotations

import struct
from typing import Any

from ullage.ports.imc.table import NUMBERS, VERSION, XML_TYPES, Field, Table, Values

MEANING = {"u": "unsigned integer", "i": "signed integer", "f": "floating point number"}
HEADER = (
    ("sync", "uint16_t"), ("mgid", "uint16_t"), ("size", "uint16_t"), ("timestamp", "fp64_t"), ("src", "uint16_t"),
    ("src_ent", "uint8_t"), ("dst", "uint16_t"), ("dst_ent", "uint8_t"),
)  # fmt: skip
FOOTER = (("crc16", "uint16_t"),)
DEFINED = {"Enumerated": "enum_def", "Bitfield": "bitfield_def"}
CATEGORY = "Core"


def to_xml(table: Table) -> bytes:
    """A definition of the protocol with these messages."""
    from lxml import etree

    def add(parent: Any, tag: str, **facts: str) -> Any:
        return etree.SubElement(parent, tag, {key.replace("_", "-"): value for key, value in facts.items()})

    version = f"{VERSION[0]}.{VERSION[1]}.31"
    root = etree.Element("messages", {"name": "IMC", "long-name": "Inter-Module Communication", "version": version})
    _types(add(root, "types"), add)
    for tag, unit in (("enumerations", "Enumerated"), ("bitfields", "Bitfield")):
        node = add(root, tag)
        for group in shared(table, unit):
            _numbers(add(node, "def", name=group.name, abbrev=group.name, prefix=group.prefix), group, add)
    for tag, parts in (("header", HEADER), ("footer", FOOTER)):
        node = add(root, tag)
        add(node, "description").text = f"The {tag} of every packet."
        for part, kind in parts:
            fixed = {"value": "0xFE54", "fixed": "true"} if part == "sync" else {}
            add(node, "field", name=part, abbrev=part, type=kind, **fixed)
    add(add(root, "categories"), "category", name=CATEGORY)
    _messages(root, table, add)
    text: bytes = etree.tostring(root, xml_declaration=True, encoding="UTF-8", pretty_print=True)
    return text


def _types(node: Any, add: Any) -> None:
    add(node, "description").text = "Kinds of fields."
    for name, kind in XML_TYPES.items():
        size = {"size": str(struct.calcsize(NUMBERS[kind]))} if kind in NUMBERS else {}
        what = f"{kind[1:]} bit {MEANING[kind[0]]}" if kind in NUMBERS else kind
        add(add(node, "type", name=name, **size), "description").text = what


def shared(table: Table, unit: str) -> list[Values]:
    """The sets of numbers that several fields share, by kind: Enumerated or Bitfield."""
    found = {part.values.name: part.values for kind in table.by_id.values() for part in kind.fields if part.values}
    return [values for name, values in found.items() if name and values.unit == unit]


def _field(node: Any, part: Field, add: Any) -> None:
    names = {kind: name for name, kind in XML_TYPES.items()}
    facts, values = {"message_type": part.of} if part.of else {}, part.values
    if values is not None:
        facts["unit"] = values.unit
        facts["prefix" if not values.name else DEFINED[values.unit]] = values.name or part.name.upper()
    elif part.unit:
        facts["unit"] = part.unit
    made = add(node, "field", name=part.name, abbrev=part.name, type=names[part.kind], **facts)
    if values is not None and not values.name:
        _numbers(made, values, add)


def _numbers(node: Any, values: Values, add: Any) -> None:
    for name, number in values.numbers.items():
        add(node, "value", id=str(number), name=name, abbrev=name)


def _messages(root: Any, table: Table, add: Any) -> None:
    for message in table.by_id.values():
        facts = {"name": message.name, "abbrev": message.name, "source": "vehicle", "category": CATEGORY}
        node = add(root, "message", id=str(message.id), **facts)
        add(node, "description").text = message.name
        for part in message.fields:
            _field(node, part, add)
