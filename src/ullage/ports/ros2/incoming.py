"""Combine frames from messages with poses from the tree of transforms, without middleware."""

from __future__ import annotations

import time
import warnings
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from functools import partial
from itertools import islice
from typing import Any

import numpy as np

from ullage.arrays import Floats
from ullage.data import Frames, Trajectory, joined
from ullage.errors import InputError
from ullage.geometry import C0, matrix_quat, quat_matrix
from ullage.ports import conversions
from ullage.ports import schema as ros
from ullage.ports.conversions import CODES, PLACING, Placement, stamp_ns
from ullage.ports.intake import (
    LATE_NS,
    Clock,
    Counters,
    Log,
    Once,
    Place,
    PoseQueue,
    Stamped,
    Stream,
    checked_pose,
    echo_range,
)
from ullage.ports.pose_events import PoseTrack, TimedPose, path_through
from ullage.ports.publisher import shifted
from ullage.ports.ros2.options import SourceOptions
from ullage.specs import RadarSpec

SETTINGS_S = 2.0
"""How long frames wait for their radar's settings [s]."""
MOST_WAITING = 4096
"""Frames of one radar that wait for settings or poses."""
MOST_FRAMES_OF_REFERENCE = 256
"""Moving frames of reference that are followed."""


@dataclass
class Radar:
    """Settings of one radar, and its frames that wait."""

    sensor: str
    stream: Stream[bytes | Frames]
    queue: PoseQueue[Stamped[Frames]]
    fields: dict[str, Any] = field(default_factory=dict)  # of Frames, once known
    frame_id: str = ""
    index: int | None = None  # of the last RadarFrame
    raw: deque[tuple[float, Stamped[Any]]] = field(default_factory=deque)  # time of arrival [s], RadarFrame
    placed: deque[tuple[Stamped[Frames], Floats | None]] = field(default_factory=deque)
    last: tuple[int, TimedPose] | None = None  # last track and pose, for the velocity of the next


class Incoming:
    """Collect messages and give frames with known poses; `intake` decides what happens to the others.

    Args:
        options: where poses come from, and how long to wait for them.
        log: receives one line for the user.
        now: returns the time that limits how long frames wait [s].
    """

    def __init__(self, options: SourceOptions, log: Log, *, now: Callable[[], float] = time.monotonic) -> None:
        self._options, self._log, self._now = options, log, now
        self.transforms = Transforms()
        self.counters = Counters(log)
        self._clock = Clock(self.counters)
        self.waits_for = ""
        self._radars: dict[str, Radar] = {}
        self._moving: dict[str, Stream[tuple[str, Floats, Floats]]] = {}  # poses by their frame of reference
        self._spec = RadarSpec.preset(options.radar)
        self._once = Once(log)
        self._body = options.frame_prefix + options.body

    @property
    def sensors(self) -> tuple[str, ...]:
        """Names of the radars found so far."""
        return tuple(radar.sensor for radar in self._radars.values())

    def take(self, topic: str, take: Callable[..., None], *what: Any) -> None:
        """Pass a message to a method of this class; count and drop a message that cannot be read.

        Args:
            topic: of the message.
            take: the method.
            *what: its arguments.
        """
        with self.counters.reading(topic):
            take(*what)

    def taker(self, topic: str, kind: str, *, fixed: bool = False) -> Callable[[bytes], None]:
        """Return the method that takes the messages of a topic; `fixed`: its transforms hold for ever.

        Raises:
            InputError: messages of this kind hold neither frames nor poses.
        """
        takers = {
            ros.FRAME: self.take_frame, ros.SETTINGS: self.take_settings, ros.CLOUD: self.take_profile,
            ros.RANGE: self.take_range,
        }  # fmt: skip
        if kind in takers:
            return partial(takers[kind], topic)
        if kind in PLACING:
            return partial(self.take_poses, kind, fixed=fixed)
        raise InputError(f"{topic} carries {kind}", where="topics", allowed=", ".join([*takers, *PLACING]))

    def _radar(self, topic: str) -> Radar:
        """Return the radar whose topics begin with this prefix."""
        base = topic.rpartition("/")[0]
        if base not in self._radars:
            queue: PoseQueue[Stamped[Frames]] = PoseQueue(
                self.counters, base, patience_s=self._options.patience_s, most=MOST_WAITING
            )
            self._radars[base] = Radar(base.rpartition("/")[2] or "radar", self._clock.stream(base), queue)
        return self._radars[base]

    def take_settings(self, topic: str, data: bytes) -> None:
        """Take a RadarSettings message."""
        radar = self._radar(topic)
        radar.sensor, radar.fields = conversions.text_in(data, 1), conversions.settings_of(data)

    def take_frame(self, topic: str, data: bytes) -> None:
        """Take a RadarFrame message."""
        sensor, index = conversions.text_in(data, 1), conversions.index_in(data)
        radar = self._radar(topic)
        radar.sensor = sensor
        if radar.index is not None and index > radar.index + 1:
            self.counters.drop(radar.stream.topic, "lost", "numbers of its frames are missing",
                               count=index - radar.index - 1)  # fmt: skip
        radar.index = index
        self._stamp(radar, conversions.time_in(data), data)

    def _stamp(self, radar: Radar, t_ns: int, what: bytes | Frames) -> None:
        """Give a message its time; it then waits for settings or for its pose."""
        self.counters.receive(radar.stream.topic)
        for found in radar.stream.take(t_ns, what):
            if isinstance(found.item, Frames):
                self._queue(radar, found, found.item, self._now())
            else:
                radar.raw.append((self._now(), found))
        if len(radar.raw) > MOST_WAITING:
            radar.raw.popleft()
            self.counters.drop(radar.stream.topic, "lost", "no settings came")

    def take_profile(self, topic: str, data: bytes) -> None:
        """Take a profile as PointCloud2: distance from the sensor, and intensity.

        A profile has no phase, so it becomes a baseband of phase zero: ranges and maps are right, images are not.
        """
        message = ros.from_bytes(ros.CLOUD, data)
        points = cloud_points(message)
        distance = np.sqrt(sum(points[axis].astype(float) ** 2 for axis in "xyz"))
        range_m, first = np.unique(distance, return_index=True)
        self._profile(topic, message.header, range_m, points["intensity"][first])

    def take_range(self, topic: str, data: bytes) -> None:
        """Take a Range message: one echo of the radar's own pulse at that range, or none."""
        short = ros.layout(ros.RANGE, conversions.text_in(data, 0).encode()).dtype.itemsize - len(data)
        # ROS 1 and Humble have no variance
        message = ros.from_bytes(ros.RANGE, data + bytes(4 if 0 < short <= 4 else 0))
        bins = np.arange(max(int(message.max_range / self._spec.bin_m) + 8, 16))
        range_m: Floats = np.asarray(self._spec.bin_m * bins, np.float64)
        width = C0 / 2 * self._spec.pulse_sigma_s
        away = (range_m - echo_range(message.range, message.min_range, message.max_range)) / width
        self._profile(topic, message.header, range_m, np.exp(-(away**2) / 2))

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
        radar.frame_id = header.frame_id.lstrip("/")
        self._stamp(radar, t_ns, made)

    def take_poses(self, kind: str, data: bytes, *, fixed: bool = False) -> None:
        """Take the poses in a message of one of `PLACING`; a pose that names no frame of reference is the body's."""
        for found in conversions.placements_in(kind, data):
            child = found.child if kind == ros.TRANSFORMS else found.child or self._body
            self._place(child.lstrip("/"), found, fixed=fixed)

    def _place(self, child: str, found: Placement, *, fixed: bool) -> None:
        parent = (found.parent or self._options.map).lstrip("/")
        pose = checked_pose(found.position, found.quat_xyzw)
        if isinstance(pose, str):
            self.counters.drop(f"pose of {child}", "bad", pose)
        elif fixed:
            self.transforms.add(parent, child, found.t_ns, *pose, fixed=True)
        else:
            self._move(child, found.t_ns, (parent, *pose))

    def _move(self, child: str, t_ns: int, placed: tuple[str, Floats, Floats]) -> None:
        """Take the pose of a moving frame of reference."""
        stream = self._moving.get(child)
        if stream is None:
            if len(self._moving) >= MOST_FRAMES_OF_REFERENCE:
                self.counters.drop("/tf", "lost", f"more than {MOST_FRAMES_OF_REFERENCE} frames of reference")
                return
            stream = self._moving[child] = self._clock.stream(f"pose of {child}")
        if t_ns == stream.last_ns:
            return  # published once more
        if stream.last_ns is not None and 0 < stream.last_ns - t_ns < LATE_NS:
            self.transforms.add(placed[0], child, t_ns, *placed[1:])  # a late pose still helps between two others
            return
        for found in stream.take(t_ns, placed):
            if found.starts:
                self.transforms.forget(child)
            parent, position, quat = found.item
            self.transforms.add(parent, child, found.stamp_ns, position, quat)

    def _understand(self, radar: Radar, now_s: float) -> None:
        """Decode the messages whose settings are known or have not come in time."""
        while radar.raw and (radar.fields or now_s - radar.raw[0][0] > SETTINGS_S):
            came_s, stamped = radar.raw.popleft()
            self.take(radar.stream.topic, self._understand_one, radar, came_s, stamped)

    def _understand_one(self, radar: Radar, came_s: float, stamped: Stamped[Any]) -> None:
        data = stamped.item
        with warnings.catch_warnings(record=True) as caught:
            warnings.simplefilter("always")
            (made,) = conversions.frames_of([data], radar.sensor, radar.fields, conversions.times_in([data]))
        for warning in caught:
            self._log(str(warning.message))
        radar.fields = {"spec": made.spec, "range_m": made.range_m, "unit": made.unit} | radar.fields
        radar.frame_id = conversions.text_in(data, 0).lstrip("/")
        self._queue(radar, stamped, replace(made, truth=None), came_s)

    def _queue(self, radar: Radar, stamped: Stamped[Any], made: Frames, came_s: float) -> None:
        on_our_clock = shifted(made, stamped.t_ns - stamped.stamp_ns)
        radar.queue.put(stamped._replace(item=on_our_clock), came_s)

    def finish(self) -> None:
        """Count waiting messages as dropped, at the end of the stream."""
        for radar in self._radars.values():
            radar.stream.finish()
            radar.queue.clear()

    def ready(self, most: int = 64) -> dict[str, Frames]:
        """Return the frames of each radar whose poses are known, at most `most` each."""
        now_s, out = self._now(), {}
        for radar in self._radars.values():
            self._understand(radar, now_s)
            place = partial(self._where, radar)
            room = most - len(radar.placed)
            radar.placed.extend(islice(radar.queue.ready(place, now_s), max(room, 0)))
            if frames := self._placed(radar, most):
                out[radar.sensor] = frames
        self.waits_for = next((radar.queue.waits_for for radar in self._radars.values() if radar.queue.waits_for), "")
        return out

    def _placed(self, radar: Radar, most: int) -> Frames | None:
        """Return the next frames that fit in one Frames."""
        found: list[tuple[Stamped[Frames], Floats | None]] = []
        while radar.placed and len(found) < most:
            stamped, _ = radar.placed[0]
            if found and not (alike(found[0][0].item, stamped.item) and found[0][0].track == stamped.track):
                break
            found.append(radar.placed.popleft())
        return self._together(radar, found) if found else None

    def _where(self, radar: Radar, stamped: Stamped[Frames]) -> Place[Floats]:
        """Find world_from_sensor at a frame's time; no matrix if the message has the pose, or if none is wanted."""
        wanted, made = self._options.poses, stamped.item
        if wanted in ("none", "message") or (wanted == "auto" and made.poses is not None):
            return Place("known")
        name = radar.frame_id if self.transforms.knows(radar.frame_id) else self._body
        if not self.transforms.knows(name):
            return Place("wait", missing=f"nothing tells where {radar.frame_id or 'the radar'} or {name} is")
        root, target = self.transforms.above(name)[-1], self._options.map
        if root != target:
            if not self.transforms.moves(name):
                return Place("wait", missing=f"nothing tells where {root} is")
            text = f"{name} hangs on {root}, not on {target}; {root} is taken for the world until that changes"
            self._once(text, kind=root)
        answer = self.transforms.at(root if root != target else target, name, stamped.stamp_ns)
        if answer.pose is None or name == radar.frame_id:
            return answer
        return Place("known", answer.pose @ made.spec.mount.body_from_sensor())

    def _together(self, radar: Radar, found: list[tuple[Stamped[Frames], Floats | None]]) -> Frames:
        parts = [stamped.item for stamped, _ in found]
        frames = joined([part if matrix is None else replace(part, poses=None)
                         for part, (_, matrix) in zip(parts, found, strict=True)])  # fmt: skip
        if self._options.poses == "none":
            frames = replace(frames, poses=None)
        elif found[0][1] is not None:
            frames = replace(frames, poses=self._path(radar, found))
        return replace(frames, sensor=radar.sensor)

    def _path(self, radar: Radar, found: list[tuple[Stamped[Frames], Floats | None]]) -> Trajectory:
        """Return poses with velocities; the previous pose counts as well, unless a track begins."""
        stack, track = np.stack([matrix for _, matrix in found if matrix is not None]), found[0][0].track
        times = [stamped.t_ns for stamped, _ in found]
        poses = list(zip(times, stack[:, :3, 3], matrix_quat(stack[:, :3, :3]), strict=True))
        before = radar.last[1] if radar.last is not None and radar.last[0] == track else None
        radar.last = track, poses[-1]
        return path_through(before, poses)


def alike(a: Frames, b: Frames) -> bool:
    """Return whether two frames fit in one Frames."""
    return (
        a.spec == b.spec
        and a.samples.shape[1] == b.samples.shape[1]
        and (a.poses is None) == (b.poses is None)
        and np.array_equal(a.range_m, b.range_m)
    )


FORMS = {code: np.dtype(name).str[1:] for name, code in CODES.items()}
"""numpy's types of the numbers of a PointField, without their order of bytes."""


def cloud_points(message: Any) -> np.ndarray:
    """Read the points of a PointCloud2 with x, y, z and intensity.

    Raises:
        InputError: a field is missing.
    """
    order = ">" if message.is_bigendian else "<"
    fields = {f.name: (f.offset, order + FORMS[f.datatype]) for f in message.fields if f.datatype in FORMS}
    if missing := [name for name in ("x", "y", "z", "intensity") if name not in fields]:
        raise InputError(f"a PointCloud2 without {missing[0]}", where="profile", allowed="x, y, z and intensity")
    dtype = np.dtype({
        "names": list(fields), "offsets": [at for at, _ in fields.values()],
        "formats": [kind for _, kind in fields.values()], "itemsize": message.point_step,
    })  # fmt: skip
    rows = np.asarray(message.data, np.uint8).reshape(message.height, message.row_step)[
        :, : message.width * message.point_step
    ]
    return np.ascontiguousarray(rows).reshape(-1).view(dtype)


@dataclass(frozen=True, slots=True)
class Edge:
    """Poses of a frame in its parent."""

    parent: str
    track: PoseTrack


class Transforms:
    """Tree of frames of reference."""

    def __init__(self) -> None:
        self._edges: dict[str, Edge] = {}

    def add(
        self, parent: str, child: str, t_ns: int, position: Floats, quat_xyzw: Floats, *, fixed: bool = False
    ) -> bool:
        """Add one transform, parent from child; return whether its clock stepped back."""
        edge = self._edges.get(child)
        if edge is None or edge.parent != parent or edge.track.fixed != fixed:
            edge = self._edges[child] = Edge(parent, PoseTrack(fixed=fixed))
        return edge.track.add(t_ns, position, quat_xyzw)

    def forget(self, child: str) -> None:
        """Drop the poses of a frame, for example after a step of its clock."""
        self._edges.pop(child, None)

    def above(self, name: str) -> list[str]:
        """Return a frame and those that it descends from, up to the root of its tree."""
        out = [name]
        while name in self._edges and self._edges[name].parent not in out:
            name = self._edges[name].parent
            out.append(name)
        return out

    def moves(self, name: str) -> bool:
        """Return whether any transform between a frame and its root is not fixed."""
        return any(not self._edges[one].track.fixed for one in self.above(name) if one in self._edges)

    def knows(self, name: str) -> bool:
        """Return whether a frame descends from another."""
        return name in self._edges

    def at(self, target: str, source: str, t_ns: int) -> Place[Floats]:
        """Find target_from_source (4, 4) at a time, for a target above the source in the tree."""
        out, waits, chain = np.eye(4), "", self.above(source)
        for name in chain[: chain.index(target)] if target in chain else chain:
            edge = self._edges.get(name)
            if edge is None or (name == chain[-1] != target):
                return Place("wait", missing=f"{name} is not joined to {target}")
            found, link = edge.track.at(t_ns), f"{edge.parent} to {name}"
            if found.status == "never":
                return Place("never", missing=link)
            if found.pose is None:
                waits = link
            else:
                matrix = np.eye(4)
                matrix[:3, 3], matrix[:3, :3] = found.pose[0], quat_matrix(found.pose[1])
                out = matrix @ out
        return Place("wait", missing=waits) if waits else Place("known", out)
