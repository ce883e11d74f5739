"""What flows, as ROS 2 messages with their topics: made without any middleware, so a test needs none."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from typing import Literal, NamedTuple

import numpy as np
from numpy.typing import NDArray

from ullage.data import Detections, Floats, Frames, Trajectory, sensors_of, strung
from ullage.geometry import invert
from ullage.grids import Image, OccupancyMap
from ullage.ports import conversions
from ullage.ports import messages as ros
from ullage.ports.conversions import BODY, WORLD
from ullage.ports.messages import topic_name
from ullage.ports.protocol import Item, Passed
from ullage.ports.ros2 import encode
from ullage.world.scene import Scene

ODOM = "odom"
Quality = Literal["sensor", "stream", "transforms", "latched", "relayed"]
"""How a topic is sent: best effort; reliable; reliable and deep; reliable and kept for those who come late; deeper."""
PATH_STEP_M, PATH_POINTS = 0.05, 4000


class Note(NamedTuple):
    """One message."""

    t_ns: int
    topic: str
    kind: str
    quality: Quality
    data: bytes


@dataclass
class Changes:
    """Tells what of a map is new, so that whole maps go out seldom."""

    full_ns: int  # whole maps at least this often
    last: OccupancyMap | None = None
    sent_ns: int = 0
    wanted: bool = False  # somebody new listens: the next is whole

    def notes(self, omap: OccupancyMap, t_ns: int) -> Iterator[Note]:
        """The map whole, or the box of what changed; nothing where nothing did."""
        cells, before = encode.known_percent(omap), self.last
        box = None if before is None or before.grid != omap.grid else changed(encode.known_percent(before), cells)
        due = t_ns - self.sent_ns >= self.full_ns or t_ns < self.sent_ns or self.wanted
        self.last = omap
        if box is None or due or 2 * (box[1] - box[0]) * (box[3] - box[2]) > cells.size:
            self.sent_ns, self.wanted = t_ns, False
            yield Note(t_ns, "map", ros.GRID, "latched", conversions.grid_note(omap, t_ns))
        elif box[1] > box[0]:
            y0, y1, x0, x1 = box
            yield Note(t_ns, "map_updates", ros.UPDATE, "stream", encode.update_note(t_ns, x0, y0, cells[y0:y1, x0:x1]))


def changed(before: NDArray[np.int8], now: NDArray[np.int8]) -> tuple[int, int, int, int]:
    """Rows from and to, columns from and to, that hold all differences; empty where there are none."""
    differ = before != now
    rows, columns = np.flatnonzero(differ.any(axis=1)), np.flatnonzero(differ.any(axis=0))
    if not rows.size:
        return 0, 0, 0, 0
    return int(rows[0]), int(rows[-1]) + 1, int(columns[0]), int(columns[-1]) + 1


class Outgoing:
    """Turns items into messages, and remembers what the next ones need.

    Frames of reference follow REP-105: map, odom, base_link, then each sensor by its name; map and odom are one, as
    the poses that frames carry are believed in the map already.

    Args:
        map_full_s: seconds between whole maps.
    """

    def __init__(self, *, map_full_s: float = 10.0) -> None:
        self.changes = Changes(round(map_full_s * 1e9))
        self._fixed: dict[tuple[str, str], Floats] = {(WORLD, ODOM): np.eye(4)}
        self._known: dict[str, object] = {}
        self._counts: dict[str, int] = {}
        self._path: list[Trajectory] = []
        self._path_ns = self._last_ns = 0
        self._waiting: list[Item] = []  # what has no time of its own, until frames come
        self._begun = False

    def notes(self, item: Item) -> list[Note]:
        """Messages of one item in order of time."""
        if isinstance(item, Frames | Mapping):
            return self._of_frames(sensors_of(item))
        if isinstance(item, Passed):
            return [Note(item.t_ns, item.topic, item.kind, "relayed", item.data)]
        if not self._begun:
            self._waiting.append(item)
            return []
        return sorted(self._of_other(item), key=lambda note: note.t_ns)

    def rest(self) -> list[Note]:
        """What still waits for a time, at the end; and the whole map."""
        self._begun = True
        early, self._waiting = self._waiting, []
        out = [note for item in early for note in self._of_other(item)]
        if self.changes.last is not None and self.changes.sent_ns != self._last_ns:
            self.changes.wanted = True
            out += self.changes.notes(self.changes.last, self._last_ns)
        return out

    def _of_frames(self, parts: list[Frames]) -> list[Note]:
        first_ns = min(int(part.t_ns[0]) for part in parts)
        out = list(self._fixed_notes(parts, first_ns))
        self._last_ns, self._begun = first_ns, True
        early, self._waiting = self._waiting, []
        for item in early:
            out += self._of_other(item)
        for part in parts:
            out += self._of_radar(part)
            self._last_ns = max(self._last_ns, int(part.t_ns[-1]))
        out += self._of_body(parts)
        return sorted(out, key=lambda note: note.t_ns)

    def _fixed_notes(self, parts: list[Frames], t_ns: int) -> Iterator[Note]:
        mounts = {(BODY, part.sensor): part.spec.mount.body_from_sensor() for part in parts}
        same = all(key in self._fixed and np.array_equal(self._fixed[key], value) for key, value in mounts.items())
        if self._begun and same:
            return
        self._fixed |= mounts
        yield Note(t_ns, "/tf_static", ros.TRANSFORMS, "latched", encode.fixed_note(t_ns, self._fixed))

    def _of_radar(self, frames: Frames) -> Iterator[Note]:
        from ullage.processing.detect import detect

        topic = f"radar/{topic_name(frames.sensor)}"
        known = (frames.spec, frames.unit, frames.calibration, frames.range_m.tobytes())
        if self._known.get(topic) != known:
            self._known[topic] = known
            t_ns = int(frames.t_ns[0])
            yield Note(t_ns, f"{topic}/settings", ros.SETTINGS, "latched", conversions.settings_note(frames))
        start = self._counts.get(topic, 0)
        self._counts[topic] = start + len(frames)
        for name, kind, notes in (
            ("frame", ros.FRAME, conversions.frame_notes(frames, start)),
            ("profile", ros.CLOUD, conversions.profile_notes(frames)),
            ("range", encode.RANGE, encode.range_notes(frames, detect(frames))),
        ):
            for t_ns, note in zip(frames.t_ns.tolist(), notes, strict=True):
                yield Note(t_ns, f"{topic}/{name}", kind, "sensor", note)

    def _of_body(self, parts: list[Frames]) -> Iterator[Note]:
        """The body's transforms and odometry at every time that a sensor knew it, and the truth where it is there."""
        believed = merged([body_path(part, part.poses) for part in parts if part.poses is not None])
        truth = merged([body_path(part, part.truth) for part in parts if part.truth is not None])
        if believed is not None:
            for t_ns, note in _timed(believed, conversions.transform_notes({BODY: believed}, parent=ODOM)):
                yield Note(t_ns, "/tf", ros.TRANSFORMS, "transforms", note)
            for t_ns, note in _timed(believed, conversions.odometry_notes(believed, parent=ODOM)):
                yield Note(t_ns, "odom", ros.ODOMETRY, "stream", note)
            yield from self._path_notes(believed)
        if truth is not None:
            for t_ns, note in _timed(truth, conversions.odometry_notes(truth)):
                yield Note(t_ns, "truth/odom", ros.ODOMETRY, "stream", note)

    def _path_notes(self, path: Trajectory) -> Iterator[Note]:
        """The way flown, thinned, once a second."""
        for row in range(len(path)):
            last = self._path[-1] if self._path else None
            if last is not None and path.t_ns[row] <= last.t_ns[0]:  # the clock jumped back: a new flight
                self._path, last = [], None
            if last is None or np.linalg.norm(path.position[row] - last.position[0]) >= PATH_STEP_M:
                self._path.append(path[row : row + 1])
        self._path = self._path[-PATH_POINTS:]
        now = int(path.t_ns[-1])
        if abs(now - self._path_ns) >= 1e9 and (way := strung(self._path)) is not None:
            self._path_ns = now
            yield Note(now, "path", encode.PATH, "latched", encode.path_note(way))

    def _of_other(self, item: Item) -> Iterator[Note]:
        t_ns = self._last_ns
        if isinstance(item, OccupancyMap) and item.grid.dims == 2:
            yield from self.changes.notes(item, t_ns)
        elif isinstance(item, OccupancyMap):
            yield Note(t_ns, "map/occupied", ros.CLOUD, "latched", conversions.occupied_note(item, t_ns))
            yield Note(t_ns, "map/cubes", ros.MARKERS, "latched", encode.cubes_note(item, t_ns))
        elif isinstance(item, Detections):
            topic = f"radar/{topic_name(item.sensor)}/detections"
            yield from (Note(at, topic, ros.CLOUD, "sensor", data) for at, data in conversions.detection_notes(item))
        elif isinstance(item, Scene):
            yield Note(t_ns, "world", ros.MARKERS, "latched", conversions.scene_note(item, t_ns))
        elif isinstance(item, Image):
            grey, exact = encode.picture_notes(item, t_ns)
            yield Note(t_ns, "image", encode.PICTURE, "latched", grey)
            yield Note(t_ns, "image/amplitude", encode.PICTURE, "latched", exact)
        elif isinstance(item, Trajectory):
            yield Note(t_ns, "plan", encode.PATH, "latched", encode.path_note(item))


def body_path(frames: Frames, path: Trajectory) -> Trajectory:
    """The body's path from that of a sensor on it."""
    return path.mounted(invert(frames.spec.mount.body_from_sensor()))


def merged(paths: list[Trajectory]) -> Trajectory | None:
    """Paths of one body as several sensors tell it, each time once."""
    if len(paths) < 2 or all(np.array_equal(path.t_ns, paths[0].t_ns) for path in paths):
        return paths[0] if paths else None
    t_ns, row = np.unique(np.concatenate([path.t_ns for path in paths]), return_index=True)
    columns = np.concatenate([conversions.state_columns(path) for path in paths])[row]
    return conversions.path_of(t_ns, columns)


def _timed(path: Trajectory, notes: list[bytes]) -> Iterator[tuple[int, bytes]]:
    return zip(path.t_ns.tolist(), notes, strict=True)


def shifted(frames: Frames, by_ns: int) -> Frames:
    """The same frames at other times."""
    if not by_ns:
        return frames
    t_ns = frames.t_ns + by_ns
    poses, truth = (None if p is None else replace(p, t_ns=t_ns) for p in (frames.poses, frames.truth))
    return replace(frames, t_ns=t_ns, poses=poses, truth=truth)
