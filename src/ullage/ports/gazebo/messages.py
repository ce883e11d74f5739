"""The messages of both Gazebos that are used here, by the numbers of their fields, which is all that the wire knows."""

from __future__ import annotations

import functools
from collections.abc import Mapping
from types import SimpleNamespace
from typing import Any

from ullage.errors import need

TRANSPORT = {
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
"""Messages of `gz.msgs` (Garden and later); the same numbers hold for `ignition.msgs` (Fortress and before)."""

CLASSIC = {
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
"""Messages of `gazebo.msgs` (Gazebo Classic)."""

KINDS = {
    "double": 1, "float": 2, "int64": 3, "uint64": 4, "int32": 5, "bool": 8, "string": 9, "bytes": 12, "uint32": 13,
}  # fmt: skip
"""Scalar types and their numbers in a descriptor."""
MESSAGE, OPTIONAL, REQUIRED, REPEATED = 11, 1, 2, 3


@functools.cache
def gz() -> SimpleNamespace:
    """Return the message classes of Gazebo Transport; `gz().Pose_V()` is an empty message.

    Raises:
        MissingExtra: protobuf is not installed.
    """
    return _messages("gz.msgs", TRANSPORT, "proto3")


@functools.cache
def classic() -> SimpleNamespace:
    """Return the message classes of Gazebo Classic; `classic().PosesStamped()` is an empty message.

    Raises:
        MissingExtra: protobuf is not installed.
    """
    return _messages("gazebo.msgs", CLASSIC, "proto2")


def _messages(package: str, table: Mapping[str, str], syntax: str) -> SimpleNamespace:
    """Return message classes by their names.

    Args:
        package: the package that their full names begin with.
        table: of each message the fields as `name:type=number`, with `*` after the type where it repeats and `!` where
            proto2 requires it; a type is a scalar or another message of the table. Enumerations are int32.
        syntax: proto2 or proto3.

    Raises:
        MissingExtra: protobuf is not installed.
    """
    descriptors: Any = need("google.protobuf.descriptor_pb2", extra="gazebo")
    pool: Any = need("google.protobuf.descriptor_pool", extra="gazebo").DescriptorPool()
    factory: Any = need("google.protobuf.message_factory", extra="gazebo")
    file = descriptors.FileDescriptorProto(name=f"ullage/{package}.proto", package=package, syntax=syntax)
    for name, fields in table.items():
        made = file.message_type.add(name=name)
        for word in fields.split():
            _add_field(made, word, package)
    pool.Add(file)
    found = {name: factory.GetMessageClass(pool.FindMessageTypeByName(f"{package}.{name}")) for name in table}
    return SimpleNamespace(**found)


def _add_field(message: Any, word: str, package: str) -> None:
    left, _, number = word.partition("=")
    name, _, kind = left.partition(":")
    label = REPEATED if kind.endswith("*") else REQUIRED if kind.endswith("!") else OPTIONAL
    kind = kind.rstrip("*!")
    field = message.field.add(name=name, number=int(number), label=label)
    if kind in KINDS:
        field.type = KINDS[kind]
    else:
        field.type, field.type_name = MESSAGE, f".{package}.{kind}"
