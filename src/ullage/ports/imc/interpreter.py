"""IMC in ROS' own words, as the interpreter of the thesis had it [Billdal2018, 3.5.2]: one table and one converter.

`ros_types.txt` is the table. A line such as `Temperature <> temperature sensor_msgs/Temperature: temperature = value`
names an IMC message, the direction (`<>` both, `>` to ROS only), a topic, its ROS type, and the ROS fields with the
conversion (ros_fields.py) and the IMC fields that each is made of. Indented lines belong to the message above:
`+` another topic without which the message cannot be made, `?` one with more of its fields, `*` one whose last message
holds for all that follow, `=` values of IMC fields that the topics do not give, `#` a note. `NAME[field=number]` limits
a line to messages with that number. Lines with `!` give the reason why the messages they list have no ROS type.

ROS messages are plain dicts here, by topic, nested as the messages are, with those of their fields that are used.
"""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, NamedTuple

from ullage.errors import InputError
from ullage.ports.imc.codec import Message, make
from ullage.ports.imc.ros_fields import CONVERSIONS
from ullage.ports.imc.table import own

Ros = dict[str, dict[str, Any]]
"""ROS messages by topic."""
TYPES = Path(__file__).with_name("ros_types.txt")
HEAD = re.compile(r"(\w+)(?:\[(\w+)=(\d+)\])? (<>|>) (.*)")
PART = re.compile(r"([\w/]+) (\w+/\w+):(.*)")


class Entry(NamedTuple):
    """Field of a ROS message, with the IMC fields that it is made of."""

    path: tuple[str, ...]  # to the field; empty: the whole message
    how: str  # a key of CONVERSIONS, or `each`
    args: tuple[str, ...]


class Part(NamedTuple):
    """One ROS message of a row."""

    topic: str
    kind: str  # package/Name
    entries: tuple[Entry, ...]
    needed: bool = True  # to make the IMC message
    kept: bool = True  # for the messages that follow


@dataclass(slots=True)
class Row:
    """One IMC message, or those of it with a certain number in a field, and the ROS messages that say the same."""

    name: str
    both: bool  # directions; else to ROS only
    parts: list[Part]
    where: dict[str, int] = field(default_factory=dict)
    values: dict[str, int] = field(default_factory=dict)  # of IMC fields that no topic gives
    note: str = ""

    def matches(self, values: Mapping[str, Any]) -> bool:
        """Whether this row is for a message with these values."""
        return all(values[key] == number for key, number in self.where.items())


@dataclass(slots=True)
class Pair:
    """All rows of one IMC message."""

    rows: list[Row] = field(default_factory=list)

    @property
    def ros(self) -> dict[str, str]:
        """Topics and their types."""
        return {part.topic: part.kind for row in self.rows for part in row.parts}

    @property
    def both(self) -> bool:
        """Whether ROS nodes can send it."""
        return any(row.both for row in self.rows)

    def to_ros(self, values: Mapping[str, Any]) -> Ros:
        """The ROS messages that say what an IMC message of these values says; none where no row fits."""
        row = next((row for row in self.rows if row.matches(values)), None)
        return {} if row is None else {part.topic: _fields_out(part.entries, values) for part in row.parts}

    def to_imc(self, messages: Ros) -> dict[str, Any]:
        """The values of the IMC message that these ROS messages say.

        Raises:
            InputError: a ROS message that is needed is missing, or the row is for the other direction only.
        """
        row = next((row for row in self.rows if row.parts[0].topic in messages), self.rows[0])
        if not row.both:
            raise InputError(f"{row.name} goes from IMC to ROS only", where=row.parts[0].topic, allowed=row.note or "-")
        missing = [part.topic for part in row.parts if part.needed and part.topic not in messages]
        if missing:
            raise InputError(f"{row.name} also needs {missing[0]}", where=row.parts[0].topic)
        out: dict[str, Any] = dict(row.values)
        for part in row.parts:
            if part.topic in messages:
                out |= _fields_in(part.entries, messages[part.topic])
        return out | row.where


def _fields_out(entries: tuple[Entry, ...], values: Mapping[str, Any]) -> dict[str, Any]:
    out: dict[str, Any] = {}
    for entry in entries:
        found = _out(entry, values)
        if found is None:
            continue
        if not entry.path:
            out |= found
            continue
        inner = out
        for name in entry.path[:-1]:
            inner = inner.setdefault(name, {})
        inner[entry.path[-1]] = found
    return out


def _out(entry: Entry, values: Mapping[str, Any]) -> Any:
    if entry.how != "each":
        return CONVERSIONS[entry.how].out(values, entry.args)
    held = (one for one in values[entry.args[0]] if one is not None)
    return [_fields_out(PAIRS[one.name].rows[0].parts[0].entries, one.values) for one in held]


def _fields_in(entries: tuple[Entry, ...], given: Mapping[str, Any]) -> dict[str, Any]:
    out: dict[str, Any] = {}
    for entry in entries:
        value: Any = given
        for name in entry.path:
            value = value.get(name) if isinstance(value, Mapping) else None
        if value is None:
            continue
        if entry.how == "each":
            out[entry.args[0]] = tuple(_inner(entry.args[1], one) for one in value)
        elif (back := CONVERSIONS[entry.how].back) is not None:
            out |= back(value, entry.args)
    return out


def _inner(kind: str, given: Mapping[str, Any]) -> Message:
    return make(kind, **_fields_in(PAIRS[kind].rows[0].parts[0].entries, given))


def _entry(text: str, name: str) -> Entry:
    left, _, right = (word.strip() for word in text.partition("="))
    words = tuple(right.split())
    path = () if left == "." else tuple(left.split("."))
    if words[0] == "each":
        of = next(part.of for part in own().named(name).fields if part.name == words[1])
        return Entry(path, "each", (words[1], of))
    if len(words) > 1 and words[0] in CONVERSIONS:
        return Entry(path, words[0], words[1:])
    return Entry(path, "same", words)


def _part(text: str, name: str, mark: str = "+") -> Part:
    found = PART.fullmatch(text)
    if found is None:
        raise InputError(f"cannot read {text!r}", where=TYPES, allowed="TOPIC package/Type: FIELD = CONVERSION FIELDS")
    entries = tuple(_entry(one, name) for one in found[3].split(";") if one.strip())
    return Part(found[1], found[2], entries, needed=mark == "+", kept=mark != "?")


def read_rows(text: str) -> Iterator[Row]:
    """The rows of a table in the form of `ros_types.txt`."""
    row: Row | None = None
    for line in text.splitlines():
        if not line.startswith("  "):
            if row is not None:
                yield row
            found = HEAD.fullmatch(line)
            row = None
            if found is not None:
                where = {found[2]: int(found[3])} if found[2] else {}
                row = Row(found[1], found[4] == "<>", [_part(found[5], found[1])], where)
        elif row is not None:
            mark, rest = line[2], line[4:]
            if mark in "+?*":
                row.parts.append(_part(rest, row.name, mark))
            elif mark == "=":
                row.values |= {key: int(number) for key, number in (word.split() for word in rest.split(";"))}
            else:
                row.note = rest
    if row is not None:
        yield row


def _read_pairs() -> dict[str, Pair]:
    out: dict[str, Pair] = {}
    for row in read_rows(TYPES.read_text()):
        out.setdefault(row.name, Pair()).rows.append(row)
    return out


def _read_reasons() -> dict[str, str]:
    lines = (line[2:].rpartition(": ") for line in TYPES.read_text().splitlines() if line.startswith("! "))
    return {name: reason for reason, _, names in lines for name in names.split()}


PAIRS: dict[str, Pair] = _read_pairs()
"""By IMC message: what ROS has a type for."""
REASONS: dict[str, str] = _read_reasons()
"""By IMC message: why ROS has no type for it."""


def interpreted(message: Message) -> Ros | None:
    """The message in ROS' words; None where the table has none."""
    pair = PAIRS.get(message.name)
    return None if pair is None else pair.to_ros(message.values)


def imc_of(kind: str, messages: Ros) -> Message:
    """The IMC message of this kind that these ROS messages say.

    Raises:
        InputError: a ROS message that is needed is missing, or the kind goes to ROS only.
    """
    return make(kind, **PAIRS[kind].to_imc(messages))


def rows_of(topic: str) -> Row | None:
    """The row whose IMC message a topic belongs to; None where the table has no such topic."""
    return next(
        (row for pair in PAIRS.values() for row in pair.rows for part in row.parts if part.topic == topic), None
    )
