"""Encode ROS 2 messages that ullage only writes, as CDR; `ports.conversions` has those that it also reads."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import lru_cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ullage.arrays import Bools, Floats
from ullage.data import Detections, Frames, Trajectory
from ullage.geometry import matrix_quat
from ullage.grids import AMBIGUOUS, UNKNOWN, Image, OccupancyMap
from ullage.ports import conversions
from ullage.ports import messages as ros
from ullage.ports.conversions import WORLD
from ullage.processing.obstacles import ObstacleSectors

RANGE = "sensor_msgs/msg/Range"
SCAN = "sensor_msgs/msg/LaserScan"
SCAN_DIRECTIONS = 72
PICTURE = "sensor_msgs/msg/Image"
PATH = "nav_msgs/msg/Path"
CLOCK = "rosgraph_msgs/msg/Clock"
DIAGNOSTICS = "diagnostic_msgs/msg/DiagnosticArray"
IMU = "sensor_msgs/msg/Imu"
CELL_COLOURS = {
    "free": (0.24, 0.86, 0.52, 0.22),
    "ambiguous": (0.95, 0.76, 0.31, 0.2),
    "occupied": (1.0, 0.72, 0.01, 1.0),
}
"""Red, green, blue and opacity of the cells of a plane map in viewers."""
SURFACE_COLOURS = {
    "plane": (0.1, 0.45, 0.9, 1.0),
    "cylinder": (0.55, 0.25, 0.85, 1.0),
    "edge": (0.9, 0.2, 0.3, 1.0),
    "lying": (0.1, 0.65, 0.65, 1.0),
    "slope": (0.45, 0.45, 0.45, 0.6),
}
"""The same of the surfaces that a mapper estimates, by kind."""
DEPTH_DB = 40.0
"""What a picture shows below its brightest cell [dB]."""


@lru_cache(64)
def range_layout(frame_id: bytes) -> ros.Layout:
    """Layout of Range."""
    return ros.Layout(
        *ros.HEADER, ("frame_id", frame_id), ("kind", "u1"), ("fov", "<f4"), ("min", "<f4"), ("max", "<f4"),
        ("range", "<f4"), ("variance", "<f4"),
    )  # fmt: skip


def range_messages(frames: Frames, found: Detections, *, frame_id: str = "") -> list[bytes]:
    """Encode the nearest detection of each frame as Range; +inf: none (REP-117).

    The radiation type is ultrasound, since ROS defines only that and infrared. The field of view is the antenna's.

    Args:
        frames: n frames of one sensor.
        found: the detections in them.
        frame_id: of the sensor; empty: its name.
    """
    nearest = np.full(len(frames), np.inf, np.float32)
    np.minimum.at(nearest, found.frame, found.range_m.astype(np.float32))
    step = float(frames.range_m[-1] - frames.range_m[0]) / max(len(frames.range_m) - 1, 1)
    return range_layout((frame_id or frames.sensor).encode()).fill(
        len(frames),
        **ros.stamps(frames.t_ns),
        fov=np.radians(frames.spec.thesis.fov_deg),
        min=max(float(frames.range_m[0]), 0.0),
        max=frames.range_m[-1],
        range=nearest,
        variance=step**2 / 12,
    )


def range_message(t_ns: int, range_m: float, limits_m: tuple[float, float], fov_rad: float, *, frame_id: str) -> bytes:
    """Encode one Range of another sensor, such as a sonar."""
    low, high = limits_m
    return range_layout(frame_id.encode()).fill(
        1, **ros.stamps(np.array([t_ns])), fov=fov_rad, min=low, max=high, range=range_m
    )[0]


def scan_message(sectors: ObstacleSectors, *, frame_id: str) -> bytes:
    """Encode the nearest obstacle in 72 horizontal directions of the body as LaserScan; +inf: free, NaN: unknown."""
    angles = -np.pi + 2 * np.pi / SCAN_DIRECTIONS * np.arange(SCAN_DIRECTIONS)
    inside = np.array([sectors.covers(float(angle)) for angle in angles])
    sound = inside.any(1) & ~(inside & ~sectors.valid).any(1)
    near = np.roll(sectors.nearest_m(), SCAN_DIRECTIONS // 2)
    ranges = np.where(np.isfinite(near) | sound, near, np.nan).astype(np.float32)
    low, high = float(np.max(sectors.least_m)), float(np.min(sectors.reach_m))
    head = ros.header(max(sectors.t_ns, 0), frame_id)
    step = 2 * np.pi / SCAN_DIRECTIONS
    return ros.to_bytes(
        SCAN, ros.make(SCAN, head, -np.pi, angles[-1], step, 0.0, 0.0, low, high, ranges, np.zeros(0, np.float32))
    )


@lru_cache(16)
def imu_layout(frame_id: bytes) -> ros.Layout:
    """Layout of Imu."""
    return ros.Layout(
        *ros.HEADER, ("frame_id", frame_id), ("orientation", ("<f8", 4)), ("orientation_covariance", ("<f8", 9)),
        ("rate", ("<f8", 3)), ("rate_covariance", ("<f8", 9)), ("acceleration", ("<f8", 3)),
        ("acceleration_covariance", ("<f8", 9)),
    )  # fmt: skip


def imu_message(
    t_ns: int, quat_xyzw: Floats, rate_rad_s: Floats, acceleration_m_s2: Floats, *, frame_id: str,
    variances: tuple[float, float] = (0.0, 0.0),
) -> bytes:  # fmt: skip
    """Encode attitude in the world, and turn rate and specific force in the body, as Imu; zero covariance: unknown.

    Args:
        t_ns: when [ns].
        quat_xyzw: world_from_body (4).
        rate_rad_s: in the body (3).
        acceleration_m_s2: acceleration less gravity in the body (3), +9.81 along z at rest as accelerometers give it.
        frame_id: of the body.
        variances: of each axis of turn rate [rad2/s2] and acceleration [m2/s4].
    """
    spread = {
        f"{name}_covariance": np.diag([v] * 3).ravel()
        for name, v in zip(("rate", "acceleration"), variances, strict=True)
    }
    return imu_layout(frame_id.encode()).fill(
        1, **ros.stamps(np.array([t_ns])), orientation=quat_xyzw, rate=rate_rad_s, acceleration=acceleration_m_s2,
        **spread,
    )[0]  # fmt: skip


def clock_message(t_ns: int) -> bytes:
    """Encode a Clock message."""
    sec, nanosec = divmod(t_ns, 1_000_000_000)
    return b"\0\1\0\0" + sec.to_bytes(4, "little", signed=True) + nanosec.to_bytes(4, "little")


def fixed_message(t_ns: int, fixed: Mapping[tuple[str, str], Floats]) -> bytes:
    """Encode static transforms as TFMessage: (parent, child) to parent_from_child (4, 4)."""
    listed = []
    for (parent, child), matrix in fixed.items():
        shift = ros.make("geometry_msgs/msg/Vector3", *matrix[:3, 3].tolist())
        turn = ros.make("geometry_msgs/msg/Quaternion", *matrix_quat(matrix[:3, :3]).tolist())
        move = ros.make("geometry_msgs/msg/Transform", shift, turn)
        listed.append(ros.make("geometry_msgs/msg/TransformStamped", ros.header(t_ns, parent), child, move))
    return ros.to_bytes(ros.TRANSFORMS, ros.make(ros.TRANSFORMS, listed))


def path_message(path: Trajectory, frame_id: str = WORLD) -> bytes:
    """Encode a Path message."""
    poses = []
    for t_ns, place, turn in zip(path.t_ns.tolist(), path.position.tolist(), path.quat_xyzw.tolist(), strict=True):
        at = ros.make("geometry_msgs/msg/Point", *place)
        pose = ros.make("geometry_msgs/msg/Pose", at, ros.make("geometry_msgs/msg/Quaternion", *turn))
        poses.append(ros.make(ros.POSE, ros.header(t_ns, frame_id), pose))
    return ros.to_bytes(PATH, ros.make(PATH, ros.header(int(path.t_ns[-1]), frame_id), poses))


def known_percent(omap: OccupancyMap) -> NDArray[np.int8]:
    """Return a map's cells in ROS's percent; ambiguous cells are unknown."""
    return np.where(omap.percent == AMBIGUOUS, UNKNOWN, omap.percent).astype(np.int8)


def update_message(t_ns: int, x: int, y: int, cells: NDArray[np.int8]) -> bytes:
    """Encode cells (rows, columns) that start at column x and row y as OccupancyGridUpdate."""
    rows, columns = cells.shape
    values = (ros.header(t_ns, WORLD), x, y, columns, rows, np.ascontiguousarray(cells).ravel())
    return ros.to_bytes(ros.UPDATE, ros.make(ros.UPDATE, *values))


def cubes_message(omap: OccupancyMap, t_ns: int, *, most: int = 100_000) -> bytes:
    """Encode the `most` likeliest occupied cells of a volume as a MarkerArray of cubes, coloured by height."""
    cells = np.argwhere(omap.occupied)
    if len(cells) > most:
        cells = cells[np.sort(np.argsort(omap.percent[tuple(cells.T)], kind="stable")[-most:])]
    places = np.stack([omap.grid.x_m[cells[:, 2]], omap.grid.y_m[cells[:, 1]], omap.grid.z_m[cells[:, 0]]], axis=1)
    share = cells[:, 0] / max(omap.grid.shape[0] - 1, 1)
    colours = np.stack([share, 0.4 + 0 * share, 1 - share, 1 + 0 * share], axis=1)
    point, colour = (ros.typestore().types[name] for name in ("geometry_msgs/msg/Point", "std_msgs/msg/ColorRGBA"))
    step = omap.grid.step_m
    shown = conversions.marker(
        t_ns, "map", 6, 0, [point(*p) for p in places.tolist()], (step, step, step), colour(0.5, 0.5, 0.5, 1.0),
        [colour(*c) for c in colours.tolist()],
    )  # fmt: skip
    return ros.to_bytes(ros.MARKERS, ros.make(ros.MARKERS, [shown]))


def plane_message(omap: OccupancyMap, t_ns: int) -> bytes:
    """MarkerArray of a plane map for viewers: its free, ambiguous and occupied cells; unknown cells are not drawn.

    RViz draws the unknown cells of an OccupancyGrid opaque in each of its palettes. Each kind of cell is a marker with
    a name space of its own, so a viewer can hide it. An occupied cell is drawn two cells wide.
    """
    step = float(omap.grid.step_m)
    z = omap.grid.origin_m[2] if np.isfinite(omap.grid.origin_m[2]) else 0.0
    point, colour = (ros.typestore().types[name] for name in ("geometry_msgs/msg/Point", "std_msgs/msg/ColorRGBA"))
    made = []
    for index, name in enumerate(("free", "ambiguous", "occupied")):
        cells = getattr(omap, name)
        whole = name == "occupied"
        places = _centres(omap, cells) if whole else _rectangles(cells, omap.grid.origin_m, step)
        size = (2 * step, 2 * step, step) if whole else (1.0, 1.0, 1.0)
        found = [point(x, y, z) for x, y in places.tolist()]
        shown = conversions.marker(t_ns, name, 6 if whole else 11, index, found, size, colour(*CELL_COLOURS[name]))
        shown.action = 0 if found else 2  # add, or delete
        made.append(shown)
    return ros.to_bytes(ros.MARKERS, ros.make(ros.MARKERS, made))


def surfaces_message(omap: OccupancyMap, t_ns: int) -> bytes:
    """MarkerArray of the surfaces of a map: short lines along the surface at each specular point.

    A surface is a marker with its number as id, in the name space of its kind. The first marker deletes those of the
    last message, since surfaces may be merged or dropped. Surfaces that are not on the map are left out, except slopes.
    """
    z = omap.grid.origin_m[2] if np.isfinite(omap.grid.origin_m[2]) else 0.0
    colour, step = ros.typestore().types["std_msgs/msg/ColorRGBA"], float(omap.grid.step_m)
    made = [conversions.marker(t_ns, "", 5, 0, [], (step, 1.0, 1.0), colour(0.0, 0.0, 0.0, 0.0))]
    made[0].action = 3  # delete all
    for number, one in enumerate(omap.surfaces):
        if one.on_map or one.kind == "slope":
            places = conversions.points_of(one.lines(1.5 * step, z).reshape(-1, 3))
            shade = colour(*SURFACE_COLOURS.get(one.kind, SURFACE_COLOURS["slope"]))
            made.append(conversions.marker(t_ns, one.kind, 5, number, places, (0.5 * step, 1.0, 1.0), shade))
    return ros.to_bytes(ros.MARKERS, ros.make(ros.MARKERS, made))


def _centres(omap: OccupancyMap, cells: Bools) -> Floats:
    row, column = np.nonzero(cells)
    return np.stack([omap.grid.x_m[column], omap.grid.y_m[row]], axis=1)


def _rectangles(cells: Bools, origin_m: tuple[float, float, float], step_m: float) -> Floats:
    """Corners (6 n, 2) of two triangles for each run of cells along a row [m]."""
    edges = np.diff(np.pad(cells, ((0, 0), (1, 1))).astype(np.int8), axis=1)
    row, left = np.nonzero(edges == 1)
    right = np.nonzero(edges == -1)[1]
    x = np.stack([left, right, right, left, right, left], axis=1)
    y = np.stack([row, row, row + 1, row, row + 1, row + 1], axis=1)
    corners: Floats = np.stack([x.ravel(), y.ravel()], axis=1) * step_m + np.asarray(origin_m[:2])
    return corners


def picture_messages(image: Image, t_ns: int) -> tuple[bytes, bytes]:
    """Encode a plane image twice: as mono8 in decibels below its brightest cell, and as 32FC1 amplitudes.

    The first row has the greatest y, as in pictures. A volume gives its brightest layer.
    """
    values = image.amplitude
    if values.ndim == 3:
        values = values[int(np.argmax(values.max(axis=(1, 2))))]
    values = np.ascontiguousarray(values[::-1], np.float32)
    peak = float(values.max()) or 1.0
    level = 20 * np.log10(np.maximum(values / peak, 1e-9))
    grey = np.clip(255 * (1 + level / DEPTH_DB), 0, 255).astype(np.uint8)
    return _picture(grey, "mono8", t_ns), _picture(values, "32FC1", t_ns)


def _picture(pixels: NDArray[Any], encoding: str, t_ns: int) -> bytes:
    rows, columns = pixels.shape
    head, step = ros.header(t_ns, WORLD), columns * pixels.dtype.itemsize
    return ros.to_bytes(
        PICTURE, ros.make(PICTURE, head, rows, columns, encoding, 0, step, pixels.view(np.uint8).ravel())
    )


def diagnostics_message(t_ns: int, level: int, name: str, text: str, values: Sequence[tuple[str, str]]) -> bytes:
    """Encode one status as DiagnosticArray: level 0 OK, 1 warning, 2 error, 3 stale."""
    pairs = [ros.make("diagnostic_msgs/msg/KeyValue", key, value) for key, value in values]
    status = ros.make("diagnostic_msgs/msg/DiagnosticStatus", level, name, text, "ullage", pairs)
    return ros.to_bytes(DIAGNOSTICS, ros.make(DIAGNOSTICS, ros.header(t_ns, ""), [status]))
