"""Radar frames on Gazebo's topics: whole frames, profiles, the nearest range, points along the boresight."""

from __future__ import annotations

from typing import Any

import numpy as np

from ullage.data import Frames
from ullage.ports.cosimulation import nearest
from ullage.ports.gazebo.peer import Peer
from ullage.ports.gazebo.wire import gz

FLOAT32 = 6
"""A field's type in a packed cloud."""
FIELDS = ("x", "y", "z", "intensity")


class RadarTopics:
    """Publishes frames under `/model/MODEL/radar/SENSOR/`.

    Topics: `frame` (Float_V: every sample, re and im by turns at baseband), `profile` (Float_V: magnitudes), `range`
    (Double: the nearest echo [m], infinite where none), `points` (PointCloudPacked along the boresight).

    Args:
        peer: the connection to Gazebo.
        model: the model that carries the radars.
        package: `gz.msgs`, or `ignition.msgs` up to Fortress.
    """

    def __init__(self, peer: Peer, model: str, package: str) -> None:
        self._peer, self._root, self._package = peer, f"/model/{model}/radar", package
        self._known: set[str] = set()

    def write(self, frames: Frames, offset_ns: int = 0) -> None:
        """Publish every frame; their time minus the offset is Gazebo's time."""
        root = f"{self._root}/{frames.sensor}"
        kinds = {"frame": "Float_V", "profile": "Float_V", "range": "Double", "points": "PointCloudPacked"}
        if frames.sensor not in self._known:
            self._known.add(frames.sensor)
            for name, kind in kinds.items():
                self._peer.advertise(f"{root}/{name}", f"{self._package}.{kind}")
        first = nearest(frames)
        magnitude = np.abs(frames.samples).astype(np.float32)
        for i in range(len(frames)):
            head = _header(frames, i, offset_ns)
            samples = frames.samples[i].view(np.float32)
            self._peer.publish(f"{root}/frame", gz().Float_V(header=head, data=samples))
            self._peer.publish(f"{root}/profile", gz().Float_V(header=head, data=magnitude[i]))
            self._peer.publish(f"{root}/range", gz().Double(header=head, data=first[i]))
            self._peer.publish(f"{root}/points", _cloud(head, frames.range_m, magnitude[i]))


def _header(frames: Frames, i: int, offset_ns: int) -> Any:
    t_ns = int(frames.t_ns[i]) - offset_ns
    kind = "baseband" if np.iscomplexobj(frames.samples) else "real"
    about = {
        "frame_id": frames.sensor, "range_start_m": f"{frames.range_m[0]:.9g}",
        "bin_m": f"{(frames.range_m[-1] - frames.range_m[0]) / (len(frames.range_m) - 1):.12g}",
        "unit": frames.unit, "samples": kind,
    }  # fmt: skip
    data = [gz().Map(key=key, value=[value]) for key, value in about.items()]
    return gz().Header(stamp=gz().Time(sec=t_ns // 10**9, nsec=t_ns % 10**9), data=data)


def _cloud(head: Any, range_m: Any, magnitude: Any) -> Any:
    points = np.zeros((len(range_m), len(FIELDS)), "<f4")
    points[:, 0], points[:, 3] = range_m, magnitude
    fields = [gz().Field(name=name, offset=4 * k, datatype=FLOAT32, count=1) for k, name in enumerate(FIELDS)]
    step = 4 * len(FIELDS)
    return gz().PointCloudPacked(
        header=head, field=fields, height=1, width=len(points), point_step=step, row_step=step * len(points),
        data=points.tobytes(), is_dense=True,
    )  # fmt: skip
