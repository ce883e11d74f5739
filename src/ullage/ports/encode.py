"""Encode ROS 2 messages that ullage only writes, as CDR; `ports.conversions` has those that it also reads."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from ullage.arrays import Bools, Floats
from ullage.data import Detections, Frames, Trajectory
from ullage.fan import drawn_rays
from ullage.geometry import matrix_quat, quat_rpy, rpy_quat
from ullage.grids import Image, OccupancyMap
from ullage.ports import schema as ros
from ullage.ports.conversions import PROFILE, STRAIGHT, WORLD, cloud_messages, level_m
from ullage.ports.protocol import Passed
from ullage.processing.obstacles import ObstacleSectors
from ullage.world.scene import Scene

if TYPE_CHECKING:
    from ullage.flight.live import Wish

SCAN_DIRECTIONS = 72
MOST_TRIANGLES = 50_000
TRIANGLES, LINES, CUBES = 11, 5, 6
"""Kinds of a Marker."""
ADD, DELETE, DELETE_ALL = 0, 2, 3
"""Actions of a Marker."""
PAINT = {
    "steel": (0.55, 0.60, 0.68),
    "pec": (0.55, 0.60, 0.68),
    "concrete": (0.70, 0.68, 0.64),
    "wood": (0.72, 0.54, 0.34),
}
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
    columns = {
        "field_of_view": np.radians(frames.spec.thesis.fov_deg), "min_range": max(float(frames.range_m[0]), 0.0),
        "max_range": frames.range_m[-1], "range": nearest, "variance": step**2 / 12,
    }  # fmt: skip
    return ros.layout(ros.RANGE, (frame_id or frames.sensor).encode()).fill(frames.t_ns, columns)


def range_message(t_ns: int, range_m: float, limits_m: tuple[float, float], fov_rad: float, *, frame_id: str) -> bytes:
    """Encode one Range of another sensor, such as a sonar."""
    low, high = limits_m
    fields = {"field_of_view": fov_rad, "min_range": low, "max_range": high, "range": range_m}
    return ros.encoded(ros.RANGE, fields, t_ns=t_ns, frame_id=frame_id)


def scan_message(sectors: ObstacleSectors, *, frame_id: str) -> bytes:
    """Encode the nearest obstacle in 72 horizontal directions of the body as LaserScan; +inf: free, NaN: unknown."""
    angles = -np.pi + 2 * np.pi / SCAN_DIRECTIONS * np.arange(SCAN_DIRECTIONS)
    inside = np.array([sectors.covers(float(angle)) for angle in angles])
    sound = inside.any(1) & ~(inside & ~sectors.valid).any(1)
    near = np.roll(sectors.nearest_m(), SCAN_DIRECTIONS // 2)
    ranges = np.where(np.isfinite(near) | sound, near, np.nan).astype(np.float32)
    fields = {
        "angle_min": -np.pi, "angle_max": angles[-1], "angle_increment": 2 * np.pi / SCAN_DIRECTIONS,
        "range_min": float(np.max(sectors.least_m)), "range_max": float(np.min(sectors.reach_m)), "ranges": ranges,
    }  # fmt: skip
    return ros.encoded(ros.SCAN, fields, t_ns=sectors.t_ns, frame_id=frame_id)


def imu_message(
    t_ns: int, quat_xyzw: Floats | None, rate_rad_s: Floats, acceleration_m_s2: Floats, *, frame_id: str,
    variances: tuple[float, float] = (0.0, 0.0),
) -> bytes:  # fmt: skip
    """Encode attitude in the world, and turn rate and specific force in the body, as Imu; zero covariance: unknown.

    Args:
        t_ns: when [ns].
        quat_xyzw: world_from_body (4); None: unknown.
        rate_rad_s: in the body (3).
        acceleration_m_s2: acceleration less gravity in the body (3), +9.81 along z at rest as accelerometers give it.
        frame_id: of the body.
        variances: of each axis of turn rate [rad2/s2] and acceleration [m2/s4].
    """
    turning, pushing = (np.diag([v] * 3).ravel() for v in variances)
    attitude, known = ((0, 0, 0, 1), np.diag([-1, 0, 0])) if quat_xyzw is None else (tuple(quat_xyzw), np.zeros(9))
    fields = {
        "orientation": attitude, "orientation_covariance": known.ravel().astype(float),
        "angular_velocity": tuple(rate_rad_s), "angular_velocity_covariance": turning,
        "linear_acceleration": tuple(acceleration_m_s2), "linear_acceleration_covariance": pushing,
    }  # fmt: skip
    return ros.encoded(ros.IMU, fields, t_ns=t_ns, frame_id=frame_id)


def command_message(t_ns: int, wish: Wish, quat_xyzw: Floats, *, frame_id: str) -> Passed:
    """Encode a pilot's command, a velocity or a set-point, as the vehicle got it.

    Args:
        t_ns: when [ns].
        wish: the command.
        quat_xyzw: the vehicle's attitude (4), whose heading a set-point without one keeps.
        frame_id: of the body.
    """
    if wish.position_m is None:
        forward, left = wish.velocity_m_s or (0.0, 0.0)
        twist = {"linear": (forward, left, wish.climb_m_s or 0.0), "angular": (0.0, 0.0, wish.turn_rad_s or 0.0)}
        data = ros.encoded(ros.TWIST_STAMPED, {"twist": twist}, t_ns=t_ns, frame_id=frame_id)
        return Passed(t_ns, ros.PILOT_VELOCITY, ros.TWIST_STAMPED, data)
    heading = float(quat_rpy(quat_xyzw)[2]) if wish.heading_rad is None else wish.heading_rad
    pose = {"position": wish.position_m, "orientation": tuple(rpy_quat(0.0, 0.0, heading))}
    data = ros.encoded(ros.POSE, {"pose": pose}, t_ns=t_ns, frame_id=WORLD)
    return Passed(t_ns, ros.PILOT_PLACE, ros.POSE, data)


def fixed_message(t_ns: int, fixed: Mapping[tuple[str, str], Floats]) -> bytes:
    """Encode static transforms as TFMessage: (parent, child) to parent_from_child (4, 4)."""
    listed = [
        (ros.header(t_ns, parent), child, (tuple(matrix[:3, 3]), tuple(matrix_quat(matrix[:3, :3]))))
        for (parent, child), matrix in fixed.items()
    ]
    return ros.encoded(ros.TRANSFORMS, {"transforms": listed})


def path_message(path: Trajectory) -> bytes:
    """Encode a Path message."""
    rows = zip(path.t_ns.tolist(), path.position.tolist(), path.quat_xyzw.tolist(), strict=True)
    poses = [(ros.header(t_ns, WORLD), (tuple(place), tuple(turn))) for t_ns, place, turn in rows]
    return ros.encoded(ros.PATH, {"poses": poses}, t_ns=int(path.t_ns[-1]), frame_id=WORLD)


def update_message(t_ns: int, x: int, y: int, cells: NDArray[np.int8]) -> bytes:
    """Encode cells (rows, columns) that start at column x and row y as OccupancyGridUpdate."""
    rows, columns = cells.shape
    fields = {"x": x, "y": y, "width": columns, "height": rows, "data": np.ascontiguousarray(cells).ravel()}
    return ros.encoded(ros.UPDATE, fields, t_ns=t_ns, frame_id=WORLD)


def occupied_message(omap: OccupancyMap, t_ns: int) -> bytes:
    """Encode the occupied cells of a volume as PointCloud2."""
    cells = np.argwhere(omap.occupied)
    points = np.zeros((1, len(cells)), PROFILE)
    for axis, centres, row in zip("zyx", (omap.grid.z_m, omap.grid.y_m, omap.grid.x_m), cells.T, strict=True):
        points[axis] = centres[row]
    points["intensity"] = omap.percent[omap.occupied]
    return cloud_messages(np.array([t_ns]), points, frame_id=WORLD)[0]


def marker(
    t_ns: int, name: str, kind: int, points: Floats, size: tuple[float, float, float], colour: tuple[float, ...],
    **others: Any,
) -> dict[str, Any]:  # fmt: skip
    """Return the fields of a Marker in the world, its points (n, 3) [m], and one colour; `others` go before."""
    return {
        "header": ros.header(t_ns, WORLD), "ns": name, "type": kind, "pose": ((0.0, 0.0, 0.0), STRAIGHT),
        "scale": size, "color": colour, "frame_locked": True, "points": points,
    } | others  # fmt: skip


def _markers(made: list[dict[str, Any]]) -> bytes:
    return ros.encoded(ros.MARKERS, {"markers": made})


def scene_message(scene: Scene, t_ns: int) -> bytes:
    """Encode each object's triangles and wires as MarkerArray; only the largest triangles if there are too many."""
    corners = scene.corners()
    owner = scene.face_object
    if len(corners) > MOST_TRIANGLES:
        area = np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1)
        keep = np.sort(np.argsort(area)[-MOST_TRIANGLES:])
        corners, owner = corners[keep], owner[keep]
    lines = np.stack([scene.wires.start, scene.wires.end], axis=1)
    made = []
    for index, thing in enumerate(scene.objects):
        mine = scene.wires.object_id == index
        triangles, wires = corners[owner == index].reshape(-1, 3), lines[mine].reshape(-1, 3)
        colour = (*PAINT.get(thing.material.name, (0.6, 0.6, 0.6)), 0.6)
        if len(triangles):
            made.append(marker(t_ns, thing.name, TRIANGLES, triangles, (1.0, 1.0, 1.0), colour, id=index))
        if len(wires):
            size = (2 * float(scene.wires.radius_m[mine].max()), 1.0, 1.0)
            made.append(marker(t_ns, f"{thing.name} wires", LINES, wires, size, colour, id=index))
    return _markers(made)


def rays_message(frames: Frames, *, frame_id: str = "") -> bytes:
    """Encode the ray model's fan as a MarkerArray of lines in the sensor's frame, which moves them."""
    t_ns, ends = int(frames.t_ns[0]), drawn_rays(frames.spec)
    lines = np.stack([np.zeros_like(ends), ends], axis=1).reshape(-1, 3)
    head = ros.header(t_ns, frame_id or frames.sensor)
    colour = (0.3, 0.5, 1.0, 0.25)
    return _markers([marker(t_ns, f"rays {frames.sensor}", LINES, lines, (0.004, 1.0, 1.0), colour, header=head)])


def cubes_message(omap: OccupancyMap, t_ns: int, *, most: int = 100_000) -> bytes:
    """Encode the `most` likeliest occupied cells of a volume as a MarkerArray of cubes, coloured by height."""
    cells = np.argwhere(omap.occupied)
    if len(cells) > most:
        cells = cells[np.sort(np.argsort(omap.percent[tuple(cells.T)], kind="stable")[-most:])]
    places = np.stack([omap.grid.x_m[cells[:, 2]], omap.grid.y_m[cells[:, 1]], omap.grid.z_m[cells[:, 0]]], axis=1)
    share = cells[:, 0] / max(omap.grid.shape[0] - 1, 1)
    colours = np.stack([share, 0.4 + 0 * share, 1 - share, 1 + 0 * share], axis=1)
    size = (omap.grid.step_m,) * 3
    return _markers([marker(t_ns, "map", CUBES, places, size, (0.5, 0.5, 0.5, 1.0), colors=colours)])


def plane_message(omap: OccupancyMap, t_ns: int) -> bytes:
    """MarkerArray of a plane map for viewers: its free, ambiguous and occupied cells; unknown cells are not drawn.

    RViz draws the unknown cells of an OccupancyGrid opaque in each of its palettes. Each kind of cell is a marker with
    a name space of its own, so a viewer can hide it. An occupied cell is drawn two cells wide.
    """
    step = float(omap.grid.step_m)
    made = []
    for index, (name, colour) in enumerate(CELL_COLOURS.items()):
        cells = getattr(omap, name)
        whole = name == "occupied"
        level = _centres(omap, cells) if whole else _rectangles(cells, omap.grid.origin_m, step)
        places = np.insert(level, 2, level_m(omap), axis=1)
        kind, size = (CUBES, (2 * step, 2 * step, step)) if whole else (TRIANGLES, (1.0, 1.0, 1.0))
        action = ADD if len(places) else DELETE
        made.append(marker(t_ns, name, kind, places, size, colour, id=index, action=action))
    return _markers(made)


def surfaces_message(omap: OccupancyMap, t_ns: int) -> bytes:
    """MarkerArray of the surfaces of a map: short lines along the surface at each specular point.

    A surface is a marker with its number as id, in the name space of its kind. The first marker deletes those of the
    last message, since surfaces may be merged or dropped. Surfaces that are not on the map are left out, except slopes.
    """
    step = float(omap.grid.step_m)
    made = [marker(t_ns, "", LINES, np.zeros((0, 3)), (step, 1.0, 1.0), (0.0, 0.0, 0.0, 0.0), action=DELETE_ALL)]
    for number, one in enumerate(omap.surfaces):
        if one.on_map or one.kind == "slope":
            places = one.lines(1.5 * step, level_m(omap)).reshape(-1, 3)
            colour = SURFACE_COLOURS.get(one.kind, SURFACE_COLOURS["slope"])
            made.append(marker(t_ns, one.kind, LINES, places, (0.5 * step, 1.0, 1.0), colour, id=number))
    return _markers(made)


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
    step = columns * pixels.dtype.itemsize
    fields = {
        "height": rows,
        "width": columns,
        "encoding": encoding,
        "step": step,
        "data": pixels.view(np.uint8).ravel(),
    }
    return ros.encoded(ros.PICTURE, fields, t_ns=t_ns, frame_id=WORLD)
