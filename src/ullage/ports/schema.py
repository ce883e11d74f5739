"""Every message and topic that ullage speaks, said once, and its bytes (CDR).

The definitions are ROS 2's own: name, type, unit and meaning of each field. The numpy layouts of messages that come by
the thousand, the encoder and decoder of all others, the schemas of recordings, the ament packages and the
documentation's page of messages are made from them. `TOPICS` names what is published, `QUALITIES` how.
"""

from __future__ import annotations

import re
import struct
from collections.abc import Callable, Iterator, Mapping
from contextlib import suppress
from functools import lru_cache
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal, NamedTuple, cast

import numpy as np
from numpy.typing import NDArray

from ullage.arrays import Longs
from ullage.errors import InputError

if TYPE_CHECKING:
    from rosbags.typesys.store import Typestore

FRAME = "ullage_msgs/msg/RadarFrame"
SETTINGS = "ullage_msgs/msg/RadarSettings"
TRACK = "ullage_msgs/msg/Track"
CELLS = "ullage_msgs/msg/CellMap"
RAW = "imc_msgs/msg/Raw"
CLOUD = "sensor_msgs/msg/PointCloud2"
RANGE = "sensor_msgs/msg/Range"
SCAN = "sensor_msgs/msg/LaserScan"
PICTURE = "sensor_msgs/msg/Image"
IMU = "sensor_msgs/msg/Imu"
JOY = "sensor_msgs/msg/Joy"
FIX = "sensor_msgs/msg/NavSatFix"
GRID = "nav_msgs/msg/OccupancyGrid"
UPDATE = "map_msgs/msg/OccupancyGridUpdate"
ODOMETRY = "nav_msgs/msg/Odometry"
PATH = "nav_msgs/msg/Path"
TRANSFORMS = "tf2_msgs/msg/TFMessage"
POSE = "geometry_msgs/msg/PoseStamped"
COVARIANT_POSE = "geometry_msgs/msg/PoseWithCovarianceStamped"
TWIST = "geometry_msgs/msg/Twist"
TWIST_STAMPED = "geometry_msgs/msg/TwistStamped"
MARKERS = "visualization_msgs/msg/MarkerArray"
CLOCK = "rosgraph_msgs/msg/Clock"
DIAGNOSTICS = "diagnostic_msgs/msg/DiagnosticArray"
PILOT_VELOCITY, PILOT_PLACE = "pilot/cmd_vel", "pilot/pose"
"""Topics of the commands that a vehicle got: what is published on `cmd_vel` would come back as a command."""

MESSAGES = Path(__file__).with_name("messages")
"""Folder of the definitions and of the table of topics."""
DEFINITIONS = {
    kind: (MESSAGES / f"{kind}.msg").read_text(encoding="utf-8")
    for kind in (FRAME, SETTINGS, TRACK, CELLS, RAW, TRANSFORMS, UPDATE)
}
"""Text of each message of ullage, and of two public ones that environments may lack."""


Quality = Literal["sensor", "stream", "transforms", "latched", "relayed"]
"""How a topic is sent; `QUALITIES` has the numbers."""


class Service(NamedTuple):
    """Quality of service."""

    depth: int
    reliable: bool
    kept: bool  # for late subscribers: transient local


QUALITIES: dict[Quality, Service] = {
    "sensor": Service(5, reliable=False, kept=False),  # as rclcpp's SensorDataQoS
    "stream": Service(50, reliable=True, kept=False),
    "transforms": Service(100, reliable=True, kept=False),  # as tf2_ros' DynamicBroadcasterQoS
    "latched": Service(1, reliable=True, kept=True),  # as nav2's and map_server's maps, and StaticBroadcasterQoS
    "relayed": Service(1000, reliable=True, kept=False),  # several belong together: none may be missing
}


class Topic(NamedTuple):
    """A topic that ullage publishes and records."""

    kind: str  # `package/msg/Name`
    quality: Quality
    about: str


def _topic(line: str) -> tuple[str, Topic]:
    """A line of `topics.txt`: topic, type, quality, and what it says."""
    name, kind, quality, about = line.split(" | ")
    return name, Topic(kind, cast("Quality", quality), about)


TOPICS = dict(map(_topic, (MESSAGES / "topics.txt").read_text(encoding="utf-8").splitlines()))
"""What is published, and recorded, by topic: NAME stands for a radar, and / for what has no namespace."""


@lru_cache(1)
def typestore() -> Typestore:
    """The types of ROS 2 Jazzy, ullage's own, and those that it speaks beside them."""
    from rosbags.typesys import Stores, get_types_from_msg, get_typestore

    store = get_typestore(Stores.ROS2_JAZZY)
    for name, text in DEFINITIONS.items():
        if name not in store.types:
            store.register(get_types_from_msg(text, name))
    return store


LEARN: dict[str, Callable[[str], object]] = {}
"""Adds a message to `typestore` by its name, for each package of messages that another port defines."""


def knows(name: str) -> bool:
    """Whether the definition of a message, `package/msg/Name`, is known or can be learnt."""
    package, _, short = name.partition("/msg/")
    if name not in typestore().types and package in LEARN:
        with suppress(InputError):
            LEARN[package](short)
    return name in typestore().types


def schema_text(name: str) -> str:
    """The definition of a message with all it refers to, as rosbag2 and Foxglove want it."""
    text: str = typestore().generate_msgdef(name, ros_version=2)[0]
    return text


def make(name: str, *values: Any) -> Any:
    """One message from the values of its fields in order."""
    return typestore().types[name](*values)


def header(t_ns: int, frame_id: str) -> Any:
    """A std_msgs/Header."""
    sec, nanosec = divmod(t_ns, 1_000_000_000)
    return make("std_msgs/msg/Header", make("builtin_interfaces/msg/Time", sec, nanosec), frame_id)


def to_bytes(name: str, message: Any) -> bytes:
    """A message of this type as CDR."""
    return bytes(typestore().serialize_cdr(message, name))


def from_bytes(name: str, data: bytes) -> Any:
    """A message of this type from CDR."""
    return typestore().deserialize_cdr(data, name)


def topic_name(sensor: str) -> str:
    """The sensor's name as ROS allows it in a topic."""
    name = re.sub(r"[^A-Za-z0-9_]+", "_", sensor).strip("_") or "radar"
    return name if not name[0].isdigit() else f"radar_{name}"


Size = bytes | int
"""Of a part that has no fixed size: the text of a string, or the length of a sequence."""


@lru_cache(1024)
def _fields(kind: str) -> dict[str, Any]:
    """What each field of a message is, by name: the node of `rosbags`."""
    return dict(typestore().fielddefs[kind][1])


def _number(name: str) -> np.dtype[Any]:
    return np.dtype({"bool": "u1", "byte": "u1", "char": "u1"}.get(name, name)).newbyteorder("<")


def _numbers(kind: str) -> list[str]:
    """Types of the numbers that a message consists of; [""] for one that holds anything else."""
    out: list[str] = []
    for node, about in _fields(kind).values():
        out += _numbers(about) if node.name == "NAME" else [about[0] if node.name == "BASE" else ""]
    return out if len(set(out)) == 1 and out[0] != "string" else [""]


def _parts(kind: str, sizes: Iterator[Size], prefix: str = "") -> Iterator[tuple[str, Any]]:
    """Name of each part of a message, and the text, count, numpy type, or type and shape that stands there."""
    for field, (node, about) in _fields(kind).items():
        name = prefix + field
        if node.name == "BASE":
            yield name, next(sizes) if about[0] == "string" else _number(about[0])
        elif node.name == "NAME":
            numbers = _numbers(about)
            if numbers[0]:
                yield name, (_number(numbers[0]), (len(numbers),))
            else:
                yield from _parts(about, sizes, f"{name}.")
        else:
            (inner, each), count = about
            if node.name == "SEQUENCE":
                yield f"{name}.count", (count := next(sizes))
            if inner.name == "NAME":
                for index in range(count):
                    yield from _parts(each, sizes, f"{name}.{index}.")
            else:
                yield name, (_number(each[0]), (count,))


class Layout:
    """The bytes of messages whose strings and sequences do not change their sizes, as a numpy record.

    Building many such messages is then filling columns. CDR aligns each number to its own size, counted from after
    the four bytes that say little endian. A message of numbers of one type, such as a pose, is one column.

    Args:
        kind: `package/msg/Name`.
        sizes: texts of its strings and lengths of its sequences, in their order.
    """

    def __init__(self, kind: str, *sizes: Size) -> None:
        names, formats, offsets, at = ["cdr"], [np.dtype("V4")], [0], 4
        self._constants: list[tuple[str, Any]] = [("cdr", np.void(b"\0\1\0\0"))]

        def add(name: str, form: Any, constant: Any = None, *, align: int) -> None:
            nonlocal at
            form = np.dtype(form)
            at += -(at - 4) % align if form.itemsize else 0
            names.append(name)
            formats.append(form)
            offsets.append(at)
            at += form.itemsize
            if constant is not None:
                self._constants.append((name, constant))

        for name, part in _parts(kind, iter(sizes)):
            if isinstance(part, bytes):
                add(f"{name}.size", "<u4", len(part) + 1, align=4)
                add(name, f"V{len(part) + 1}", np.void(part + b"\0"), align=1)
            elif isinstance(part, int):
                add(name, "<u4", part, align=4)
            else:
                add(name, part, align=(part[0] if isinstance(part, tuple) else part).itemsize)
        self.dtype = np.dtype({"names": names, "formats": formats, "offsets": offsets, "itemsize": at})
        self._times = [name.removesuffix("nanosec") for name in names if name.endswith(".nanosec")]

    def fill(self, t_ns: Longs, /, columns: Mapping[str, Any] | None = None) -> list[bytes]:
        """Return a message for each time (n) [ns], with the columns filled; the rest is zero.

        Raises:
            InputError: a time is beyond what ROS can say.
        """
        if len(t_ns) and not (t_ns.min() >= 0 and t_ns.max() < 2**31 * 1_000_000_000):
            raise InputError("a time cannot be recorded", where="t_ns", allowed="0 .. 2^31 s in nanoseconds")
        records: NDArray[np.void] = np.zeros(len(t_ns), self.dtype)
        for name, constant in self._constants:
            records[name] = constant
        for time in self._times:
            records[f"{time}sec"], records[f"{time}nanosec"] = t_ns // 1_000_000_000, t_ns % 1_000_000_000
        for name, column in (columns or {}).items():
            records[name] = column
        whole, size = records.tobytes(), self.dtype.itemsize
        return [whole[i : i + size] for i in range(0, len(whole), size)]


layout = lru_cache(512)(Layout)


def encoded(kind: str, fields: Mapping[str, Any], *, t_ns: int = 0, frame_id: str = "") -> bytes:
    """A message with these fields as CDR; the others are zero.

    Args:
        kind: `package/msg/Name`.
        fields: by name; messages within as mappings, or as their values in order.
        t_ns: of its header, where it has one.
        frame_id: of its header.

    Raises:
        InputError: it has no such field, or the value does not fit.
    """
    if "header" in _fields(kind):
        fields = {"header": header(max(t_ns, 0), frame_id), **fields}
    try:
        return to_bytes(kind, _made(kind, fields))
    except (TypeError, ValueError, AttributeError, KeyError, OverflowError, struct.error) as error:
        raise InputError(f"not a {kind}: {error}", where="fields") from None


def _made(kind: str, given: Any) -> Any:
    about = _fields(kind)
    if isinstance(given, tuple):
        given = dict(zip(about, given, strict=True))
    elif not isinstance(given, Mapping):
        return given
    if unknown := given.keys() - about.keys():
        raise InputError(f"no field {min(unknown)!r}", where=kind, allowed=", ".join(about))
    return typestore().types[kind](*(_value(of, given.get(name)) for name, of in about.items()))


def _value(of: Any, given: Any) -> Any:
    node, about = of
    if node.name == "NAME":
        return _made(about, {} if given is None else given)
    if node.name == "BASE":
        return given if given is not None else "" if about[0] == "string" else 0
    (inner, each), size = about
    if inner.name == "NAME":
        return _several(each, given)
    if each[0] == "string":
        return list(given or [])
    if isinstance(given, bytes | bytearray | memoryview):
        return np.frombuffer(bytes(given), np.uint8)
    return np.asarray(given, each[0]) if given is not None else np.zeros(size, each[0])


def _several(kind: str, given: Any) -> list[Any]:
    if isinstance(given, np.ndarray):  # numbers (n, fields), by the thousand
        made = typestore().types[kind]
        return [made(*row) for row in given.tolist()]
    return [_made(kind, one) for one in given or []]


def decoded(kind: str, data: bytes) -> dict[str, Any]:
    """The fields of a message as plain values, nested as the messages are; bytes for sequences of bytes.

    Raises:
        InputError: these bytes are none.
    """
    if kind not in typestore().types:
        raise InputError(f"messages of type {kind} are not known", where="kind")
    try:
        fields: dict[str, Any] = _plain(from_bytes(kind, data))
    except Exception as error:  # a stranger's bytes: the reader's complaints are of every kind
        raise InputError(f"{len(data)} bytes are no {kind}", where="data") from error
    return fields


def _plain(value: Any) -> Any:
    if isinstance(value, np.ndarray):
        return value.tobytes() if value.dtype == np.uint8 else value.tolist()
    if isinstance(value, list):
        return [_plain(one) for one in value]
    if (kind := getattr(value, "__msgtype__", None)) is not None:
        return {name: _plain(getattr(value, name)) for name in _fields(kind)}
    return value
