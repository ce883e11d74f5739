"""Turn the results of a run into ROS 2 messages with topics and times, for recordings and live topics alike.

No middleware is needed here. `ports.bag` writes the messages to an MCAP file, `ports.ros2` sends them.
"""

from __future__ import annotations

import time
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ullage.arrays import Floats
from ullage.data import Detections, Frames, Trajectory, sensors_of, strung
from ullage.geometry import invert
from ullage.grids import Image, OccupancyMap
from ullage.ports import conversions, encode
from ullage.ports.conversions import BODY, WORLD
from ullage.ports.intake import warn
from ullage.ports.protocol import Item, Passed
from ullage.ports.schema import CLOCK, TOPICS, Quality, layout, topic_name
from ullage.processing.detect import detect
from ullage.processing.obstacles import ObstacleSectors
from ullage.world.scene import Scene

ODOM = "odom"
PATH_STEP_M, PATH_POINTS = 0.05, 4000
PATH_POINTS_PER_S = 100
"""The path is published so rarely that it costs no more points a second than this, and at most once a second."""
PRESENT_S = 60.0
"""Stamps nearer to the present than this [s] come from a real clock."""


class Message(NamedTuple):
    """ROS 2 message with its topic and time."""

    t_ns: int
    topic: str  # without the namespace, unless it begins with /
    kind: str  # `package/msg/Name`
    quality: Quality
    data: bytes  # CDR


def on(topic: str, t_ns: int, data: bytes, *, sensor: str = "") -> Message:
    """Return a message on a topic of `TOPICS`, of a radar where it names one."""
    kind, quality, _ = TOPICS[topic]
    return Message(t_ns, topic.replace("NAME", topic_name(sensor)) if sensor else topic, kind, quality, data)


def in_order(message: Message) -> tuple[int, bool]:
    """Sort messages by time, with /clock before the other messages of its time."""
    return message.t_ns, message.topic != "/clock"


def is_present(t_ns: int) -> bool:
    """Return whether a stamp is near the present: such a stream needs no /clock, and no message waits for a stamp."""
    return abs(time.time() - t_ns * 1e-9) < PRESENT_S


class Clock:
    """Make /clock messages: evenly spaced, and at the stamp of each frame.

    The clock steps back only if the stamps step back by more than `STEP_BACK_S`, as when a recording restarts.

    Args:
        wanted: whether to make /clock; None: only if the stamps are not near the present.
        rate_hz: messages a second of stream time besides those of the frames; 40 as in `ros2 bag play --clock`.
    """

    def __init__(self, wanted: bool | None = None, *, rate_hz: float = 40.0) -> None:
        self._wanted, self._step_ns = wanted, round(1e9 / rate_hz)
        self._origin_ns = 0
        self._last_ns: int | None = None

    def until(self, t_ns: int) -> list[Message]:
        """Return the clock messages from the last stamp to this one; none if this stamp is late."""
        if self._wanted is None:
            self._wanted = not is_present(t_ns)
        if not self._wanted:
            return []
        last_ns = self._last_ns
        if last_ns is None or t_ns < last_ns - STEP_BACK_S * 1e9 or t_ns > last_ns + LEAP_S * 1e9:
            times = []
            self._origin_ns = t_ns
        elif t_ns <= last_ns:
            return []
        else:
            first = (last_ns - self._origin_ns) // self._step_ns + 1
            times = list(range(self._origin_ns + first * self._step_ns, t_ns, self._step_ns))
        self._last_ns = t_ns
        times.append(t_ns)
        ticks = layout(CLOCK).fill(np.array(times))
        return [on("/clock", at, data) for at, data in zip(times, ticks, strict=True)]


@dataclass
class MapChanges:
    """Send a plane map in full at intervals, and in between the box of cells that changed."""

    full_ns: int  # full maps at least this often
    last: OccupancyMap | None = None
    sent_ns: int = 0
    wanted: bool = False  # a new subscriber: send the next map in full

    def messages(self, omap: OccupancyMap, t_ns: int) -> Iterator[Message]:
        """Encode the full map or the box of changed cells; nothing if no cell changed."""
        cells, before = conversions.known_percent(omap), self.last
        box = None if before is None or before.grid != omap.grid else changed(conversions.known_percent(before), cells)
        due = t_ns - self.sent_ns >= self.full_ns or t_ns < self.sent_ns or self.wanted
        self.last = omap
        if box is None or due or 2 * (box[1] - box[0]) * (box[3] - box[2]) > cells.size:
            self.sent_ns, self.wanted = t_ns, False
            yield on("map", t_ns, conversions.grid_message(omap, t_ns))
            yield on("map/cells", t_ns, conversions.cells_message(omap, t_ns))
            yield on("map/plane", t_ns, encode.plane_message(omap, t_ns))
            if omap.surfaces:
                yield on("map/surfaces", t_ns, encode.surfaces_message(omap, t_ns))
        elif box[1] > box[0]:
            y0, y1, x0, x1 = box
            yield on("map_updates", t_ns, encode.update_message(t_ns, x0, y0, cells[y0:y1, x0:x1]))


def changed(before: NDArray[np.int8], now: NDArray[np.int8]) -> tuple[int, int, int, int]:
    """Return the first and last rows and columns of the box with all changes; empty if none."""
    differ = before != now
    rows, columns = np.flatnonzero(differ.any(axis=1)), np.flatnonzero(differ.any(axis=0))
    if not rows.size:
        return 0, 0, 0, 0
    return int(rows[0]), int(rows[-1]) + 1, int(columns[0]), int(columns[-1]) + 1


class PathFlown:
    """Thinned path of the body; when it grows too long, every second point is removed."""

    def __init__(self) -> None:
        self._points: list[Trajectory] = []
        self._step_m = PATH_STEP_M
        self._sent_ns: int | None = None

    def add(self, path: Trajectory) -> None:
        """Append the poses flown since the last call."""
        for row in range(len(path)):
            last = self._points[-1] if self._points else None
            if last is not None and path.t_ns[row] <= last.t_ns[0]:  # the clock stepped back: a new flight
                self._points, last, self._step_m = [], None, PATH_STEP_M
            if last is None or np.linalg.norm(path.position[row] - last.position[0]) >= self._step_m:
                self._points.append(path[np.array([row])])  # a copy: a view would keep the whole piece
        if len(self._points) > PATH_POINTS:
            self._points, self._step_m = self._points[::2], 2 * self._step_m

    def messages(self, t_ns: int, *, final: bool = False) -> Iterator[Message]:
        """Encode the path if it is due."""
        wait_s = max(1.0, len(self._points) / PATH_POINTS_PER_S)
        due = self._sent_ns is None or abs(t_ns - self._sent_ns) >= wait_s * 1e9 or final
        if due and t_ns != self._sent_ns and self._points:
            self._sent_ns = t_ns
            yield on("path", t_ns, encode.path_message(strung(self._points)))


class Publisher:
    """Turn items into messages, and keep the state that later items need.

    Frames of reference follow REP-105: map, odom, base_link, then each sensor by its name. map and odom are one, since
    the poses of frames are already estimates in the map.

    Args:
        map_full_s: seconds between whole maps.
        frame_prefix: prefix of the names of all frames of reference but map, for one of several drones.
        profile: also give each profile as a PointCloud2, which viewers show without knowing ullage.
        clock: makes /clock messages with the frames.
        rays: also send the fan of each radar's ray model as lines, once.
    """

    def __init__(
        self, *, map_full_s: float = 10.0, frame_prefix: str = "", profile: bool = True, clock: Clock | None = None,
        rays: bool = False,
    ) -> None:  # fmt: skip
        self._rays = rays
        self._clock = clock or Clock()
        self.map_changes = MapChanges(round(map_full_s * 1e9))
        self._prefix, self._profile = frame_prefix, profile
        self._odom, self._body = frame_prefix + ODOM, frame_prefix + BODY
        self._fixed: dict[tuple[str, str], Floats] = {(WORLD, self._odom): np.eye(4)}
        self._settings: dict[str, tuple[object, ...]] = {}
        self.counts: dict[str, int] = {}  # frames so far by topic of the radar
        self._own_path = False  # the caller gives the body's path
        self._path = PathFlown()
        self._volume: OccupancyMap | None = None
        self._volume_ns: int | None = None
        self._image: Image | None = None  # whose amplitudes were not sent
        self._image_ns: int | None = None
        self._last_ns = 0
        self._waiting: list[Item] = []  # items without a time of their own, until frames come
        self._begun = False

    def messages(self, item: Item) -> list[Message]:
        """Encode frames, detections, a map, an image, the scene, or the body's path, in order of their stamps."""
        if isinstance(item, Passed):
            return [Message(item.t_ns, item.topic, item.kind, "relayed", item.data)]
        if isinstance(item, Frames | Mapping):
            parts = sensors_of(item)
            found = self._of_frames(parts)
            times = np.unique(np.concatenate([part.t_ns for part in parts])).tolist()
            found += [tick for t_ns in times for tick in self._clock.until(t_ns)]
        elif isinstance(item, Trajectory):
            self._own_path = True
            found = self._begin(int(item.t_ns[0])) + list(self._of_body(item))
        elif not self._begun:
            self._waiting.append(item)
            return []
        else:
            found = list(self._of_other(item))
        return sorted(found, key=in_order)

    def finish(self) -> list[Message]:
        """Return, at the end, the messages that still wait for a time, and the final map and path."""
        out = self._begin(self._last_ns)
        changes = self.map_changes
        if changes.last is not None and changes.sent_ns != self._last_ns:
            changes.wanted = True
            out += changes.messages(changes.last, self._last_ns)
        if self._volume is not None and self._volume_ns != self._last_ns:
            out += self._whole_volume(self._volume, self._last_ns)
        if self._image is not None:
            exact = encode.picture_messages(self._image, self._last_ns)[1]
            out.append(on("image/amplitude", self._last_ns, exact))
        return [*out, *self._path.messages(self._last_ns, final=True)]

    def _begin(self, t_ns: int) -> list[Message]:
        """Return the messages that waited for a first stamp."""
        if self._begun:
            return []
        self._last_ns, self._begun = t_ns, True
        early, self._waiting = self._waiting, []
        return [message for item in early for message in self._of_other(item)]

    def _of_frames(self, parts: list[Frames]) -> list[Message]:
        first_ns = min(int(part.t_ns[0]) for part in parts)
        out = list(self._fixed_messages(parts, first_ns))
        out += self._begin(first_ns)
        for part in parts:
            out += self._of_radar(part)
            self._last_ns = max(self._last_ns, int(part.t_ns[-1]))
        for true in (False, True):
            if self._own_path and not true:
                continue
            paths = [(part, part.truth if true else part.poses) for part in parts]
            known = [(part, path) for part, path in paths if path is not None]
            if known and all(np.array_equal(path.t_ns, known[0][1].t_ns) for _, path in known):
                known = known[:1]  # one sensor is enough for the body's pose at each time
            body = merged([body_path(part, path) for part, path in known])
            if body is not None:
                out += self._of_body(body, true=true)
        return out

    def _fixed_messages(self, parts: list[Frames], t_ns: int) -> Iterator[Message]:
        mounts = {(self._body, self._prefix + part.sensor): part.spec.mount.body_from_sensor() for part in parts}
        same = all(key in self._fixed and np.array_equal(self._fixed[key], value) for key, value in mounts.items())
        if self._begun and same:
            return
        self._fixed |= mounts
        yield on("/tf_static", t_ns, encode.fixed_message(t_ns, self._fixed))

    def _of_radar(self, frames: Frames) -> Iterator[Message]:
        topic, frame_id = f"radar/{topic_name(frames.sensor)}", self._prefix + frames.sensor
        yield from self._settings_messages(frames, topic, frame_id)
        start = self.counts.get(topic, 0)
        self.counts[topic] = start + len(frames)
        found = {
            "frame": conversions.frame_messages(frames, start, frame_id=frame_id),
            "range": encode.range_messages(frames, detect(frames), frame_id=frame_id),
        }
        if self._profile:
            found["profile"] = conversions.profile_messages(frames, frame_id=frame_id)
        for name, messages in found.items():
            for t_ns, message in zip(frames.t_ns.tolist(), messages, strict=True):
                yield on(f"radar/NAME/{name}", t_ns, message, sensor=frames.sensor)

    def _settings_messages(self, frames: Frames, topic: str, frame_id: str) -> Iterator[Message]:
        """Encode settings and track of a radar if they are new."""
        known = (frames.spec, frames.unit, frames.calibration, frames.range_m.tobytes())
        before, t_ns = self._settings.get(topic, (None, None)), int(frames.t_ns[0])
        if before[0] != known:
            message = conversions.settings_message(frames, frame_id=frame_id)
            yield on("radar/NAME/settings", t_ns, message, sensor=frames.sensor)
            if self._rays:
                drawn = encode.rays_message(frames, frame_id=frame_id)
                yield on("radar/NAME/rays", t_ns, drawn, sensor=frames.sensor)
        if frames.track is not None and before[1] is not frames.track:
            message = conversions.track_message(frames.track, frames.sensor, t_ns)
            yield on("radar/NAME/track", t_ns, message, sensor=frames.sensor)
        self._settings[topic] = (known, frames.track)

    def _of_body(self, body: Trajectory, *, true: bool = False) -> Iterator[Message]:
        """Encode the body's odometry; for estimated poses also its transforms and path."""
        parent, topic = (WORLD, "truth/odom") if true else (self._odom, "odom")
        for t_ns, message in _timed(body, conversions.odometry_messages(body, parent=parent, child=self._body)):
            yield on(topic, t_ns, message)
        if true:
            return
        for t_ns, message in _timed(body, conversions.transform_messages(self._body, body, parent=self._odom)):
            yield on("/tf", t_ns, message)
        self._path.add(body)
        yield from self._path.messages(int(body.t_ns[-1]))

    def _of_other(self, item: Item) -> Iterator[Message]:
        t_ns = self._last_ns
        if isinstance(item, OccupancyMap) and item.grid.dims == 2:
            yield from self.map_changes.messages(item, t_ns)
        elif isinstance(item, OccupancyMap):
            yield from self._volume_messages(item, t_ns)
        elif isinstance(item, Detections):
            for at, data in conversions.detection_messages(item):
                yield on("radar/NAME/detections", at, data, sensor=item.sensor)
        elif isinstance(item, ObstacleSectors):
            yield on("obstacles", item.t_ns, encode.scan_message(item, frame_id=self._body))
        elif isinstance(item, Scene):
            yield on("world", t_ns, encode.scene_message(item, t_ns))
        elif isinstance(item, Image):
            yield from self._image_messages(item, t_ns)

    def _image_messages(self, image: Image, t_ns: int) -> Iterator[Message]:
        """Encode the picture, and as often as full maps the amplitudes, which take four times the space."""
        grey, exact = encode.picture_messages(image, t_ns)
        yield on("image", t_ns, grey)
        self._image = image
        if self._image_ns is None or abs(t_ns - self._image_ns) >= self.map_changes.full_ns:
            self._image, self._image_ns = None, t_ns
            yield on("image/amplitude", t_ns, exact)

    def _volume_messages(self, omap: OccupancyMap, t_ns: int) -> Iterator[Message]:
        """Encode a volume's occupied cells, and as often as full maps the lossless cells, cubes and surfaces."""
        self._volume = omap
        if self._volume_ns is None or abs(t_ns - self._volume_ns) >= self.map_changes.full_ns:
            yield from self._whole_volume(omap, t_ns)
        else:
            yield on("map/occupied", t_ns, encode.occupied_message(omap, t_ns))

    def _whole_volume(self, omap: OccupancyMap, t_ns: int) -> Iterator[Message]:
        self._volume_ns = t_ns
        yield on("map/occupied", t_ns, encode.occupied_message(omap, t_ns))
        yield on("map/cubes", t_ns, encode.cubes_message(omap, t_ns))
        yield on("map/cells", t_ns, conversions.cells_message(omap, t_ns))
        if omap.surfaces:
            yield on("map/surfaces", t_ns, encode.surfaces_message(omap, t_ns))


def body_path(frames: Frames, path: Trajectory) -> Trajectory:
    """Return the body's path from the path of a sensor on it."""
    return path.mounted(invert(frames.spec.mount.body_from_sensor()))


def merged(paths: list[Trajectory]) -> Trajectory | None:
    """Merge paths of one body by several sensors; each time appears once."""
    if len(paths) < 2 or all(np.array_equal(path.t_ns, paths[0].t_ns) for path in paths):
        return paths[0] if paths else None
    t_ns, row = np.unique(np.concatenate([path.t_ns for path in paths]), return_index=True)
    columns = np.concatenate([conversions.state_columns(path) for path in paths])[row]
    return conversions.path_of(t_ns, columns)


def _timed(path: Trajectory, messages: list[bytes]) -> Iterator[tuple[int, bytes]]:
    return zip(path.t_ns.tolist(), messages, strict=True)


def shifted(frames: Frames, by_ns: int) -> Frames:
    """Return the same frames at other times."""
    if not by_ns:
        return frames
    t_ns = frames.t_ns + by_ns
    poses, truth = (None if p is None else replace(p, t_ns=t_ns) for p in (frames.poses, frames.truth))
    return replace(frames, t_ns=t_ns, poses=poses, truth=truth)


LATE_S = 1.0
"""Beyond this delay [s] the limiter starts anew and does not catch up."""
LEAP_S = 10.0
"""The limiter does not wait for a gap longer than this [s of stream]."""
STEP_BACK_S = 1.0
"""A stamp older than the newest by more than this [s] is a step of the clock; otherwise the message is late."""


class RateLimiter:
    """Compute when each stamp is due on this machine's clock.

    Args:
        rate: seconds of stream a second; 0: at once.
    """

    def __init__(self, rate: float) -> None:
        self._rate = rate
        self._anchor: tuple[int, float] | None = None  # a stamp, and when it was due
        self._newest_ns = 0
        self.late_s = 0.0
        """Delay of the last stamp against the schedule before the limiter started anew [s]."""

    def due_s(self, t_ns: int, now_s: float) -> float:
        """Return when a stamp is due [s, monotonic].

        The limiter starts anew after a step back, after a long delay, and after stamps leap far ahead. Stamps leap when
        a clock is set or when recordings are joined; a leap is reported. A late message is due at once and does not
        change the schedule.
        """
        self.late_s = 0.0
        if not self._rate:
            return now_s
        if self._anchor is not None:
            ahead_s = (t_ns - self._newest_ns) * 1e-9
            due = self._anchor[1] + (t_ns - self._anchor[0]) * 1e-9 / self._rate
            if -STEP_BACK_S <= ahead_s < 0:
                return min(due, now_s)
            if ahead_s > LEAP_S:
                warn(f"the stamps leap {ahead_s:.3g} s ahead, which is not waited for")
            elif ahead_s >= 0:
                self.late_s = max(0.0, now_s - due)
                if self.late_s <= LATE_S:
                    self._newest_ns = t_ns
                    return due
        self._anchor, self._newest_ns = (t_ns, now_s), t_ns
        return now_s

    def wait(self, t_ns: int) -> None:
        """Sleep until a stamp is due."""
        now = time.monotonic()
        time.sleep(max(0.0, self.due_s(t_ns, now) - now))
