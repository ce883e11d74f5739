"""Radar frames on the topics of either Gazebo: whole frames, profiles, the nearest range, and points."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any

import numpy as np

from ullage.arrays import Floats
from ullage.data import Frames
from ullage.ports.gazebo.messages import classic, gz
from ullage.ports.gazebo.peer import Peer

FLOAT32, R_FLOAT32 = 6, 13
"""A field's type in a packed cloud of Transport, and the pixel format of one float32 a pixel in Classic."""
FIELDS = ("x", "y", "z", "intensity")
WIDEST_DEG = 150.0
"""Of the cone that gzclient draws."""
KINDS = {
    "frame": ("Float_V", "ImageStamped"), "profile": ("Float_V", "ImageStamped"), "range": ("Double", "SonarStamped"),
    "points": ("PointCloudPacked", "PointCloud"),
}  # fmt: skip
"""Types of the topics in Transport and in Classic."""
CLASSIC = "gazebo.msgs"


class RadarTopics:
    """Publishes frames under `ROOT/radar/SENSOR/`.

    | topic | Transport | Classic |
    |---|---|---|
    | `frame` | Float_V: every sample, re and im by turns at baseband | ImageStamped: the same as one row of float32 |
    | `profile` | Float_V: magnitudes | ImageStamped: the same |
    | `range` | Double: the nearest echo [m], infinite where none | SonarStamped: the same, range_max where none |
    | `points` | PointCloudPacked along the boresight | PointCloud: the nearest echo on the boresight |

    Args:
        peer: the connection to Gazebo.
        root: `/model/MODEL`, or in Classic `/gazebo/WORLD/MODEL`.
        package: `gz.msgs`, `ignition.msgs` up to Fortress, or `gazebo.msgs` in Classic.
    """

    def __init__(self, peer: Peer, root: str, package: str) -> None:
        self.peer, self.package, self._root = peer, package, root
        self._known: set[str] = set()

    def write(self, frames: Frames, offset_ns: int = 0) -> None:
        """Publish every frame; their time minus the offset is Gazebo's time."""
        root = f"{self._root}/radar/{frames.sensor}"
        if frames.sensor not in self._known:
            self._known.add(frames.sensor)
            for name, kinds in KINDS.items():
                self.peer.advertise(f"{root}/{name}", f"{self.package}.{kinds[self.package == CLASSIC]}")
        encode = _classic if self.package == CLASSIC else _transport
        for i, range_m in enumerate(nearest(frames).tolist()):
            sec, nsec = divmod(int(frames.t_ns[i]) - offset_ns, 10**9)
            for name, message in zip(KINDS, encode(frames, i, (sec, nsec), range_m), strict=True):
                self.peer.publish(f"{root}/{name}", message)


def _values(frames: Frames, i: int) -> tuple[Any, Any]:
    """Return the samples and their magnitudes as float32."""
    return frames.samples[i].view(np.float32), np.abs(frames.samples[i]).astype(np.float32)


def _transport(frames: Frames, i: int, stamp: tuple[int, int], range_m: float) -> tuple[Any, ...]:
    samples, magnitude = _values(frames, i)
    about = {
        "frame_id": frames.sensor, "range_start_m": f"{frames.range_m[0]:.9g}",
        "bin_m": f"{(frames.range_m[-1] - frames.range_m[0]) / (len(frames.range_m) - 1):.12g}",
        "unit": frames.unit, "samples": "baseband" if np.iscomplexobj(frames.samples) else "real",
    }  # fmt: skip
    data = [gz().Map(key=key, value=[value]) for key, value in about.items()]
    head = gz().Header(stamp=gz().Time(sec=stamp[0], nsec=stamp[1]), data=data)
    points = np.zeros((len(frames.range_m), len(FIELDS)), "<f4")
    points[:, 0], points[:, 3] = frames.range_m, magnitude
    fields = [gz().Field(name=name, offset=4 * k, datatype=FLOAT32, count=1) for k, name in enumerate(FIELDS)]
    step = 4 * len(FIELDS)
    cloud = gz().PointCloudPacked(
        header=head, field=fields, height=1, width=len(points), point_step=step, row_step=step * len(points),
        data=points.tobytes(), is_dense=True,
    )  # fmt: skip
    rows = (gz().Float_V(header=head, data=values) for values in (samples, magnitude))
    return *rows, gz().Double(header=head, data=range_m), cloud


def _classic(frames: Frames, i: int, stamp: tuple[int, int], range_m: float) -> tuple[Any, ...]:
    message = classic()
    time = message.Time(sec=stamp[0], nsec=stamp[1])

    def row(values: Any) -> Any:
        data = np.ascontiguousarray(values, "<f4").tobytes()
        image = message.Image(width=len(values), height=1, pixel_format=R_FLOAT32, step=len(data), data=data)
        return message.ImageStamped(time=time, image=image)

    low, high = float(frames.range_m[0]), float(frames.range_m[-1])
    half = math.radians(min(frames.spec.thesis.fov_deg, WIDEST_DEG) / 2)
    at, turn = (0.0, 0.0, 0.0), (0.0, 0.0, 0.0, 1.0)
    if frames.poses is not None:
        at, turn = tuple(frames.poses.position[i]), tuple(frames.poses.quat_xyzw[i])
    pose = message.Pose(
        position=message.Vector3d(**dict(zip("xyz", at, strict=True))),
        orientation=message.Quaternion(**dict(zip("xyzw", turn, strict=True))),
    )
    sonar = message.Sonar(
        frame=frames.sensor, world_pose=pose, range_min=max(low, 0.0), range_max=high, radius=high * math.tan(half),
        range=min(range_m, high), geometry="cone",
    )  # fmt: skip
    hit = [message.Vector3d(x=range_m, y=0.0, z=0.0)] if math.isfinite(range_m) else []
    rows = map(row, _values(frames, i))
    return *rows, message.SonarStamped(time=time, sonar=sonar), message.PointCloud(points=hit)


def nearest(frames: Frames) -> Floats:
    """Return the range of the first detection of each frame (n) [m]; infinite if there is none."""
    from ullage.processing.detect import detect

    out = np.full(len(frames), np.inf)
    found = detect(replace(frames, poses=None, truth=None))
    np.minimum.at(out, found.frame, found.range_m)
    return out
