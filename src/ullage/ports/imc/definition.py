"""Our table as an IMC.xml, which lies beside a log and tells other programs how to read it.

Some of them want descriptions, enumerations and categories, so there are as many as they want.
"""

from __future__ import annotations

import struct
from typing import Any

from ullage.ports.imc.table import NUMBERS, VERSION, XML_TYPES, Table

MEANING = {"u": "unsigned integer", "i": "signed integer", "f": "floating point number"}
HEADER = (
    ("sync", "uint16_t"), ("mgid", "uint16_t"), ("size", "uint16_t"), ("timestamp", "fp64_t"), ("src", "uint16_t"),
    ("src_ent", "uint8_t"), ("dst", "uint16_t"), ("dst_ent", "uint8_t"),
)  # fmt: skip
FOOTER = (("crc16", "uint16_t"),)
ENUMERATIONS = {
    "SpeedUnits": ("SUNITS", {"METERS_PS": 0, "RPM": 1, "PERCENTAGE": 2}),
    "ZUnits": ("Z", {"NONE": 0, "DEPTH": 1, "ALTITUDE": 2, "HEIGHT": 3}),
}
BITFIELDS = {"CLoopsMask": ("CL", {"PATH": 1, "ALTITUDE": 4, "DEPTH": 8, "YAW": 0x40, "SPEED": 0x80, "FORCE": 0x800})}
CATEGORY = "Core"


def to_xml(table: Table) -> bytes:
    """A definition of the protocol with these messages."""
    from lxml import etree

    def add(parent: Any, tag: str, **facts: str) -> Any:
        return etree.SubElement(parent, tag, {key.replace("_", "-"): value for key, value in facts.items()})

    version = f"{VERSION[0]}.{VERSION[1]}.31"
    root = etree.Element("messages", {"name": "IMC", "long-name": "Inter-Module Communication", "version": version})
    _types(add(root, "types"), add)
    for tag, groups in (("enumerations", ENUMERATIONS), ("bitfields", BITFIELDS)):
        node = add(root, tag)
        for name, (prefix, values) in groups.items():
            group = add(node, "def", name=name, abbrev=name, prefix=prefix)
            for value, number in values.items():
                add(group, "value", id=str(number), name=value, abbrev=value)
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


def _messages(root: Any, table: Table, add: Any) -> None:
    names = {kind: name for name, kind in XML_TYPES.items()}
    for message in table.by_id.values():
        facts = {"name": message.name, "abbrev": message.name, "source": "vehicle", "category": CATEGORY}
        node = add(root, "message", id=str(message.id), **facts)
        add(node, "description").text = message.name
        for part in message.fields:
            of = {"message_type": part.of} if part.of else {}
            add(node, "field", name=part.name, abbrev=part.name, type=names[part.kind], **of)
