"""Radar frames on gzserver's topics: whole frames as images, the nearest range as sonar and as a point."""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from ullage.data import Frames
from ullage.ports.cosimulation import nearest
from ullage.ports.gazebo_classic.peer import ClassicPeer, type_of
from ullage.ports.gazebo_classic.wire import gz

R_FLOAT32 = 13
"""Pixel format of one float32 a pixel."""
WIDEST_DEG = 150.0
"""Of the cone that gzclient draws."""


class RadarTopics:
    """Publishes frames under `/gazebo/WORLD/MODEL/radar/SENSOR/`.

    Topics: `frame` (ImageStamped, one row of float32: re and im by turns at baseband), `profile` (the same of
    magnitudes), `range` (SonarStamped: the nearest echo, range_max where there is none), `points` (PointCloud: the
    nearest echo on the boresight).

    Args:
        peer: the connection to the server.
        world: its name of the world.
        model: the model that carries the radars.
    """

    def __init__(self, peer: ClassicPeer, world: str, model: str) -> None:
        self._peer, self._root = peer, f"/gazebo/{world}/{model}/radar"
        self._known: set[str] = set()

    def write(self, frames: Frames, offset_ns: int = 0) -> None:
        """Publish every frame; their time minus the offset is Gazebo's time."""
        root = f"{self._root}/{frames.sensor}"
        if frames.sensor not in self._known:
            self._known.add(frames.sensor)
            kinds = (("frame", "ImageStamped"), ("profile", "ImageStamped"), ("range", "SonarStamped"))
            for name, kind in (*kinds, ("points", "PointCloud")):
                self._peer.advertise(f"{root}/{name}", type_of(kind))
        first = nearest(frames)
        magnitude = np.abs(frames.samples).astype(np.float32)
        for i in range(len(frames)):
            t_ns = int(frames.t_ns[i]) - offset_ns
            stamp = gz().Time(sec=t_ns // 10**9, nsec=t_ns % 10**9)
            self._peer.publish(f"{root}/frame", _row(stamp, frames.samples[i].view(np.float32)))
            self._peer.publish(f"{root}/profile", _row(stamp, magnitude[i]))
            self._peer.publish(f"{root}/range", _sonar(stamp, frames, i, float(first[i])))
            hit = [gz().Vector3d(x=float(first[i]), y=0.0, z=0.0)] if np.isfinite(first[i]) else []
            self._peer.publish(f"{root}/points", gz().PointCloud(points=hit))


def _row(stamp: Any, values: Any) -> Any:
    data = np.ascontiguousarray(values, "<f4").tobytes()
    image = gz().Image(width=len(values), height=1, pixel_format=R_FLOAT32, step=len(data), data=data)
    return gz().ImageStamped(time=stamp, image=image)


def _sonar(stamp: Any, frames: Frames, i: int, range_m: float) -> Any:
    low, high = float(frames.range_m[0]), float(frames.range_m[-1])
    half = math.radians(min(frames.spec.thesis.fov_deg, WIDEST_DEG) / 2)
    at, turn = (0.0, 0.0, 0.0), (0.0, 0.0, 0.0, 1.0)
    if frames.poses is not None:
        at, turn = tuple(frames.poses.position[i]), tuple(frames.poses.quat_xyzw[i])
    pose = gz().Pose(
        position=gz().Vector3d(**dict(zip("xyz", at, strict=True))),
        orientation=gz().Quaternion(**dict(zip("xyzw", turn, strict=True))),
    )
    sonar = gz().Sonar(
        frame=frames.sensor, world_pose=pose, range_min=max(low, 0.0), range_max=high, radius=high * math.tan(half),
        range=min(range_m, high), geometry="cone",
    )  # fmt: skip
    return gz().SonarStamped(time=stamp, sonar=sonar)
