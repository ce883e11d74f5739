"""The messages of Gazebo Classic that are used here, by their field numbers, and their framing on a TCP stream."""

from __future__ import annotations

import functools
import os
from types import SimpleNamespace
from typing import Any
from urllib.parse import urlsplit

from ullage.errors import InputError
from ullage.ports.schema import messages

TABLE = {
    "Time": "sec:int32!=1 nsec:int32!=2",
    "Packet": "stamp:Time!=1 type:string!=2 serialized_data:bytes!=3",
    "Publish": "topic:string!=1 msg_type:string!=2 host:string!=3 port:uint32!=4",
    "Subscribe": "topic:string!=1 host:string!=2 port:uint32!=3 msg_type:string!=4 latching:bool=5",
    "Publishers": "publisher:Publish*=1",
    "GzString": "data:string!=1",
    "GzString_V": "data:string*=1",
    "Vector3d": "x:double!=1 y:double!=2 z:double!=3",
    "Quaternion": "x:double!=2 y:double!=3 z:double!=4 w:double!=5",
    "Pose": "name:string=1 id:uint32=2 position:Vector3d!=3 orientation:Quaternion!=4",
    "PosesStamped": "time:Time!=1 pose:Pose*=2",
    "WorldStatistics": "sim_time:Time!=2 pause_time:Time!=3 real_time:Time!=4 paused:bool!=5 iterations:uint64!=6",
    "LaserScan": "frame:string!=1 world_pose:Pose!=2 angle_min:double!=3 angle_max:double!=4 angle_step:double!=5 "
    "range_min:double!=6 range_max:double!=7 count:uint32!=8 vertical_angle_min:double=9 vertical_angle_max:double=10 "
    "vertical_angle_step:double=11 vertical_count:uint32=12 ranges:double*=13 intensities:double*=14",
    "LaserScanStamped": "time:Time!=1 scan:LaserScan!=2",
    "Image": "width:uint32!=1 height:uint32!=2 pixel_format:uint32!=3 step:uint32!=4 data:bytes!=5",
    "ImageStamped": "time:Time!=1 image:Image!=2",
    "Sonar": "frame:string!=1 world_pose:Pose!=2 range_min:double!=3 range_max:double!=4 radius:double!=5 "
    "range:double!=6 contact:Vector3d=7 geometry:string!=8",
    "SonarStamped": "time:Time!=1 sonar:Sonar!=2",
    "PointCloud": "points:Vector3d*=1",
    "Request": "id:int32!=1 request:string!=2 data:string=3",
    "Response": "id:int32!=1 request:string!=2 response:string!=3 type:string=4 serialized_data:bytes=5",
    "Sensor": "name:string!=1 parent:string!=3 type:string!=5",
    "Link": "id:uint32=1 name:string!=2 sensor:Sensor*=12",
    "Model": "name:string!=1 id:uint32=2 is_static:bool=3 pose:Pose=4 link:Link*=6",
    "Scene": "name:string!=1 model:Model*=8",
}

HEADER = 8
"""A message begins with its length in this many hexadecimal digits."""
MOST_BYTES = 256 * 2**20
"""Longest message [bytes]; a longer one ends the connection."""
USUAL_PORT = 11345


@functools.cache
def gz() -> SimpleNamespace:
    """The message classes; `gz().PosesStamped()` is an empty message.

    Raises:
        MissingExtra: protobuf is not installed.
    """
    return SimpleNamespace(**messages("gazebo.msgs", TABLE, syntax="proto2"))


def full_type(message: Any) -> str:
    """The name of a message's type, as `gazebo.msgs.Pose`."""
    return str(message.DESCRIPTOR.full_name)


def framed(data: bytes) -> bytes:
    """Return a message with its length before it."""
    return f"{len(data):08X}".encode() + data


def packet(kind: str, message: Any) -> bytes:
    """Return a packet for the master, or the first one for a publisher."""
    made = gz().Packet(stamp=gz().Time(sec=0, nsec=0), type=kind, serialized_data=message.SerializeToString())
    return framed(made.SerializeToString())


class Stream:
    """Cut a stream of bytes into messages."""

    def __init__(self) -> None:
        self._bytes = bytearray()

    def take(self, more: bytes) -> list[bytes]:
        """Add bytes and return the messages that are complete.

        Raises:
            ValueError: the bytes are not such messages.
        """
        self._bytes += more
        out, start = [], 0
        while len(self._bytes) - start >= HEADER:
            length = int(bytes(self._bytes[start : start + HEADER]), 16)
            if not 0 <= length <= MOST_BYTES:
                raise ValueError(f"a message of {length} bytes")
            if len(self._bytes) - start - HEADER < length:
                break
            out.append(bytes(self._bytes[start + HEADER : start + HEADER + length]))
            start += HEADER + length
        del self._bytes[:start]
        return out


def master_of(address: str) -> tuple[str, int]:
    """Return host and port of the master: as given, from GAZEBO_MASTER_URI, or of this machine.

    Raises:
        InputError: the address is not HOST:PORT.
    """
    text = address or os.environ.get("GAZEBO_MASTER_URI", "")
    try:
        parts = urlsplit(text if "//" in text else f"//{text}")
        return parts.hostname or "127.0.0.1", parts.port or USUAL_PORT
    except ValueError:
        raise InputError(f"{text!r} is not an address", where="gazebo-classic", allowed="HOST:PORT") from None
