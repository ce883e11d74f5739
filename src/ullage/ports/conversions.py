"""Encode frames, trajectories, detections and maps as ROS 2 messages, and decode them."""

from __future__ import annotations

import itertools
import json
import math
from collections.abc import Sequence
from dataclasses import asdict
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from ullage.arrays import Floats, Longs
from ullage.data import Calibration, Detections, Frames, Trajectory
from ullage.errors import InputError
from ullage.geometry import quat_matrix, quat_rpy
from ullage.grids import AMBIGUOUS, UNKNOWN, Grid, OccupancyMap
from ullage.ports import schema as ros
from ullage.ports.intake import warn
from ullage.ports.maps import along_axes
from ullage.specs import RadarSpec

if TYPE_CHECKING:
    from ullage.flight.live import Wish

WORLD, BODY = "map", "base_link"  # names of REP-105
OCCUPIED_FROM = 65  # percent, as map_server has it
LEVEL = 1e-3  # most of a quaternion's x and y where a map is level
PROFILE = np.dtype([(name, "<f4") for name in ("x", "y", "z", "intensity")])
HIT = np.dtype([*PROFILE.descr, ("range", "<f4"), ("snr_db", "<f4")])
CODES = {"int8": 1, "uint8": 2, "int16": 3, "uint16": 4, "int32": 5, "uint32": 6, "float32": 7, "float64": 8}
"""Numbers of a PointField by their type."""
STRAIGHT = (0.0, 0.0, 0.0, 1.0)
"""The attitude of what is not turned, xyzw."""


def state_columns(path: Trajectory) -> Floats:
    """Stack position, quaternion, velocity and angular rate as columns (n, 13)."""
    return np.concatenate([pose_columns(path), *path.rates], axis=1)


def pose_columns(path: Trajectory) -> Floats:
    """Stack position and quaternion as columns (n, 7)."""
    return np.concatenate([path.position, path.quat_xyzw], axis=1)


def path_of(t_ns: Longs, states: Floats) -> Trajectory:
    """Return the trajectory of such columns (n, 13)."""
    return Trajectory(t_ns, states[:, :3], states[:, 3:7], states[:, 7:10], states[:, 10:])


def frame_messages(frames: Frames, start: int, *, frame_id: str = "") -> list[bytes]:
    """Encode each frame as RadarFrame, counted from `start`; an empty `frame_id` means the sensor's name."""
    floats = frames.samples.view(np.float32)
    layout = ros.layout(ros.FRAME, (frame_id or frames.sensor).encode(), frames.sensor.encode(), floats.shape[1])
    axis = frames.range_m
    columns: dict[str, Any] = {
        "index": start + np.arange(len(frames)),
        "kind": 0 if np.iscomplexobj(frames.samples) else 1,
        "range_start": axis[0],
        "range_step": (axis[-1] - axis[0]) / max(len(axis) - 1, 1),
        "samples": floats,
    }
    for name, path in (("believed", frames.poses), ("truth", frames.truth)):
        if path is not None:
            columns |= {f"has_{name}": 1, name: pose_columns(path), f"{name}_rate": np.concatenate(path.rates, axis=1)}
    return layout.fill(frames.t_ns, columns)


def times_in(messages: Sequence[bytes]) -> Longs:
    """Read the stamps of messages that begin with a header [ns]."""
    stamps = np.frombuffer(b"".join(message[4:12] for message in messages), [("sec", "<i4"), ("nanosec", "<u4")])
    return np.asarray(stamps["sec"].astype(np.int64) * 1_000_000_000 + stamps["nanosec"])


def time_in(data: bytes) -> int:
    """Read the stamp of one message that begins with a header [ns].

    Raises:
        InputError: the message is too short for a header.
    """
    if len(data) < 12:
        raise InputError(f"a message of {len(data)} bytes", where="header", allowed="12 or more")
    sec, nanosec = int.from_bytes(data[4:8], "little", signed=True), int.from_bytes(data[8:12], "little")
    return sec * 1_000_000_000 + nanosec


def frames_of(messages: Sequence[bytes], sensor: str, fields: dict[str, Any], t_ns: Longs) -> list[Frames]:
    """Decode RadarFrame messages of one size at these times, with the fields from `settings_of`.

    Frames with poses and frames without them are given apart.

    Raises:
        InputError: the messages are not frames.
    """
    frame_id, name = text_in(messages[0], 0).encode(), sensor.encode()
    floats = (len(messages[0]) - ros.layout(ros.FRAME, frame_id, name, 0).dtype.itemsize) // 4
    records = np.frombuffer(b"".join(messages), ros.layout(ros.FRAME, frame_id, name, floats).dtype)
    samples: Any = np.ascontiguousarray(records["samples"])
    if (records["samples.count"] != floats).any() or (records["kind"] != records["kind"][0]).any():
        raise InputError("a frame's length or kind does not fit", where=sensor)
    if records["kind"][0] == 0:
        samples = samples.view(np.complex64)
    known = fields if "spec" in fields else fields | assumed_settings(records[0], sensor, samples)
    cuts = [0, *(np.flatnonzero(np.diff(records["has_believed"].astype(int))) + 1).tolist(), len(messages)]
    out = []
    for some in itertools.starmap(slice, itertools.pairwise(cuts)):
        poses, truth = (
            path_of(t_ns[some], np.concatenate([records[key][some], records[f"{key}_rate"][some]], axis=1))
            if records[f"has_{key}"][some].all() else None for key in ("believed", "truth")
        )  # fmt: skip
        out.append(Frames(samples[some], t_ns=t_ns[some], sensor=sensor, poses=poses, truth=truth, **known))
    return out


def assumed_settings(record: Any, sensor: str, samples: Any) -> dict[str, Any]:
    """Return fields of Frames for messages that came without settings."""
    bins = samples.shape[1]
    warn(f"{sensor}: no settings were recorded; an X4M05's are assumed")
    output = "baseband" if np.iscomplexobj(samples) else "rf"
    spec = RadarSpec.preset("x4m05", output=output, bins=max(bins, 8), range_start_m=float(record["range_start"]))
    range_m = record["range_start"] + record["range_step"] * np.arange(bins)
    return {"spec": spec, "range_m": range_m, "unit": "normalised"}


def text_in(data: bytes, index: int) -> str:
    """Read one of the strings that follow a message's stamp, by its position among them."""
    at = _after_texts(data, index)
    size = int.from_bytes(data[at : at + 4], "little")
    return data[at + 4 : at + 3 + size].decode()


def index_in(data: bytes) -> int:
    """Read the number of a RadarFrame, which follows its two strings."""
    at = _after_texts(data, 2)
    return int.from_bytes(data[at : at + 4], "little")


def _after_texts(data: bytes, count: int) -> int:
    at = 12
    for _ in range(count):
        at += 4 + int.from_bytes(data[at : at + 4], "little")
        at += -at % 4
    return at


def settings_message(frames: Frames, *, frame_id: str = "") -> bytes:
    """Encode the settings of frames as RadarSettings; an empty `frame_id` means the sensor's name."""
    calibration = "" if frames.calibration is None else json.dumps(asdict(frames.calibration))
    fields = {"sensor": frames.sensor, "unit": frames.unit, "settings": frames.spec.model_dump_json(),
              "calibration": calibration, "range": frames.range_m}  # fmt: skip
    return ros.encoded(ros.SETTINGS, fields, t_ns=int(frames.t_ns[0]), frame_id=frame_id or frames.sensor)


def settings_of(data: bytes) -> dict[str, Any]:
    """Decode a RadarSettings message to fields of Frames."""
    message = ros.from_bytes(ros.SETTINGS, data)
    calibration = Calibration(**json.loads(message.calibration)) if message.calibration else None
    spec = spec_of(json.loads(message.settings), message.sensor)
    return {"unit": message.unit, "range_m": np.array(message.range), "spec": spec, "calibration": calibration}


def spec_of(values: dict[str, Any], where: str) -> RadarSpec:
    """Read a radar's settings; a field that this version lacks gives a warning and is left out."""
    unknown = sorted(values.keys() - RadarSpec.model_fields.keys())
    if unknown:
        warn(f"{where}: settings this version does not know are left out: {', '.join(unknown)}")
    return RadarSpec(**{key: value for key, value in values.items() if key not in unknown})


def track_message(track: Trajectory, sensor: str, t_ns: int) -> bytes:
    """Encode the track of one sensor."""
    fields = {"sensor": sensor, "time": track.t_ns, "state": state_columns(track).ravel()}
    return ros.encoded(ros.TRACK, fields, t_ns=t_ns, frame_id=WORLD)


def track_of(data: bytes) -> Trajectory:
    """Decode a Track message to a trajectory."""
    message = ros.from_bytes(ros.TRACK, data)
    return path_of(np.array(message.time), np.array(message.state).reshape(-1, 13))


def transform_messages(child: str, path: Trajectory, *, parent: str = WORLD) -> list[bytes]:
    """Encode one TFMessage per time with the pose of a child in its parent."""
    layout = ros.layout(ros.TRANSFORMS, 1, parent.encode(), child.encode())
    return layout.fill(path.t_ns, {"transforms.0.transform": pose_columns(path)})


def odometry_messages(path: Trajectory, *, parent: str = WORLD, child: str = BODY) -> list[bytes]:
    """Encode Odometry at each time; rates are in the body's frame, as ROS defines."""
    velocity, spin = path.rates
    in_body = np.einsum("nij,ni->nj", quat_matrix(path.quat_xyzw), velocity)
    columns = {"pose.pose": pose_columns(path), "twist.twist": np.concatenate([in_body, spin], axis=1)}
    return ros.layout(ros.ODOMETRY, parent.encode(), child.encode()).fill(path.t_ns, columns)


def odometry_path(messages: Sequence[bytes]) -> Trajectory:
    """Decode Odometry messages to a trajectory; each time appears once.

    Raises:
        InputError: the messages are of another frame of reference or length.
    """
    layout = ros.layout(ros.ODOMETRY, text_in(messages[0], 0).encode(), text_in(messages[0], 1).encode())
    if any(len(message) != layout.dtype.itemsize for message in messages):
        raise InputError("odometry changes its frames of reference", where="odom")
    records = np.frombuffer(b"".join(messages), layout.dtype)
    t_ns, row = np.unique(times_in(messages), return_index=True)
    pose, twist = records["pose.pose"][row], records["twist.twist"][row]
    velocity = np.einsum("nij,nj->ni", quat_matrix(pose[:, 3:]), twist[:, :3])
    return Trajectory(t_ns, pose[:, :3], pose[:, 3:], velocity, twist[:, 3:])


class Placement(NamedTuple):
    """The pose of one frame of reference in another, as a message has it: not checked yet."""

    t_ns: int
    parent: str
    child: str  # empty where the message does not say
    position: tuple[float, float, float]
    quat_xyzw: tuple[float, float, float, float]


PLACING = (ros.TRANSFORMS, ros.ODOMETRY, ros.POSE, ros.COVARIANT_POSE)
"""Messages that hold poses."""


def placements_in(kind: str, data: bytes) -> list[Placement]:
    """Decode the poses in a message of one of `PLACING`."""
    message = ros.from_bytes(kind, data)
    if kind == ros.TRANSFORMS:
        return [_placement(one, one.transform.translation, one.transform.rotation) for one in message.transforms]
    pose = message.pose if kind == ros.POSE else message.pose.pose
    return [_placement(message, pose.position, pose.orientation)]


def _placement(message: Any, at: Any, turn: Any) -> Placement:
    head, child = message.header, getattr(message, "child_frame_id", "")
    t_ns = stamp_ns(head)
    return Placement(t_ns, head.frame_id, child, (at.x, at.y, at.z), (turn.x, turn.y, turn.z, turn.w))


def stamp_ns(header: Any) -> int:
    """Return the time of a header [ns]."""
    return int(header.stamp.sec) * 1_000_000_000 + int(header.stamp.nanosec)


def command_of(kind: str, data: bytes) -> tuple[int, Wish]:
    """Return the time [ns] and the command in a message of `ros.PILOT_VELOCITY` or `ros.PILOT_PLACE`."""
    from ullage.flight.live import Wish

    message = ros.from_bytes(kind, data)
    if kind == ros.TWIST_STAMPED:
        linear, turn = message.twist.linear, message.twist.angular.z
        return stamp_ns(message.header), Wish(velocity_m_s=(linear.x, linear.y), climb_m_s=linear.z, turn_rad_s=turn)
    at, turned = message.pose.position, message.pose.orientation
    heading = float(quat_rpy((turned.x, turned.y, turned.z, turned.w))[2])
    return stamp_ns(message.header), Wish(position_m=(at.x, at.y, at.z), heading_rad=heading)


def cloud_messages(t_ns: Longs, points: NDArray[np.void], *, frame_id: str, dense: bool = True) -> list[bytes]:
    """Encode points (n, k), records of numbers, at their times (n) as PointCloud2."""
    fields, (n, k), size = dict(points.dtype.fields or {}), points.shape, points.dtype.itemsize
    names = [name.encode() for name in fields]
    columns: dict[str, Any] = {"height": 1, "width": k, "point_step": size, "row_step": size * k, "is_dense": dense}
    for i, field in enumerate(fields.values()):
        columns |= {
            f"fields.{i}.offset": field[1],
            f"fields.{i}.datatype": CODES[field[0].name],
            f"fields.{i}.count": 1,
        }
    columns["data"] = points.reshape(n, k).view(np.uint8).reshape(n, size * k)
    return ros.layout(ros.CLOUD, frame_id.encode(), len(names), *names, size * k).fill(t_ns, columns)


def profile_messages(frames: Frames, *, frame_id: str = "") -> list[bytes]:
    """Encode each frame's profile along the boresight as PointCloud2; an empty `frame_id` means the sensor's name."""
    points = np.zeros(frames.samples.shape, PROFILE)
    points["x"], points["intensity"] = frames.range_m, frames.amplitude
    return cloud_messages(frames.t_ns, points, frame_id=frame_id or frames.sensor)


def detection_messages(found: Detections) -> list[tuple[int, bytes]]:
    """Encode the detections at each time as PointCloud2 in the world; points of unknown bearing are NaN."""
    out = []
    order = np.argsort(found.t_ns, kind="stable")
    times, first = np.unique(found.t_ns[order], return_index=True)
    for t_ns, rows in zip(times, np.split(order, first[1:]), strict=True):
        points = np.zeros((1, len(rows)), HIT)
        for k, axis in enumerate("xyz"):
            points[axis] = found.point[rows, k]
        points["intensity"], points["range"] = found.amplitude[rows], found.range_m[rows]
        points["snr_db"] = found.snr_db[rows]
        dense = bool(np.isfinite(found.point[rows]).all())
        out.append((int(t_ns), cloud_messages(np.array([t_ns]), points, frame_id=WORLD, dense=dense)[0]))
    return out


def grid_message(omap: OccupancyMap, t_ns: int) -> bytes:
    """Encode a plane map as OccupancyGrid; ambiguous cells are unknown."""
    ny, nx = omap.grid.shape
    info = {
        "map_load_time": ros.header(t_ns, "").stamp, "resolution": float(omap.grid.step_m), "width": nx,
        "height": ny, "origin": ((*omap.grid.origin_m[:2], level_m(omap)), STRAIGHT),
    }  # fmt: skip
    return ros.encoded(ros.GRID, {"info": info, "data": known_percent(omap).ravel()}, t_ns=t_ns, frame_id=WORLD)


def known_percent(omap: OccupancyMap) -> NDArray[np.int8]:
    """Return a map's cells in ROS's percent; ambiguous cells are unknown."""
    return np.where(omap.percent == AMBIGUOUS, UNKNOWN, omap.percent).astype(np.int8)


def level_m(omap: OccupancyMap) -> float:
    """Return the height of a plane map [m]; 0 where it has none."""
    z = float(omap.grid.origin_m[2])
    return z if math.isfinite(z) else 0.0


def grid_of(data: bytes) -> OccupancyMap:
    """Decode an OccupancyGrid message to a map.

    Raises:
        InputError: the grid is tilted, or its size does not fit.
    """
    message = ros.from_bytes(ros.GRID, data)
    at, turn, info = message.info.origin.position, message.info.origin.orientation, message.info
    if abs(turn.x) + abs(turn.y) > LEVEL:
        raise InputError("the map is tilted", where="OccupancyGrid", allowed="a level origin")
    percent = np.array(message.data, np.int8)
    if percent.size and (percent.min() < UNKNOWN or percent.max() > 100):
        raise InputError("a cell is out of range", where="OccupancyGrid", allowed="-1 (unknown), 0 to 100 percent")
    if len(percent) != info.width * info.height:
        raise InputError("the map's size does not fit", where="OccupancyGrid")
    step = float(str(np.float32(info.resolution)))  # the shortest number that this float32 can mean
    cells, yaw = percent.reshape(info.height, info.width), 2 * math.atan2(turn.z, turn.w)
    return OccupancyMap(*along_axes(cells, (at.x, at.y, at.z), step, yaw=yaw, occupied_from=OCCUPIED_FROM))


def cells_message(omap: OccupancyMap, t_ns: int) -> bytes:
    """Encode a map as CellMap."""
    grid = omap.grid
    fields = {
        "method": omap.method, "origin": grid.origin_m, "step": float(grid.step_m), "shape": grid.shape,
        "occupied_from": omap.occupied_from, "free_to": omap.free_to, "percent": omap.percent.ravel(),
    }  # fmt: skip
    return ros.encoded(ros.CELLS, fields, t_ns=t_ns, frame_id=WORLD)


def cells_of(data: bytes) -> OccupancyMap:
    """Decode a CellMap message to a map."""
    message = ros.from_bytes(ros.CELLS, data)
    x, y, z = (float(k) for k in message.origin)
    grid = Grid((x, y, z), message.step, tuple(int(k) for k in message.shape))
    percent = np.array(message.percent, np.int8).reshape(grid.shape)
    return OccupancyMap(grid, percent, message.method, message.occupied_from, message.free_to)
