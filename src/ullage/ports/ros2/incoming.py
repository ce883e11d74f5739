"""Frames from messages and poses from transforms, brought together: made without any middleware."""

from __future__ import annotations

import time
import warnings
from collections import Counter, deque
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from ullage.data import Floats, Frames, Trajectory, joined
from ullage.errors import InputError
from ullage.geometry import C0, matrix_quat
from ullage.ports import conversions
from ullage.ports import messages as ros
from ullage.ports.encode import RANGE, range_layout
from ullage.ports.ros2.options import SourceOptions
from ullage.ports.ros2.transforms import Answer, Transforms
from ullage.specs import RadarSpec

JUMP_NS = 1_000_000_000
SETTINGS_S = 2.0
"""How long frames wait for their radar's settings [s]."""


@dataclass
class Radar:
    """What is known of one radar, and its frames that wait."""

    sensor: str
    fields: dict[str, Any] = field(default_factory=dict)  # of Frames, once known
    frame_id: str = ""
    raw: deque[tuple[float, bytes]] = field(default_factory=deque)  # when it came [s], a frame without settings
    waiting: deque[tuple[float, Frames]] = field(default_factory=deque)  # when it came [s], a frame without pose
    heard_ns: int | None = None  # the newest stamp
    given_ns: int = 0  # the last time given
    offset_ns: int = 0  # from stamp to time given, which rises also where the clock jumped back
    last: tuple[int, Floats] | None = None  # stamp and pose given last, for the speed of the next


class Incoming:
    """Takes messages as they come and gives frames whose poses are known.

    Args:
        options: where poses come from, and how long to wait for them.
        say: told what a person should know.
    """

    def __init__(self, options: SourceOptions, say: Callable[[str], None]) -> None:
        self._options, self._say = options, say
        self.transforms = Transforms()
        self.count: Counter[str] = Counter()
        self.waits_for = ""
        self._radars: dict[str, Radar] = {}
        self._spec = RadarSpec.preset(options.radar)
        self._joined_to: set[str] = set()

    @property
    def sensors(self) -> tuple[str, ...]:
        """Names of the radars heard so far."""
        return tuple(radar.sensor for radar in self._radars.values())

    def _radar(self, topic: str) -> Radar:
        """The radar whose topics begin so."""
        base = topic.rpartition("/")[0]
        return self._radars.setdefault(base, Radar(base.rpartition("/")[2] or "radar"))

    def take_settings(self, topic: str, data: bytes) -> None:
        """RadarSettings."""
        radar = self._radar(topic)
        radar.sensor, radar.fields = conversions.text_in(data, 1), conversions.settings_of(data)

    def take_frame(self, topic: str, data: bytes) -> None:
        """RadarFrame."""
        radar = self._radar(topic)
        radar.sensor = conversions.text_in(data, 1)
        radar.raw.append((time.monotonic(), data))

    def take_profile(self, topic: str, data: bytes) -> None:
        """PointCloud2 of a profile: distance from the sensor, and intensity.

        It has no phase, so it is taken as a baseband of phase zero: ranges and maps are right, images are not.
        """
        note = ros.from_bytes(ros.CLOUD, data)
        points = cloud_points(note)
        distance = np.sqrt(sum(points[axis].astype(float) ** 2 for axis in "xyz"))
        range_m, first = np.unique(distance, return_index=True)
        self._profile(topic, note.header, range_m, points["intensity"][first])

    def take_range(self, topic: str, data: bytes) -> None:
        """Range: one echo of the radar's own pulse there, or none."""
        short = range_layout(conversions.text_in(data, 0).encode()).dtype.itemsize - len(data)
        note = ros.from_bytes(RANGE, data + bytes(4 if 0 < short <= 4 else 0))  # ROS 1 and Humble know no variance
        bins = np.arange(max(int(note.max_range / self._spec.bin_m) + 8, 16))
        range_m: Floats = np.asarray(self._spec.bin_m * bins, np.float64)
        width = C0 / 2 * self._spec.pulse_sigma_s
        away = (range_m - note.range) / width if np.isfinite(note.range) else np.full(len(range_m), np.inf)
        self._profile(topic, note.header, range_m, np.exp(-(away**2) / 2))

    def _profile(self, topic: str, header: Any, range_m: Floats, level: Any) -> None:
        if len(range_m) < 8 or not np.isfinite(range_m).all():
            raise InputError(f"a profile of {len(range_m)} ranges", where=topic, allowed="8 or more, all finite")
        radar = self._radar(topic)
        known = radar.fields.get("range_m")
        if known is None or len(known) != len(range_m) or not np.allclose(known, range_m, atol=1e-4):
            spec = self._spec.but(bins=len(range_m), range_start_m=float(np.clip(range_m[0], -1, 1000)))
            radar.fields = {"spec": spec, "range_m": range_m, "unit": "normalised"}
        t_ns = stamp_ns(header)
        made = Frames(np.asarray(level, np.complex64)[None], t_ns=np.array([t_ns]), sensor=radar.sensor, **radar.fields)
        self._queue(radar, header.frame_id, made, time.monotonic())

    def take_transforms(self, data: bytes, *, fixed: bool = False) -> None:
        """TFMessage."""
        for note in ros.from_bytes(ros.TRANSFORMS, data).transforms:
            at, turn = note.transform.translation, note.transform.rotation
            self._place(note.header, note.child_frame_id, at, turn, fixed=fixed)

    def take_odometry(self, data: bytes) -> None:
        """Odometry."""
        note = ros.from_bytes(ros.ODOMETRY, data)
        pose = note.pose.pose
        self._place(note.header, note.child_frame_id or self._options.body, pose.position, pose.orientation)

    def take_pose(self, data: bytes) -> None:
        """PoseStamped of the body."""
        note = ros.from_bytes("geometry_msgs/msg/PoseStamped", data)
        self._place(note.header, self._options.body, note.pose.position, note.pose.orientation)

    def _place(self, header: Any, child: str, at: Any, turn: Any, *, fixed: bool = False) -> None:
        position, quat = np.array([at.x, at.y, at.z]), np.array([turn.x, turn.y, turn.z, turn.w])
        norm = float(np.linalg.norm(quat))
        if not (np.isfinite(position).all() and abs(norm - 1) < 0.1):
            self.count["poses that are none"] += 1
            return
        parent = (header.frame_id or self._options.map).lstrip("/")
        jumped = self.transforms.add(parent, child.lstrip("/"), stamp_ns(header), position, quat / norm, fixed=fixed)
        self.count["jumps of the poses' clock"] += jumped

    def _understand(self, radar: Radar, now_s: float) -> None:
        """Frames of the messages whose settings are known, or were waited for long enough."""
        while radar.raw and (radar.fields or now_s - radar.raw[0][0] > SETTINGS_S):
            came_s, data = radar.raw.popleft()
            with warnings.catch_warnings(record=True) as caught:
                warnings.simplefilter("always")
                made = conversions.frames_of([data], radar.sensor, radar.fields, conversions.times_in([data]))
            for note in caught:
                self._say(str(note.message))
            radar.fields = {"spec": made.spec, "range_m": made.range_m, "unit": made.unit} | radar.fields
            self._queue(radar, conversions.text_in(data, 0), replace(made, truth=None), came_s)

    def _queue(self, radar: Radar, frame_id: str, made: Frames, came_s: float) -> None:
        self.count["frames"] += 1
        t_ns, before = int(made.t_ns[0]), radar.heard_ns
        if before is not None and before - JUMP_NS < t_ns <= before:
            self.count["frames out of order"] += 1
            return
        if before is not None and t_ns < before:
            self._say(f"{radar.sensor}: time jumped back {(before - t_ns) * 1e-9:.3g} s: starting anew")
            radar.waiting.clear()
            radar.last = None
            radar.offset_ns = radar.given_ns + round(1e9 / made.spec.fps) - t_ns
        radar.frame_id, radar.heard_ns = frame_id.lstrip("/"), t_ns
        radar.waiting.append((came_s, made))

    def ready(self, most: int = 64) -> dict[str, Frames]:
        """Frames of each radar, at most so many, whose poses are known by now."""
        now_s, out = time.monotonic(), {}
        self.waits_for = ""
        for radar in self._radars.values():
            self._understand(radar, now_s)
            if frames := self._placed(radar, now_s, most):
                out[radar.sensor] = frames
        return out

    def _placed(self, radar: Radar, now_s: float, most: int) -> Frames | None:
        found: list[tuple[Frames, Floats | None]] = []
        while radar.waiting and len(found) < most:
            came_s, made = radar.waiting[0]
            if found and not alike(found[0][0], made):
                break
            answer = self._where(radar, made)
            if answer.status != "ok":
                late = now_s - came_s > self._options.patience_s
                if answer.status != "lost" and not late:
                    self.waits_for = answer.what
                    break
                self.count["frames without pose"] += 1
                self._say(f"{radar.sensor}: no pose for its frames ({answer.what}); they are left out")
                radar.waiting.popleft()
                continue
            radar.waiting.popleft()
            found.append((made, answer.matrix))
        return self._together(radar, found) if found else None

    def _where(self, radar: Radar, made: Frames) -> Answer:
        """World from sensor at a frame's time; no matrix where the message holds the pose, or none is wanted."""
        wanted = self._options.poses
        if wanted in ("none", "message") or (wanted == "auto" and made.poses is not None):
            return Answer("ok")
        name = radar.frame_id if self.transforms.knows(radar.frame_id) else self._options.body
        root, target = self.transforms.root(name), self._options.map
        if root != target and self.transforms.knows(name) and root not in self._joined_to:
            self._joined_to.add(root)
            self._say(f"{name} hangs on {root}, not on {target}; {root} is taken for the world until that changes")
        answer = self.transforms.at(target if root == target else root, name, int(made.t_ns[0]))
        if not self.transforms.knows(name):
            return Answer("unknown", what=f"nothing tells where {radar.frame_id or 'the radar'} or {name} is")
        if answer.matrix is None or name == radar.frame_id:
            return answer
        return Answer("ok", answer.matrix @ made.spec.mount.body_from_sensor())

    def _together(self, radar: Radar, found: list[tuple[Frames, Floats | None]]) -> Frames:
        parts = [made for made, _ in found]
        stamps = np.concatenate([part.t_ns for part in parts])
        frames = joined([part if matrix is None else replace(part, poses=None) for part, matrix in found])
        if self._options.poses == "none":
            frames = replace(frames, poses=None)
        elif found[0][1] is not None:
            frames = replace(frames, poses=self._path(radar, stamps, [matrix for _, matrix in found]))
        self.count["frames given"] += len(parts)
        t_ns = stamps + radar.offset_ns
        radar.given_ns = int(t_ns[-1])
        poses = None if frames.poses is None else replace(frames.poses, t_ns=t_ns)
        return replace(frames, t_ns=t_ns, poses=poses, sensor=radar.sensor)

    def _path(self, radar: Radar, stamps: Any, matrices: list[Floats | None]) -> Trajectory:
        """Poses with their speeds, which follow from the one before as well."""
        known = [matrix for matrix in matrices if matrix is not None]
        before = radar.last is not None and radar.last[0] < stamps[0]
        times = np.concatenate([[radar.last[0]], stamps]) if before and radar.last else stamps
        stack = np.stack([radar.last[1], *known] if before and radar.last else known)
        radar.last = (int(stamps[-1]), known[-1])
        path = Trajectory(times, stack[:, :3, 3], matrix_quat(stack[:, :3, :3]))
        return path[int(before) :]


def alike(a: Frames, b: Frames) -> bool:
    """Whether two frames can stand in one Frames."""
    return (
        a.spec == b.spec
        and a.samples.shape[1] == b.samples.shape[1]
        and (a.poses is None) == (b.poses is None)
        and np.array_equal(a.range_m, b.range_m)
    )


def stamp_ns(header: Any) -> int:
    """The time of a header [ns]."""
    return int(header.stamp.sec) * 1_000_000_000 + int(header.stamp.nanosec)


CODES = {1: "i1", 2: "u1", 3: "i2", 4: "u2", 5: "i4", 6: "u4", 7: "f4", 8: "f8"}


def cloud_points(note: Any) -> np.ndarray:
    """The points of a PointCloud2 with x, y, z and intensity.

    Raises:
        InputError: a field is missing.
    """
    order = ">" if note.is_bigendian else "<"
    fields = {f.name: (f.offset, order + CODES[f.datatype]) for f in note.fields if f.datatype in CODES}
    if missing := [name for name in ("x", "y", "z", "intensity") if name not in fields]:
        raise InputError(f"a PointCloud2 without {missing[0]}", where="profile", allowed="x, y, z and intensity")
    dtype = np.dtype({
        "names": list(fields), "offsets": [at for at, _ in fields.values()],
        "formats": [kind for _, kind in fields.values()], "itemsize": note.point_step,
    })  # fmt: skip
    rows = np.asarray(note.data, np.uint8).reshape(note.height, note.row_step)[:, : note.width * note.point_step]
    return np.ascontiguousarray(rows).reshape(-1).view(dtype)
