"""ROS 2 messages: their definitions, their bytes (CDR), and what they mean in ullage's types."""

from __future__ import annotations

from functools import lru_cache
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from ullage.data import Floats, Times

if TYPE_CHECKING:
    from rosbags.typesys.store import Typestore

Records = NDArray[np.void]
WORLD, BODY = "world", "base_link"

DEFINITIONS = {
    "ullage_msgs/msg/RadarFrame": """\
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
geometry_msgs/Pose truth           # as it was
geometry_msgs/Twist truth_rate
float32[] samples
""",
    "ullage_msgs/msg/RadarSettings": """\
# What holds for all frames of one radar until the next message of this kind.
std_msgs/Header header
string sensor
string unit       # path_gain: sqrt(received / transmitted power); normalised: the sensor's own; thesis: eq. 4.2
string settings   # JSON, the fields of ullage.RadarSpec
float64[] range   # of each bin [m]
""",
    "ullage_msgs/msg/CellMap": """\
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
}


@lru_cache(1)
def typestore() -> Typestore:
    """The types of ROS 2 Jazzy and ullage's own."""
    from rosbags.typesys import Stores, get_types_from_msg, get_typestore

    store = get_typestore(Stores.ROS2_JAZZY)
    for name, text in DEFINITIONS.items():
        store.register(get_types_from_msg(text, name))
    return store


def schema_text(name: str) -> str:
    """The definition of a message with all it refers to, as rosbag2 and Foxglove want it."""
    text: str = typestore().generate_msgdef(name, ros_version=2)[0]
    return text


class Layout:
    """The bytes of a message whose strings and array lengths do not change, as a numpy record.

    Building many such messages then is filling columns. CDR aligns each number to its own size, counted from after
    the four bytes that say little endian.

    Args:
        fields: name and what is there: a numpy type, with a count to repeat it, or the text of a string.
    """

    def __init__(self, *fields: tuple[str, str | tuple[str, int] | bytes]) -> None:
        names: list[str] = []
        formats: list[Any] = []
        offsets: list[int] = []
        self.texts: dict[str, bytes] = {}
        at = 0
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
            size = np.dtype(base).itemsize
            at += -at % min(size, 8) if np.dtype(base).kind != "V" else 0
            names.append(name)
            formats.append((base, (count,)) if isinstance(kind, tuple) else base)
            offsets.append(at)
            at += size * count
        shifted = [4 + o for o in offsets]
        self.dtype = np.dtype({"names": names, "formats": formats, "offsets": shifted, "itemsize": at + 4})

    def make(self, n: int, /, **columns: Any) -> Records:
        """Records (n) with the strings in place and these columns filled; the rest is zero."""
        out: Records = np.zeros(n, self.dtype)
        out.view(np.uint8).reshape(n, -1)[:, 1] = 1
        for name, text in self.texts.items():
            out[f"{name}.len"] = len(text)
            out[name] = np.frombuffer(text, f"V{len(text)}")[0]
        for name, value in columns.items():
            out[name] = value
        return out


def split(records: Records) -> list[bytes]:
    """The bytes of each record."""
    size = records.dtype.itemsize
    whole = records.tobytes()
    return [whole[i : i + size] for i in range(0, len(whole), size)]


def stamps(t_ns: Times) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Seconds and the nanoseconds over them."""
    return t_ns // 1_000_000_000, t_ns % 1_000_000_000


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
def transform_layout(parent: bytes, child: bytes) -> Layout:
    """TFMessage with one transform."""
    return Layout(("count", "<u4"), *HEADER, ("parent", parent), ("child", child), ("pose", ("<f8", 7)))


@lru_cache(16)
def odometry_layout(parent: bytes, child: bytes) -> Layout:
    """Odometry."""
    return Layout(
        *HEADER, ("parent", parent), ("child", child), ("pose", ("<f8", 7)), ("pose_covariance", ("<f8", 36)),
        ("twist", ("<f8", 6)), ("twist_covariance", ("<f8", 36)),
    )  # fmt: skip


def states(position: Floats, quat_xyzw: Floats, velocity: Floats, spin: Floats) -> Floats:
    """Columns (n, 13) of RadarFrame's poses and rates."""
    return np.concatenate([position, quat_xyzw, velocity, spin], axis=1)
