"""ROS 2 messages: their definitions and their bytes (CDR).

Messages that come by the thousand are built as numpy records of one layout, which takes microseconds; the rest goes
through the `rosbags` types.
"""

from __future__ import annotations

import re
from collections.abc import Callable
from contextlib import suppress
from functools import lru_cache
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from ullage.arrays import Longs
from ullage.errors import InputError

if TYPE_CHECKING:
    from rosbags.typesys.store import Typestore

Records = NDArray[np.void]
Text = bytes | str | tuple[str | np.dtype[Any], int]

FRAME = "ullage_msgs/msg/RadarFrame"
SETTINGS = "ullage_msgs/msg/RadarSettings"
TRACK = "ullage_msgs/msg/Track"
CELLS = "ullage_msgs/msg/CellMap"
CLOUD = "sensor_msgs/msg/PointCloud2"
GRID = "nav_msgs/msg/OccupancyGrid"
ODOMETRY = "nav_msgs/msg/Odometry"
TRANSFORMS = "tf2_msgs/msg/TFMessage"
POSE = "geometry_msgs/msg/PoseStamped"
TWIST = "geometry_msgs/msg/Twist"
RAW = "imc_msgs/msg/Raw"
MARKERS = "visualization_msgs/msg/MarkerArray"
UPDATE = "map_msgs/msg/OccupancyGridUpdate"

DEFINITIONS = {
    FRAME: """\
# One frame of one ultra-wideband radar, without loss.
uint8 BASEBAND=0  # samples are re, im, re, im, ...
uint8 REAL=1      # one sample a bin: RF or amplitude
std_msgs/Header header  # when, and the frame of reference of the sensor: x along its boresight
string sensor
uint32 index            # counts the frames of this sensor
uint8 kind
bool has_believed
bool has_truth
float64 range_start     # range of bin 0 [m]
float64 range_step      # mean range between bins [m]
geometry_msgs/Pose believed        # world from sensor, as the drone believes
geometry_msgs/Twist believed_rate  # linear in the world, angular in the sensor's frame
geometry_msgs/Pose truth           # world from sensor, as it was
geometry_msgs/Twist truth_rate
float32[] samples
""",
    SETTINGS: """\
# What holds for all frames of one radar until the next message of this kind.
std_msgs/Header header
string sensor
string unit         # path_gain: sqrt(received / transmitted power); normalised: the sensor's own; thesis: eq. 4.2
string settings     # JSON, the fields of ullage.RadarSpec
string calibration  # JSON, the fields of ullage.data.Calibration; empty if none
float64[] range     # of each bin [m]
""",
    TRACK: """\
# The whole track of one sensor in the clock of whatever measured it.
std_msgs/Header header
string sensor
int64[] time      # [ns], rising
float64[] state   # 13 a time: position [m], quaternion xyzw, velocity [m/s] in the world, rate [rad/s] in the sensor
""",
    CELLS: """\
# A map of square cells on a plane or cubes in a volume, without loss.
std_msgs/Header header
string method
float64[3] origin      # lower corner of the first cell [m]; z of a plane may be NaN
float64 step           # edge of a cell [m]
uint32[] shape         # ny nx, or nz ny nx
int8 occupied_from     # percent at and above which a cell counts as occupied
int8 free_to           # percent at and below which it counts as free
int8[] percent         # 0..100 occupied, -1 unknown, -2 ambiguous; x runs fastest
""",
    RAW: """\
# One packet of IMC, the protocol of DUNE and Neptus, without loss.
std_msgs/Header header  # time of the packet
string name             # of its message; empty if unknown
uint16 id               # number of its message
uint16 src              # address of the system that sent it
uint8 src_ent           # and number of the part of it
uint16 dst              # address of the system that it is for; 65535: all
uint8 dst_ent
uint8[] data            # every byte, from sync to checksum
""",
    # two of the public interfaces, for environments that lack their packages
    TRANSFORMS: "geometry_msgs/TransformStamped[] transforms\n",
    UPDATE: "std_msgs/Header header\nint32 x\nint32 y\nuint32 width\nuint32 height\nint8[] data\n",
}


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


class Layout:
    """The bytes of a message whose strings and array lengths do not change, as a numpy record.

    Building many such messages is then filling columns. CDR aligns each number to its own size, counted from after
    the four bytes that say little endian.

    Args:
        fields: name and what is there: the text of a string, a numpy type, or a type and how often.
    """

    def __init__(self, *fields: tuple[str, Text]) -> None:
        names: list[str] = []
        formats: list[Any] = []
        offsets: list[int] = []
        self.texts: dict[str, bytes] = {}
        at = 4
        for name, kind in fields:
            if isinstance(kind, bytes):
                at += -at % 4
                self.texts[name] = kind + b"\0"
                names += [f"{name}.len", name]
                formats += ["<u4", f"V{len(kind) + 1}"]
                offsets += [at, at + 4]
                at += 5 + len(kind)
                continue
            base, count = kind if isinstance(kind, tuple) else (kind, 1)
            dtype = np.dtype(base)
            at += -(at - 4) % (1 if dtype.kind == "V" else dtype.itemsize)
            names.append(name)
            formats.append((dtype, (count,)) if isinstance(kind, tuple) else dtype)
            offsets.append(at)
            at += dtype.itemsize * count
        self.dtype = np.dtype({"names": names, "formats": formats, "offsets": offsets, "itemsize": at})
        self._blank = self._template()

    def _template(self) -> NDArray[np.uint8]:
        out: Records = np.zeros(1, self.dtype)
        out.view(np.uint8)[1] = 1
        for name, text in self.texts.items():
            out[f"{name}.len"] = len(text)
            out[name] = np.frombuffer(text, f"V{len(text)}")[0]
        return out.view(np.uint8)

    def fill(self, n: int, /, **columns: Any) -> list[bytes]:
        """`n` messages with the strings in place and these columns filled; the rest is zero."""
        records: Records = np.tile(self._blank, n).view(self.dtype)
        for name, value in columns.items():
            records[name] = value
        whole, size = records.tobytes(), self.dtype.itemsize
        return [whole[i : i + size] for i in range(0, len(whole), size)]


def stamps(t_ns: Longs) -> dict[str, NDArray[np.int64]]:
    """Columns of a header's time.

    Raises:
        InputError: a time is beyond what ROS can say.
    """
    if len(t_ns) and not (t_ns.min() >= 0 and t_ns.max() < 2**31 * 1_000_000_000):
        raise InputError("a time cannot be recorded", where="t_ns", allowed="0 .. 2^31 s in nanoseconds")
    return {"sec": t_ns // 1_000_000_000, "nanosec": t_ns % 1_000_000_000}


HEADER = (("sec", "<i4"), ("nanosec", "<u4"))


@lru_cache(256)
def frame_layout(frame_id: bytes, sensor: bytes, floats: int) -> Layout:
    """RadarFrame with `floats` numbers in its samples."""
    return Layout(
        *HEADER, ("frame_id", frame_id), ("sensor", sensor), ("index", "<u4"), ("kind", "u1"),
        ("has_believed", "u1"), ("has_truth", "u1"), ("range_start", "<f8"), ("range_step", "<f8"),
        ("believed", ("<f8", 13)), ("truth", ("<f8", 13)), ("count", "<u4"), ("samples", ("<f4", floats)),
    )  # fmt: skip


@lru_cache(64)
def transform_layout(parent: bytes, children: tuple[bytes, ...]) -> Layout:
    """TFMessage with a transform for each child."""
    fields: list[tuple[str, Text]] = [("count", "<u4")]
    for i, child in enumerate(children):
        fields += [(f"sec{i}", "<i4"), (f"nanosec{i}", "<u4"), (f"parent{i}", parent), (f"child{i}", child)]
        fields += [(f"pose{i}", ("<f8", 7))]
    return Layout(*fields)


@lru_cache(16)
def odometry_layout(parent: bytes, child: bytes) -> Layout:
    """Odometry."""
    return Layout(
        *HEADER, ("parent", parent), ("child", child), ("pose", ("<f8", 7)), ("pose_covariance", ("<f8", 36)),
        ("twist", ("<f8", 6)), ("twist_covariance", ("<f8", 36)),
    )  # fmt: skip


CODES = {"float32": 7, "float64": 8, "uint32": 6, "int32": 5}


@lru_cache(256)
def cloud_layout(frame_id: bytes, fields: tuple[tuple[str, str], ...], points: int) -> Layout:
    """PointCloud2 of `points` points that have these named fields; fill `columns_of` with what does not change."""
    described: list[tuple[str, Text]] = []
    for i, (name, _) in enumerate(fields):
        described += [(f"name{i}", name.encode()), (f"offset{i}", "<u4"), (f"code{i}", "u1"), (f"many{i}", "<u4")]
    return Layout(
        *HEADER, ("frame_id", frame_id), ("height", "<u4"), ("width", "<u4"), ("fields", "<u4"), *described,
        ("bigendian", "u1"), ("point_step", "<u4"), ("row_step", "<u4"), ("size", "<u4"),
        ("data", (np.dtype(list(fields)), points)), ("dense", "u1"),
    )  # fmt: skip


def cloud_columns(fields: tuple[tuple[str, str], ...], points: int) -> dict[str, Any]:
    """The columns of a `cloud_layout` that do not change."""
    dtype = np.dtype(list(fields))
    out: dict[str, Any] = {"height": 1, "width": points, "fields": len(fields), "point_step": dtype.itemsize}
    out |= {"row_step": dtype.itemsize * points, "size": dtype.itemsize * points}
    for i, (name, kind) in enumerate(fields):
        out |= {f"offset{i}": dtype.fields[name][1], f"code{i}": CODES[kind], f"many{i}": 1}  # type: ignore[index]
    return out
