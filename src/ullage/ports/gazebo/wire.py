"""The messages of Gazebo Transport that are used here, by their field numbers, and peer discovery.

The same numbers hold for `ignition.msgs` (Fortress and before) and `gz.msgs` (Garden and later).
"""

from __future__ import annotations

import functools
import getpass
import os
import socket
import struct
import uuid
from types import SimpleNamespace
from typing import Any

from ullage.errors import InputError
from ullage.ports.schema import messages

TABLE = {
    "Time": "sec:int64=1 nsec:int32=2",
    "Map": "key:string=1 value:string*=2",
    "Header": "stamp:Time=1 data:Map*=2",
    "Vector2d": "header:Header=1 x:double=2 y:double=3",
    "Vector3d": "header:Header=1 x:double=2 y:double=3 z:double=4",
    "Quaternion": "header:Header=1 x:double=2 y:double=3 z:double=4 w:double=5",
    "Pose": "header:Header=1 name:string=2 id:uint32=3 position:Vector3d=4 orientation:Quaternion=5",
    "Twist": "header:Header=1 linear:Vector3d=2 angular:Vector3d=3",
    "Odometry": "header:Header=1 pose:Pose=2 twist:Twist=3",
    "Pose_V": "header:Header=1 pose:Pose*=2",
    "Clock": "header:Header=1 system:Time=2 real:Time=3 sim:Time=4",
    "WorldStatistics": "header:Header=1 sim_time:Time=2 pause_time:Time=3 real_time:Time=4 paused:bool=5 "
    "iterations:uint64=6 model_count:int32=7 real_time_factor:double=9 step_size:Time=10",
    "Empty": "unused:bool=1",
    "Double": "header:Header=1 data:double=2",
    "Float_V": "header:Header=1 data:float*=2",
    "LaserScan": "header:Header=1 frame:string=2 world_pose:Pose=3 angle_min:double=4 angle_max:double=5 "
    "angle_step:double=6 range_min:double=7 range_max:double=8 count:uint32=9 vertical_angle_min:double=10 "
    "vertical_angle_max:double=11 vertical_angle_step:double=12 vertical_count:uint32=13 ranges:double*=14 "
    "intensities:double*=15",
    "Field": "name:string=1 offset:uint32=2 datatype:int32=3 count:uint32=4",
    "PointCloudPacked": "header:Header=1 field:Field*=2 height:uint32=3 width:uint32=4 is_bigendian:bool=5 "
    "point_step:uint32=6 row_step:uint32=7 data:bytes=8 is_dense:bool=9",
    "BoxGeom": "header:Header=1 size:Vector3d=2",
    "RoundGeom": "header:Header=1 radius:double=2 length:double=3",
    "PlaneGeom": "header:Header=1 normal:Vector3d=2 size:Vector2d=3 d:double=4",
    "MeshGeom": "header:Header=1 filename:string=2 scale:Vector3d=3 submesh:string=4 center_submesh:bool=5",
    "EllipsoidGeom": "header:Header=1 radii:Vector3d=2",
    "Geometry": "header:Header=1 type:int32=2 box:BoxGeom=3 cylinder:RoundGeom=4 plane:PlaneGeom=5 sphere:RoundGeom=6 "
    "mesh:MeshGeom=9 cone:RoundGeom=10 capsule:RoundGeom=13 ellipsoid:EllipsoidGeom=14",
    "Visual": "header:Header=1 name:string=2 id:uint32=3 laser_retro:double=8 pose:Pose=9 geometry:Geometry=10",
    "Collision": "header:Header=1 id:uint32=2 name:string=3 laser_retro:double=4 pose:Pose=6 geometry:Geometry=7",
    "Link": "header:Header=1 id:uint32=2 name:string=3 pose:Pose=10 visual:Visual*=11 collision:Collision*=12",
    "Model": "header:Header=1 name:string=2 id:uint32=3 is_static:bool=4 pose:Pose=5 link:Link*=7 model:Model*=12",
    "Scene": "header:Header=1 name:string=2 model:Model*=9",
    "Flags": "relay:bool=1 no_relay:bool=2",
    "Subscriber": "topic:string=1",
    "MessagePublisher": "ctrl:string=1 msg_type:string=2 throttled:bool=3 msgs_per_sec:uint64=4",
    "ServicePublisher": "socket_id:string=1 request_type:string=2 response_type:string=3",
    "Publisher": "topic:string=1 address:string=2 process_uuid:string=3 node_uuid:string=4 scope:int32=5 "
    "msg_pub:MessagePublisher=6 srv_pub:ServicePublisher=7",
    "Discovery": "header:Header=1 version:uint32=2 process_uuid:string=3 type:int32=4 flags:Flags=5 sub:Subscriber=6 "
    "pub:Publisher=7",
}

ADVERTISE, SUBSCRIBE, UNADVERTISE, HEARTBEAT, BYE, NEW_CONNECTION, END_CONNECTION = range(1, 8)
"""Kinds of a discovery datagram."""
EVERYWHERE = 2
"""Scope of a topic that other hosts receive; 0 stays in the process, 1 on the host."""
WIRE_VERSION = 10
GROUP, MESSAGE_PORT, SERVICE_PORT = "239.255.0.7", 10317, 10318
IP_MULTICAST_ALL = 49
"""Linux: with 0, a socket receives only from the groups that it joined itself."""


@functools.cache
def gz() -> SimpleNamespace:
    """The message classes; `gz().Pose_V()` is an empty message.

    Raises:
        MissingExtra: protobuf is not installed.
    """
    return SimpleNamespace(**messages("gz.msgs", TABLE))


def setting(name: str) -> str:
    """Return the value of `GZ_name`, or of `IGN_name` (up to Fortress); empty if neither is set."""
    return os.environ.get(f"GZ_{name}") or os.environ.get(f"IGN_{name}") or ""


def usual_partition() -> str:
    """Return the partition: GZ_PARTITION, or the default of this host and user."""
    return setting("PARTITION") or f"{socket.gethostname()}:{getpass.getuser()}"


def full_topic(topic: str, partition: str) -> str:
    """Return the name of a topic on the wire.

    Raises:
        InputError: the name is not a topic.
    """
    if not topic.startswith("/") or len(topic) < 2 or any(c in topic for c in " @~\t\n") or "//" in topic:
        raise InputError(f"{topic!r} is not a topic", where="topic", allowed="/one/like/this")
    return f"@{partition if partition.startswith('/') or not partition else '/' + partition}@{topic}"


def short_topic(full: str) -> str:
    """Return the topic without its partition."""
    return full.rpartition("@")[2]


def datagram(kind: int, process: str, **parts: Any) -> bytes:
    """Return the bytes of one discovery message."""
    body: bytes = gz().Discovery(version=WIRE_VERSION, process_uuid=process, type=kind, **parts).SerializeToString()
    return struct.pack("<H", len(body)) + body


def read_datagram(raw: bytes) -> Any | None:
    """Return the discovery message in a datagram; None if there is none, or its wire version differs."""
    if len(raw) < 2 or struct.unpack_from("<H", raw)[0] != len(raw) - 2:
        return None
    message = gz().Discovery()
    try:
        message.ParseFromString(raw[2:])
    except Exception:  # protobuf raises kinds of its own, by implementation
        return None
    return message if message.version % 100 == WIRE_VERSION else None


def new_uuid() -> str:
    """Return a new unique id."""
    return str(uuid.uuid4())


def discovery_socket(port: int, host: str) -> socket.socket:
    """Open a UDP socket in the discovery group, only on the interface with this address.

    Raises:
        InputError: no interface has this address, or the port cannot be opened.
    """
    out = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    try:
        out.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        if hasattr(socket, "SO_REUSEPORT"):
            out.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEPORT, 1)
        out.setsockopt(socket.IPPROTO_IP, socket.IP_MULTICAST_IF, socket.inet_aton(host))
        out.setsockopt(socket.IPPROTO_IP, socket.IP_MULTICAST_LOOP, 1)
        _bind_to_group(out, port)
        member = socket.inet_aton(GROUP) + socket.inet_aton(host)
        out.setsockopt(socket.IPPROTO_IP, socket.IP_ADD_MEMBERSHIP, member)
    except OSError as error:
        out.close()
        raise InputError(
            f"cannot listen there: {error.strerror or error}",
            where=f"host {host}",
            allowed="an address of this machine",
        ) from None
    out.setblocking(False)
    return out


def _bind_to_group(sock: socket.socket, port: int) -> None:
    try:
        sock.bind((GROUP, port))  # so that nothing but the group's datagrams comes in
        sock.setsockopt(socket.IPPROTO_IP, IP_MULTICAST_ALL, 0)
    except OSError:  # not on every system
        sock.bind(("", port))
