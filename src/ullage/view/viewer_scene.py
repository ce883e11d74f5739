"""Objects in the viewer: the scene as coloured meshes that open towards the eye, the drone, the beams of its radars."""

from __future__ import annotations

import re
from typing import Any

import numpy as np

from ullage.arrays import Bools, Floats, Longs
from ullage.data import Frames, Trajectory
from ullage.errors import need
from ullage.fan import drawn_rays
from ullage.geometry import invert
from ullage.specs import RadarSpec
from ullage.view.world_picture import CLEAR, COLORS
from ullage.world.scene import Scene
from ullage.world.smoothing import crosses, face_normals

SENSOR_COLORS = ("#4cc9f0", "#f9c74f", "#f3722c", "#90be6d", "#c77dff", "#f28482")
"""Colours of radars, in order."""
HULL_SPAN = 0.6  # least length of a hull part, as a share of the world's length along one axis
HULL_AREA = 2e-4  # least mean area of its triangles, as a share of the surface of the world's bounding box
GREY = "#b4b4b4"
PATH = "#ff2e63"
"""Colour of the drone and its path."""


def rgba(color: str, alpha: int = 255) -> tuple[int, int, int, int]:
    """Convert a hex colour to bytes."""
    return int(color[1:3], 16), int(color[3:5], 16), int(color[5:7], 16), alpha


def sensor_color(index: int) -> str:
    """Return the colour of the n-th radar, as hex."""
    return SENSOR_COLORS[index % len(SENSOR_COLORS)]


def entity(*names: str) -> str:
    """Make an entity path of the viewer from names with any characters."""
    return "/".join(re.sub(r"[^\w.-]", "_", name) or "_" for name in names)


def log_scene(rec: Any, scene: Scene) -> None:
    """Draw every object; hull walls are visible from inside only, so that holds and rooms are open to the eye."""
    rr, hull = need("rerun", extra="view"), hull_objects(scene)
    for index, thing in enumerate(scene.objects):
        mine = scene.face_object == index
        wires = scene.wires.object_id == index
        path = f"world/scene/{entity(thing.name)}"
        color = COLORS.get(thing.material.name, GREY)
        if mine.any():
            corners = scene.vertices[scene.faces[mine]]
            alpha = 90 if thing.material.name in CLEAR else 255
            center = scene.bounds.mean(axis=0) if hull[index] and thing.motion is None else None
            rec.log(path, _mesh(corners, rgba(color, alpha), center=center), static=True)
        if wires.any():
            strips = np.stack([scene.wires.start[wires], scene.wires.end[wires]], axis=1).astype(np.float32)
            lines = rr.LineStrips3D(strips, radii=rr.Radius.ui_points(0.8), colors=rgba("#f1faee"))
            rec.log(f"{path}/wires", lines, static=True)
        if thing.motion is not None:
            log_poses(rec, path, thing.motion.at(thing.motion.t_ns))


def hull_objects(scene: Scene) -> Bools:
    """Select walls, floors and decks that surround everything else: long objects of large triangles."""
    size = np.ptp(scene.bounds, axis=0)
    surface = 2 * (size[0] * size[1] + size[1] * size[2] + size[2] * size[0])
    corners = scene.corners()
    area = face_normals(corners)[1]
    out = np.zeros(len(scene.objects), bool)
    for index in range(len(out)):
        mine = scene.face_object == index
        if mine.any():
            span = np.ptp(corners[mine].reshape(-1, 3), axis=0) / np.maximum(size, 1e-9)
            out[index] = span.max() >= HULL_SPAN and area[mine].mean() >= HULL_AREA * surface
    return out


def _mesh(corners: Floats, color: tuple[int, int, int, int], *, center: Floats | None) -> Any:
    """Make a flat-shaded mesh of triangles (f, 3, 3); with a centre, facing it and visible from that side only."""
    rr = need("rerun", extra="view")
    side = "DoubleSided"
    if center is not None:
        corners, side = turned_inwards(corners, center), "Front"
    normal, _ = face_normals(corners)
    return rr.Mesh3D(
        vertex_positions=corners.reshape(-1, 3).astype(np.float32),
        vertex_normals=np.repeat(normal, 3, axis=0).astype(np.float32),
        albedo_factor=color,
        face_rendering=side,
    )


def turned_inwards(corners: Floats, center: Floats) -> Floats:
    """Order the corners of triangles (f, 3, 3) so that the front of each is towards a point (3)."""
    away = np.einsum("fk,fk->f", crosses(corners), center - corners.mean(axis=1)) < 0
    return np.where(away[:, None, None], corners[:, ::-1], corners)


def log_poses(rec: Any, path: str, poses: Trajectory) -> None:
    """Log positions and orientations over time."""
    rr = need("rerun", extra="view")
    columns = rr.Transform3D.columns(
        translation=poses.position.astype(np.float32), quaternion=poses.quat_xyzw.astype(np.float32)
    )
    rec.send_columns(path, indexes=[time_column(poses.t_ns)], columns=columns)


def time_column(t_ns: Longs) -> Any:
    """Make a column of the viewer's time line: seconds of the run, or dates where the clock counts dates."""
    rr = need("rerun", extra="view")
    if is_date(int(t_ns[0])):
        return rr.TimeColumn(TIMELINE, timestamp=t_ns.astype("datetime64[ns]"))
    return rr.TimeColumn(TIMELINE, duration=t_ns.astype("timedelta64[ns]"))


TIMELINE = "time"


def is_date(t_ns: int) -> bool:
    """Return whether a time counts from 1970, as in recordings, and not from the start of the run."""
    return t_ns > 10**17  # 1973


def log_drone(rec: Any) -> None:
    """Draw arms and rotors of a small quadrotor, in the body frame."""
    rr = need("rerun", extra="view")
    turn = np.linspace(0, 2 * np.pi, 25)
    rim = 0.13 * np.stack([np.cos(turn), np.sin(turn), np.zeros(25)], axis=1)
    hubs = 0.25 * np.array([[1, 1, 0], [-1, 1, 0], [-1, -1, 0], [1, -1, 0]]) / np.sqrt(2)
    strips = [np.stack([hubs[0], hubs[2]]), np.stack([hubs[1], hubs[3]]), *(hub + rim for hub in hubs)]
    rec.log("world/drone", rr.LineStrips3D(strips, colors=rgba(PATH), radii=rr.Radius.ui_points(1.5)), static=True)


def log_beam(rec: Any, path: str, spec: RadarSpec, color: str) -> None:
    """Draw the radar's -3 dB beam as a faint frustum, in the sensor frame."""
    rr = need("rerun", extra="view")
    reach = float(min(spec.range_m[-1], 2.5))
    rim = beam_rim(*beam_deg(spec), reach)
    strips = [rim[[0, 1, 2, 3, 0]], *(np.stack([np.zeros(3), corner]) for corner in rim)]
    lines = rr.LineStrips3D(strips, colors=rgba(color, 110), radii=rr.Radius.ui_points(0.8))
    rec.log(f"{path}/beam", lines, static=True)
    fan = np.concatenate([np.zeros((1, 3)), rim])
    faces = [[0, 1, 2], [0, 2, 3], [0, 3, 4], [0, 4, 1]]
    rec.log(
        f"{path}/beam/sides",
        rr.Mesh3D(vertex_positions=fan, triangle_indices=faces, albedo_factor=rgba(color, 22)),
        static=True,
    )


def beam_rim(azimuth_deg: float, elevation_deg: float, reach_m: float) -> Floats:
    """Return the corners (4, 3) of a beam [m] at a distance from the radar, in the sensor frame."""
    wide, tall = np.tan(np.radians([azimuth_deg, elevation_deg]) / 2)
    rim = np.array([[1, wide, tall], [1, -wide, tall], [1, -wide, -tall], [1, wide, -tall]])
    return np.asarray(rim * (reach_m / np.linalg.norm(rim, axis=1, keepdims=True)))


def log_rays(rec: Any, path: str, spec: RadarSpec, color: str) -> None:
    """Draw the ray model's fan as thin lines to its maximum range, in the sensor frame, once."""
    rr = need("rerun", extra="view")
    ends = drawn_rays(spec)
    strips = np.stack([np.zeros_like(ends), ends], axis=1).astype(np.float32)
    lines = rr.LineStrips3D(strips, colors=rgba(color, 60), radii=rr.Radius.ui_points(0.5))
    rec.log(f"{path}/rays", lines, static=True)


def beam_deg(spec: RadarSpec) -> tuple[float, float]:
    """Return the -3 dB beam widths in azimuth and elevation [deg], at most 120 each."""
    wide = {"x4a02": 65.0, "isotropic": 120.0}.get(spec.antenna.kind)
    pair = (spec.antenna.azimuth_deg, spec.antenna.elevation_deg) if wide is None else (wide, wide)
    return min(pair[0], 120.0), min(pair[1], 120.0)


def body_of(frames: Frames) -> Trajectory | None:
    """Return the path of the body that carries the radar, if it is known."""
    return None if frames.poses is None else frames.poses.mounted(invert(frames.spec.mount.body_from_sensor()))


def beam_arcs(world_from_sensor: Floats, range_m: Floats, opening_deg: float) -> tuple[Floats, Floats]:
    """Return the possible places of echoes at poses (d, 4, 4): arcs (d, 17, 3) over the beam, points ahead (d, 3)."""
    turn = np.radians(np.linspace(-opening_deg / 2, opening_deg / 2, 17))
    local = np.stack([np.cos(turn), np.sin(turn), np.zeros(17)], axis=1)
    seen = np.einsum("dij,kj->dki", world_from_sensor[:, :3, :3], local) * range_m[:, None, None]
    out = seen + world_from_sensor[:, None, :3, 3]
    return out, out[:, 8]
