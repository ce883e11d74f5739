"""IMC in ROS' own words, as the interpreter of the thesis had it [Billdal2018, 3.5.2]: one table and one converter.

`ros_types.txt` is the table. A line such as `Temperature <> temperature sensor_msgs/Temperature: temperature = value`
names an IMC message, the direction (`<>` both, `>` to ROS only), a topic, its ROS type, and the ROS fields with the
conversion and the IMC fields that each is made of. Indented lines belong to the message above:
`+` another topic without which the message cannot be made, `?` one with more of its fields, `*` one whose last message
holds for all that follow, `=` values of IMC fields that the topics do not give, `#` a note. `NAME[field=number]` limits
a line to messages with that number. Lines with `!` give the reason why the messages they list have no ROS type.

IMC has north-east-down and forward-right-down axes and headings clockwise from north. ROS has east-north-up and
forward-left-up axes and angles counter-clockwise from east (REP-103).

ROS messages are plain dicts here, by topic, nested as the messages are, with those of their fields that are used.
"""

from __future__ import annotations

import json
import math
import re
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from ullage.arrays import Floats
from ullage.errors import InputError
from ullage.geometry import matrix_quat, quat_matrix, quat_rpy, rpy_quat
from ullage.ports.imc.codec import Message, make
from ullage.ports.imc.table import own
from ullage.ports.ned import FLIP, SWAP

Ros = dict[str, dict[str, Any]]
"""ROS messages by topic."""
TYPES = Path(__file__).with_name("ros_types.txt")
HEAD = re.compile(r"(\w+)(?:\[(\w+)=(\d+)\])? (<>|>) (.*)")
PART = re.compile(r"([\w/]+) (\w+/\w+):(.*)")
Values = Mapping[str, Any]
Out = Callable[[Values, tuple[str, ...]], Any]
Back = Callable[[Any, tuple[str, ...]], dict[str, Any]]


class Conversion(NamedTuple):
    """How to make a ROS field of IMC fields, and IMC fields of a ROS field; None: that direction has no meaning."""

    out: Out
    back: Back | None = None


def _scaled(factor: float) -> Conversion:
    return Conversion(lambda m, a: m[a[0]] * factor, lambda value, a: {a[0]: value / factor})


def _vector(turn: Floats) -> Conversion:
    """Three fields as a vector in other axes; a fourth argument is a factor."""

    def factor(args: tuple[str, ...]) -> float:
        return float(args[3]) if len(args) > 3 else 1.0

    def out(m: Values, args: tuple[str, ...]) -> Any:
        turned = turn @ np.array([m[name] for name in args[:3]], float) * factor(args)
        return dict(zip("xyz", map(float, turned), strict=True))

    def back(value: Any, args: tuple[str, ...]) -> dict[str, Any]:
        numbers = turn @ np.array([value[k] for k in "xyz"], float) / factor(args)
        return dict(zip(args[:3], map(float, numbers), strict=True))

    return Conversion(out, back)


def _attitude(turn: Floats) -> Conversion:
    """Roll, pitch and yaw as a quaternion; `turn` changes the axes of the outer frame, the body's become FLU."""

    def out(m: Values, args: tuple[str, ...]) -> Any:
        quat = matrix_quat(turn @ quat_matrix(rpy_quat(*(float(m[name]) for name in args))) @ FLIP)
        return dict(zip("xyzw", map(float, quat), strict=True))

    def back(value: Any, args: tuple[str, ...]) -> dict[str, Any]:
        angles = quat_rpy(matrix_quat(turn @ quat_matrix([value[k] for k in "xyzw"]) @ FLIP))
        return dict(zip(args, map(float, angles), strict=True))

    return Conversion(out, back)


def _polar_out(m: Values, args: tuple[str, ...]) -> dict[str, float]:
    """A speed and a course clockwise from north as a vector in ENU."""
    speed, course = m[args[0]], m[args[1]]
    return {"x": speed * math.sin(course), "y": speed * math.cos(course), "z": 0.0}


def _polar_back(value: Any, args: tuple[str, ...]) -> dict[str, Any]:
    course = math.atan2(value["x"], value["y"]) % math.tau
    return {args[0]: math.hypot(value["x"], value["y"]), args[1]: course}


def stamp_of(seconds: float) -> dict[str, int]:
    """Return a time [s] as ROS divides it."""
    whole = math.floor(seconds)
    nanosec = min(round((seconds - whole) * 1e9), 999_999_999)
    return {"sec": whole, "nanosec": nanosec}


def _seconds(stamp: Any) -> float:
    return float(stamp["sec"] + stamp["nanosec"] * 1e-9)


def _constant(word: str) -> Any:
    """A number, true, false, or a word."""
    if word in ("true", "false"):
        return word == "true"
    try:
        return int(word)
    except ValueError:
        pass
    try:
        return float(word)
    except ValueError:
        return word


def _numbered(levels: Mapping[int, int]) -> Conversion:
    """A level of a log as `rcl_interfaces/Log` numbers it."""
    named = {level: number for number, level in reversed(list(levels.items()))}

    def back(value: Any, args: tuple[str, ...]) -> dict[str, Any]:
        return {args[0]: named[min(named, key=lambda level: abs(level - value))]}

    return Conversion(lambda m, a: levels.get(m[a[0]], 20), back)


_ENCODINGS = {8: "8UC1", 16: "16UC1", 32: "32SC1"}


CONVERSIONS: dict[str, Conversion] = {
    "same": Conversion(lambda m, a: m[a[0]], lambda value, a: {a[0]: value}),
    "const": Conversion(lambda m, a: _constant(a[0])),
    "times": Conversion(lambda m, a: m[a[1]] * float(a[0]), lambda value, a: {a[1]: value / float(a[0])}),
    "degrees": _scaled(180 / math.pi),
    "negative": _scaled(-1.0),
    "heading": Conversion(lambda m, a: math.pi / 2 - m[a[0]], lambda value, a: {a[0]: math.pi / 2 - value}),
    "whole": Conversion(lambda m, a: float(m[a[0]]), lambda value, a: {a[0]: round(value)}),
    "enu": _vector(SWAP),
    "flu": _vector(FLIP),
    "attitude": _attitude(SWAP),
    "mount": _attitude(FLIP),
    "polar": Conversion(_polar_out, _polar_back),
    "stamp": Conversion(lambda m, a: None, lambda value, a: {a[0]: _seconds(value["stamp"])}),
    "time": Conversion(lambda m, a: stamp_of(m[a[0]]), lambda value, a: {a[0]: _seconds(value)}),
    "variances": Conversion(
        lambda m, a: np.diag([float(m[name]) ** 2 for name in a]).ravel().tolist(),
        lambda value, a: {name: math.sqrt(max(float(value[4 * k]), 0.0)) for k, name in enumerate(a)},
    ),
    "valid": Conversion(
        lambda m, a: float(m[a[0]]) if m[a[1]] else math.inf,
        lambda value, a: {a[0]: value if math.isfinite(value) else 0.0, a[1]: int(math.isfinite(value))},
    ),
    # BIT FIELD SET CLEAR: a number for the bit set, and one for the bit clear
    "flag": Conversion(
        lambda m, a: int(a[2] if m[a[1]] & int(a[0]) else a[3]),
        lambda value, a: {a[1]: 0 if value == int(a[3]) else int(a[0])},
    ),
    "equals": Conversion(lambda m, a: m[a[0]] == int(a[1]), lambda value, a: {a[0]: int(a[1] if value else a[2])}),
    # FIELD NUMBERS: ERROR of DiagnosticStatus for these numbers; without numbers, for any but 0
    "level": Conversion(lambda m, a: 2 if (m[a[0]] in map(int, a[1:]) if len(a) > 1 else m[a[0]]) else 0),
    "json": Conversion(
        lambda m, a: [{"key": name, "value": json.dumps(m[name])} for name in a],
        lambda value, a: {pair["key"]: json.loads(pair["value"]) for pair in value if pair["key"] in a},
    ),
    "log_level": _numbered({0: 20, 1: 30, 2: 40, 3: 50, 4: 10}),
    "log_severity": _numbered({0: 50, 1: 50, 2: 50, 3: 40, 4: 30, 5: 20, 6: 20, 7: 10}),
    "image_width": Conversion(lambda m, a: len(m[a[0]]) // max(m[a[1]] // 8, 1)),
    "image_encoding": Conversion(
        lambda m, a: _ENCODINGS.get(m[a[0]], "8UC1"),
        lambda value, a: {a[0]: next((bits for bits, name in _ENCODINGS.items() if name == value), 8)},
    ),
    # a field of the first message of a list; 0 where the list is empty
    "first": Conversion(lambda m, a: float(m[a[0]][0][a[1]]) if m[a[0]] and m[a[0]][0] is not None else 0.0),
    "label": Conversion(lambda m, a: [f"{a[0]}_{m[a[1]]}"]),
    "list": Conversion(lambda m, a: [float(m[a[0]])]),
}
"""By the word that `ros_types.txt` uses; the arguments are names of IMC fields and numbers."""


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
            field_name, kind = entry.args
            parts = PAIRS[kind].rows[0].parts[0].entries
            out[field_name] = tuple(make(kind, **_fields_in(parts, one)) for one in value)
        elif (back := CONVERSIONS[entry.how].back) is not None:
            out |= back(value, entry.args)
    return out


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


PAIRS: dict[str, Pair] = _read_pairs()
"""By IMC message: what ROS has a type for."""


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
