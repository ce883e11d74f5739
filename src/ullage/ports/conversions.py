"""Encode frames, trajectories, detections and maps as ROS 2 messages, and decode them."""

from __future__ import annotations

import json
import math
import struct
import warnings
from collections.abc import Sequence
from dataclasses import asdict
from typing import Any

import numpy as np

from ullage.arrays import Floats, Longs
from ullage.data import Calibration, Detections, Frames, Trajectory
from ullage.errors import InputError, UllageWarning
from ullage.fan import drawn_rays
from ullage.geometry import quat_matrix
from ullage.grids import AMBIGUOUS, UNKNOWN, Grid, OccupancyMap
from ullage.ports import messages as ros
from ullage.ports.turned import along_axes
from ullage.specs import RadarSpec
from ullage.world.scene import Scene

WORLD, BODY = "map", "base_link"  # names of REP-105
STAMP = struct.Struct("<iI")
MOST_TRIANGLES = 50_000
OCCUPIED_FROM = 65  # percent, as map_server has it
LEVEL = 1e-3  # most of a quaternion's x and y where a map is level
PROFILE = (("x", "float32"), ("y", "float32"), ("z", "float32"), ("intensity", "float32"))
HIT = (*PROFILE, ("range", "float32"), ("snr_db", "float32"))
PAINT = {
    "steel": (0.55, 0.60, 0.68),
    "pec": (0.55, 0.60, 0.68),
    "concrete": (0.70, 0.68, 0.64),
    "wood": (0.72, 0.54, 0.34),
}


def state_columns(path: Trajectory) -> Floats:
    """Stack position, quaternion, velocity and angular rate as columns (n, 13)."""
    return np.concatenate([path.position, path.quat_xyzw, *path.rates], axis=1)


def path_of(t_ns: Longs, states: Floats) -> Trajectory:
    """Return the trajectory of such columns (n, 13)."""
    return Trajectory(t_ns, states[:, :3], states[:, 3:7], states[:, 7:10], states[:, 10:])


def frame_messages(frames: Frames, start: int, *, frame_id: str = "") -> list[bytes]:
    """Encode each frame as RadarFrame, counted from `start`; an empty `frame_id` means the sensor's name."""
    floats = frames.samples.view(np.float32)
    layout = ros.frame_layout((frame_id or frames.sensor).encode(), frames.sensor.encode(), floats.shape[1])
    axis = frames.range_m
    columns: dict[str, Any] = ros.stamps(frames.t_ns) | {
        "index": start + np.arange(len(frames)),
        "kind": 0 if np.iscomplexobj(frames.samples) else 1,
        "range_start": axis[0],
        "range_step": (axis[-1] - axis[0]) / max(len(axis) - 1, 1),
        "count": floats.shape[1],
        "samples": floats,
    }
    for name, path in (("believed", frames.poses), ("truth", frames.truth)):
        if path is not None:
            columns |= {f"has_{name}": 1, name: state_columns(path)}
    return layout.fill(len(frames), **columns)


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
    sec, nanosec = STAMP.unpack_from(data, 4)
    return int(sec) * 1_000_000_000 + int(nanosec)


def frames_of(messages: Sequence[bytes], sensor: str, fields: dict[str, Any], t_ns: Longs) -> Frames:
    """Decode RadarFrame messages of one size at these times, with the fields from `settings_of`.

    Raises:
        InputError: the messages are not frames.
    """
    frame_id, name = text_in(messages[0], 0).encode(), sensor.encode()
    floats = (len(messages[0]) - ros.frame_layout(frame_id, name, 0).dtype.itemsize) // 4
    records = np.frombuffer(b"".join(messages), ros.frame_layout(frame_id, name, floats).dtype)
    samples: Any = np.ascontiguousarray(records["samples"])
    if (records["count"] != floats).any() or (records["kind"] != records["kind"][0]).any():
        raise InputError("a frame's length or kind does not fit", where=sensor)
    if records["kind"][0] == 0:
        samples = samples.view(np.complex64)
    known = fields if "spec" in fields else fields | assumed_settings(records[0], sensor, samples)
    poses, truth = (
        path_of(t_ns, records[key]) if records[f"has_{key}"].all() else None for key in ("believed", "truth")
    )
    return Frames(samples, t_ns=t_ns, sensor=sensor, poses=poses, truth=truth, **known)


def assumed_settings(record: Any, sensor: str, samples: Any) -> dict[str, Any]:
    """Return fields of Frames for messages that came without settings."""
    bins = samples.shape[1]
    warnings.warn(f"{sensor}: no settings were recorded; an X4M05's are assumed", UllageWarning, stacklevel=3)
    output = "baseband" if np.iscomplexobj(samples) else "rf"
    spec = RadarSpec.preset("x4m05", output=output, bins=max(bins, 8), range_start_m=float(record["range_start"]))
    range_m = record["range_start"] + record["range_step"] * np.arange(bins)
    return {"spec": spec, "range_m": range_m, "unit": "normalised"}


def text_in(data: bytes, index: int) -> str:
    """Read one of the strings that follow a message's stamp, by its position among them."""
    at = 12
    for _ in range(index):
        at += 4 + int.from_bytes(data[at : at + 4], "little")
        at += -at % 4
    size = int.from_bytes(data[at : at + 4], "little")
    return data[at + 4 : at + 3 + size].decode()


def index_in(data: bytes) -> int:
    """Read the number of a RadarFrame, which follows its two strings."""
    at = 12
    for _ in range(2):
        at += 4 + int.from_bytes(data[at : at + 4], "little")
        at += -at % 4
    return int.from_bytes(data[at : at + 4], "little")


def settings_message(frames: Frames, *, frame_id: str = "") -> bytes:
    """Encode the settings of frames as RadarSettings; an empty `frame_id` means the sensor's name."""
    calibration = "" if frames.calibration is None else json.dumps(asdict(frames.calibration))
    head = ros.header(int(frames.t_ns[0]), frame_id or frames.sensor)
    values = (head, frames.sensor, frames.unit, frames.spec.model_dump_json(), calibration, frames.range_m)
    return ros.to_bytes(ros.SETTINGS, ros.make(ros.SETTINGS, *values))


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
        what = f"{where}: settings this version does not know are left out: {', '.join(unknown)}"
        warnings.warn(what, UllageWarning, stacklevel=3)
    return RadarSpec(**{key: value for key, value in values.items() if key not in unknown})


def track_message(track: Trajectory, sensor: str, t_ns: int) -> bytes:
    """Encode the track of one sensor."""
    values = (ros.header(t_ns, WORLD), sensor, track.t_ns, state_columns(track).ravel())
    return ros.to_bytes(ros.TRACK, ros.make(ros.TRACK, *values))


def track_of(data: bytes) -> Trajectory:
    """Decode a Track message to a trajectory."""
    message = ros.from_bytes(ros.TRACK, data)
    return path_of(np.array(message.time), np.array(message.state).reshape(-1, 13))


def transform_messages(paths: dict[str, Trajectory], *, parent: str = WORLD) -> list[bytes]:
    """Encode one TFMessage per time with all children of the parent, which share their times."""
    first = next(iter(paths.values()))
    layout = ros.transform_layout(parent.encode(), tuple(name.encode() for name in paths))
    columns: dict[str, Any] = {"count": len(paths)}
    stamp = ros.stamps(first.t_ns)
    for i, path in enumerate(paths.values()):
        columns |= {f"sec{i}": stamp["sec"], f"nanosec{i}": stamp["nanosec"]}
        columns[f"pose{i}"] = np.concatenate([path.position, path.quat_xyzw], axis=1)
    return layout.fill(len(first), **columns)


def odometry_messages(path: Trajectory, *, parent: str = WORLD, child: str = BODY) -> list[bytes]:
    """Encode Odometry at each time; rates are in the body's frame, as ROS defines."""
    velocity, spin = path.rates
    in_body = np.einsum("nij,ni->nj", quat_matrix(path.quat_xyzw), velocity)
    return ros.odometry_layout(parent.encode(), child.encode()).fill(
        len(path),
        **ros.stamps(path.t_ns),
        pose=np.concatenate([path.position, path.quat_xyzw], axis=1),
        twist=np.concatenate([in_body, spin], axis=1),
    )


def odometry_path(messages: Sequence[bytes]) -> Trajectory:
    """Decode Odometry messages to a trajectory; each time appears once.

    Raises:
        InputError: the messages are of another frame of reference or length.
    """
    layout = ros.odometry_layout(text_in(messages[0], 0).encode(), text_in(messages[0], 1).encode())
    if any(len(message) != layout.dtype.itemsize for message in messages):
        raise InputError("odometry changes its frames of reference", where="odom")
    records = np.frombuffer(b"".join(messages), layout.dtype)
    t_ns, row = np.unique(times_in(messages), return_index=True)
    pose, twist = records["pose"][row], records["twist"][row]
    velocity = np.einsum("nij,nj->ni", quat_matrix(pose[:, 3:]), twist[:, :3])
    return Trajectory(t_ns, pose[:, :3], pose[:, 3:], velocity, twist[:, 3:])


def profile_messages(frames: Frames, *, frame_id: str = "") -> list[bytes]:
    """Encode each frame's profile along the boresight as PointCloud2; an empty `frame_id` means the sensor's name."""
    bins = len(frames.range_m)
    points = np.zeros((len(frames), bins), np.dtype(list(PROFILE)))
    points["x"], points["intensity"] = frames.range_m, frames.amplitude
    columns = ros.cloud_columns(PROFILE, bins) | ros.stamps(frames.t_ns)
    layout = ros.cloud_layout((frame_id or frames.sensor).encode(), PROFILE, bins)
    return layout.fill(len(frames), data=points, dense=1, **columns)


def detection_messages(found: Detections) -> list[tuple[int, bytes]]:
    """Encode the detections at each time as PointCloud2 in the world; points of unknown bearing are NaN."""
    out = []
    order = np.argsort(found.t_ns, kind="stable")
    times, first = np.unique(found.t_ns[order], return_index=True)
    for t_ns, rows in zip(times, np.split(order, first[1:]), strict=True):
        points = np.zeros((1, len(rows)), np.dtype(list(HIT)))
        for k, axis in enumerate("xyz"):
            points[axis] = found.point[rows, k]
        points["intensity"], points["range"] = found.amplitude[rows], found.range_m[rows]
        points["snr_db"] = found.snr_db[rows]
        columns = ros.cloud_columns(HIT, len(rows)) | ros.stamps(np.array([t_ns]))
        layout = ros.cloud_layout(WORLD.encode(), HIT, len(rows))
        out.append(
            (int(t_ns), layout.fill(1, data=points, dense=int(np.isfinite(found.point[rows]).all()), **columns)[0])
        )
    return out


def grid_message(omap: OccupancyMap, t_ns: int) -> bytes:
    """Encode a plane map as OccupancyGrid; ambiguous cells are unknown."""
    x, y, z = omap.grid.origin_m
    pose = _pose((x, y, z if np.isfinite(z) else 0.0))
    ny, nx = omap.grid.shape
    head = ros.header(t_ns, WORLD)
    info = ros.make("nav_msgs/msg/MapMetaData", head.stamp, float(omap.grid.step_m), nx, ny, pose)
    known = np.where(omap.percent == AMBIGUOUS, UNKNOWN, omap.percent).astype(np.int8).ravel()
    return ros.to_bytes(ros.GRID, ros.make(ros.GRID, head, info, known))


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
    values = (np.array(grid.origin_m), float(grid.step_m), np.array(grid.shape, np.uint32))
    levels = (omap.occupied_from, omap.free_to, np.ascontiguousarray(omap.percent).ravel())
    return ros.to_bytes(ros.CELLS, ros.make(ros.CELLS, ros.header(t_ns, WORLD), omap.method, *values, *levels))


def cells_of(data: bytes) -> OccupancyMap:
    """Decode a CellMap message to a map."""
    message = ros.from_bytes(ros.CELLS, data)
    x, y, z = (float(k) for k in message.origin)
    grid = Grid((x, y, z), message.step, tuple(int(k) for k in message.shape))
    percent = np.array(message.percent, np.int8).reshape(grid.shape)
    return OccupancyMap(grid, percent, message.method, message.occupied_from, message.free_to)


def occupied_message(omap: OccupancyMap, t_ns: int) -> bytes:
    """Encode the occupied cells of a volume as PointCloud2."""
    cells = np.argwhere(omap.occupied)
    points = np.zeros((1, len(cells)), np.dtype(list(PROFILE)))
    for axis, centres, row in zip("zyx", (omap.grid.z_m, omap.grid.y_m, omap.grid.x_m), cells.T, strict=True):
        points[axis] = centres[row]
    points["intensity"] = omap.percent[omap.occupied]
    columns = ros.cloud_columns(PROFILE, len(cells)) | ros.stamps(np.array([t_ns]))
    layout = ros.cloud_layout.__wrapped__(WORLD.encode(), PROFILE, len(cells))
    return layout.fill(1, data=points, dense=1, **columns)[0]


def scene_message(scene: Scene, t_ns: int) -> bytes:
    """Encode each object's triangles and wires as MarkerArray; only the largest triangles if there are too many."""
    corners = scene.corners()
    owner = scene.face_object
    if len(corners) > MOST_TRIANGLES:
        area = np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1)
        keep = np.sort(np.argsort(area)[-MOST_TRIANGLES:])
        corners, owner = corners[keep], owner[keep]
    lines = np.stack([scene.wires.start, scene.wires.end], axis=1)
    found = []
    for index, thing in enumerate(scene.objects):
        triangles, wires = corners[owner == index], lines[scene.wires.object_id == index]
        red, green, blue = PAINT.get(thing.material.name, (0.6, 0.6, 0.6))
        colour = ros.make("std_msgs/msg/ColorRGBA", red, green, blue, 0.6)
        if len(triangles):
            found.append(
                marker(t_ns, thing.name, 11, index, points_of(triangles.reshape(-1, 3)), (1.0, 1.0, 1.0), colour)
            )
        if len(wires):
            width = 2 * float(scene.wires.radius_m[scene.wires.object_id == index].max())
            places = points_of(wires.reshape(-1, 3))
            found.append(marker(t_ns, f"{thing.name} wires", 5, index, places, (width, 1.0, 1.0), colour))
    return ros.to_bytes(ros.MARKERS, ros.make(ros.MARKERS, found))


def rays_message(frames: Frames, *, frame_id: str = "") -> bytes:
    """Encode the ray model's fan as a MarkerArray of lines in the sensor's frame, which moves them."""
    t_ns, ends = int(frames.t_ns[0]), drawn_rays(frames.spec)
    lines = np.stack([np.zeros_like(ends), ends], axis=1).reshape(-1, 3)
    colour = ros.make("std_msgs/msg/ColorRGBA", 0.3, 0.5, 1.0, 0.25)
    made = marker(t_ns, f"rays {frames.sensor}", 5, 0, points_of(lines), (0.004, 1.0, 1.0), colour)
    made.header.frame_id = frame_id or frames.sensor
    made.frame_locked = True
    return ros.to_bytes(ros.MARKERS, ros.make(ros.MARKERS, [made]))


def marker(
    t_ns: int, name: str, kind: int, index: int, places: list[Any], size: tuple[float, float, float], colour: Any,
    colours: Sequence[Any] = (),
) -> Any:  # fmt: skip
    """Encode a Marker in the world: kind 11 triangles, 5 lines, 6 cubes; one colour for each point, or none."""
    lifetime = ros.make("builtin_interfaces/msg/Duration", 0, 0)
    picture = ros.make("sensor_msgs/msg/CompressedImage", ros.header(0, ""), "", np.zeros(0, np.uint8))
    mesh = ros.make("visualization_msgs/msg/MeshFile", "", np.zeros(0, np.uint8))
    return ros.make(
        "visualization_msgs/msg/Marker", ros.header(t_ns, WORLD), name, index, kind, 0, _pose((0, 0, 0)),
        ros.make("geometry_msgs/msg/Vector3", *size), colour, lifetime, True, places, list(colours), "", picture, [],
        "", "", mesh, False,
    )  # fmt: skip


def points_of(corners: Floats) -> list[Any]:
    """Encode places (n, 3) as Points [m]."""
    point = ros.typestore().types["geometry_msgs/msg/Point"]
    return [point(x, y, z) for x, y, z in corners.tolist()]


def _pose(position: tuple[float, float, float]) -> Any:
    at = ros.make("geometry_msgs/msg/Point", *map(float, position))
    return ros.make("geometry_msgs/msg/Pose", at, ros.make("geometry_msgs/msg/Quaternion", 0.0, 0.0, 0.0, 1.0))
