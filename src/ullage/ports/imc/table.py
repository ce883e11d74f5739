"""The 349 messages of IMC 5.4.31 [MartinsEtAl2009] as a table of our own; a user's IMC.xml can take its place.

A line of `messages.txt` that begins with a number is one message: its number, its name, and its fields in order. Kinds
of field: signed, unsigned and floating numbers by width in bits (`u8 i16 f64`), `text` (UTF-8), `raw` (bytes),
`message` (one, or none) and `messages` (a list), the last two with the kind of message that belongs there. The unit
follows the name. Indented lines give what the numbers of a field stand for: one of them (=) or a sum of bits (|). The
lines at the top define the sets of numbers that several fields share.
"""

from __future__ import annotations

import struct
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from functools import lru_cache, partial
from itertools import groupby
from pathlib import Path
from typing import Any

from ullage.errors import InputError

VERSION = (5, 4)
NUMBERS = {"u8": "B", "i8": "b", "u16": "H", "i16": "h", "u32": "I", "i32": "i", "i64": "q", "f32": "f", "f64": "d"}
HELD = ("text", "raw", "message", "messages")

MESSAGES = Path(__file__).with_name("messages.txt")
MEANINGS = {"=": "Enumerated", "|": "Bitfield"}


@dataclass(frozen=True, slots=True)
class Values:
    """Meanings of the numbers of a field."""

    unit: str  # Enumerated: one of them; Bitfield: a sum of them
    numbers: Mapping[str, int]  # by name
    name: str = ""  # where several fields share them
    prefix: str = ""  # the same


@dataclass(frozen=True, slots=True)
class Field:
    """One field of a message."""

    name: str
    kind: str  # a key of NUMBERS, or one of HELD
    of: str = ""  # message(s): the kind that belongs there; empty: any
    unit: str = field(default="", compare=False)
    values: Values | None = field(default=None, compare=False)


@dataclass(frozen=True, slots=True)
class Kind:
    """One kind of message."""

    id: int
    name: str
    fields: tuple[Field, ...]
    runs: tuple[tuple[Field, ...], ...] = field(init=False, compare=False)  # numbers side by side, or one other
    packers: tuple[tuple[struct.Struct, ...], ...] = field(init=False, compare=False)  # little endian, big endian

    def __post_init__(self) -> None:
        parts = groupby(enumerate(self.fields), key=lambda at: -1 if at[1].kind in NUMBERS else at[0])
        runs = tuple(tuple(f for _, f in run) for _, run in parts)
        object.__setattr__(self, "runs", runs)
        object.__setattr__(self, "packers", tuple(tuple(_packer(run, order) for run in runs) for order in "<>"))

    def empty(self) -> dict[str, Any]:
        """Every field at zero, empty, or none."""
        blank: dict[str, Any] = {"text": "", "raw": b"", "message": None, "messages": ()}
        return {f.name: blank[f.kind] if f.kind in HELD else 0.0 if f.kind[0] == "f" else 0 for f in self.fields}


def _packer(run: tuple[Field, ...], order: str) -> struct.Struct:
    return struct.Struct(order + "".join(NUMBERS.get(f.kind, "H") for f in run))


class Table:
    """Messages by number and by name.

    Args:
        kinds: the messages.
        where: what they come from, for complaints.
    """

    def __init__(self, kinds: Iterator[Kind] | list[Kind], *, where: str = "IMC table") -> None:
        self.by_id: dict[int, Kind] = {}
        self.by_name: dict[str, Kind] = {}
        for kind in kinds:
            if kind.id in self.by_id or kind.name in self.by_name:
                raise InputError(f"message {kind.id} {kind.name} is there twice", where=where)
            self.by_id[kind.id] = self.by_name[kind.name] = kind

    def named(self, name: str) -> Kind:
        """The kind of this name.

        Raises:
            InputError: the table has none.
        """
        if name not in self.by_name:
            raise InputError(
                f"no IMC message {name!r}", where="message", allowed="see docs/dune.md, or give xml=IMC.xml"
            )
        return self.by_name[name]


@lru_cache(maxsize=1)
def own() -> Table:
    """The table that ships."""
    shared: dict[str, Values] = {}
    messages: list[tuple[str, dict[str, Values]]] = []  # a line, and the values of its fields
    for line in MESSAGES.read_text(encoding="utf-8").splitlines():
        if line[0].isdecimal():
            messages.append((line, {}))
            continue
        head, mark, rest = line.strip().partition(" = " if " = " in line else " | ")
        if line[0] == " ":
            messages[-1][1][head] = shared.get(rest) or _values(mark, rest)
        else:
            name, prefix = head.split()
            shared[name] = _values(mark, rest, name, prefix)
    return Table([_kind(line, values) for line, values in messages])


def _values(mark: str, rest: str, name: str = "", prefix: str = "") -> Values:
    pairs = (word.split() for word in rest.split(", "))
    return Values(MEANINGS[mark.strip()], {label: int(number) for number, label in pairs}, name, prefix)


def _kind(line: str, values: dict[str, Values]) -> Kind:
    head, _, rest = line.partition(":")
    number, name = head.split()
    fields = []
    for word in filter(None, rest.strip().split(", ")):
        kind, field_name, *unit = word.split()
        kind, _, of = kind.partition(":")
        fields.append(Field(field_name, kind, of, "".join(unit), values.get(field_name)))
    return Kind(int(number), name, tuple(fields))


XML_TYPES = {
    "int8_t": "i8", "uint8_t": "u8", "int16_t": "i16", "uint16_t": "u16", "int32_t": "i32", "uint32_t": "u32",
    "int64_t": "i64", "fp32_t": "f32", "fp64_t": "f64", "rawdata": "raw", "plaintext": "text",
    "message": "message", "message-list": "messages",
}  # fmt: skip


def from_xml(path: str | Path) -> Table:
    """The table of a user's IMC.xml.

    Raises:
        InputError: it cannot be read, is no definition of IMC, or of another major version.
    """
    from lxml import etree

    try:
        root = etree.parse(str(path), etree.XMLParser(resolve_entities=False, no_network=True)).getroot()
    except (OSError, etree.XMLSyntaxError) as error:
        raise InputError(f"cannot read: {error}", where=path, allowed="IMC.xml of the protocol") from None
    version = str(root.get("version", ""))
    if root.tag != "messages" or not version.startswith(f"{VERSION[0]}."):
        raise InputError(f"version {version or 'unknown'} of {root.tag}", where=path, allowed=f"IMC {VERSION[0]}.x")
    nodes = root.findall("message")
    names = {str(node.get("abbrev")) for node in nodes}  # a field may name a group of messages instead: any of them
    return Table([_xml_kind(node, names, path) for node in nodes], where=str(path))


def _xml_kind(node: Any, names: set[str], path: str | Path) -> Kind:
    try:
        fields = tuple(
            Field(str(f.get("abbrev")), XML_TYPES[f.get("type")], of if (of := f.get("message-type")) in names else "")
            for f in node.findall("field")
        )
        return Kind(int(node.get("id")), str(node.get("abbrev")), fields)
    except (KeyError, TypeError, ValueError):
        raise InputError("a message's definition cannot be understood", where=path, line=node.sourceline) from None


MEANING = {"u": "unsigned integer", "i": "signed integer", "f": "floating point number"}
DEFINED = {"Enumerated": "enum-def", "Bitfield": "bitfield-def"}


def to_xml(table: Table) -> bytes:
    """A definition of the protocol with these messages."""
    from jinja2 import Environment, StrictUndefined

    def type_of(kind: str) -> tuple[int, str]:
        numeric = kind in NUMBERS
        words = f"{kind[1:]} bit {MEANING[kind[0]]}" if numeric else kind
        return struct.calcsize(NUMBERS[kind]) if numeric else 0, words

    plain = Environment(autoescape=True, undefined=StrictUndefined, trim_blocks=True)
    page = plain.from_string(Path(__file__).with_name("imc.xml.jinja").read_text(encoding="utf-8"))
    text: str = page.render(
        version=f"{VERSION[0]}.{VERSION[1]}.31", types={name: type_of(kind) for name, kind in XML_TYPES.items()},
        shared=partial(shared, table), messages=table.by_id.values(), defined=DEFINED,
        xml_type={kind: name for name, kind in XML_TYPES.items()},
    )  # fmt: skip
    return text.encode()


def shared(table: Table, unit: str) -> list[Values]:
    """The sets of numbers that several fields share, by kind: Enumerated or Bitfield."""
    found = {part.values.name: part.values for kind in table.by_id.values() for part in kind.fields if part.values}
    return [values for name, values in found.items() if name and values.unit == unit]
