"""Recordings: MCAP files of ROS 2 messages [MCAP], which ROS 2 tools open and a kill leaves readable.

What is written follows the data's clock: a chunk goes to the file at least every half second of it.
"""

from __future__ import annotations

import signal
import threading
import time
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from types import FrameType
from typing import Any, Literal, Self

import numpy as np

from ullage.data import Detections, Frames, Trajectory, sensors_of
from ullage.errors import InputError
from ullage.files import write_whole
from ullage.geometry import invert
from ullage.grids import Image, OccupancyMap
from ullage.ports import conversions
from ullage.ports import messages as ros
from ullage.ports.messages import topic_name
from ullage.ports.protocol import Item, Passed
from ullage.world.scene import Scene

FLUSH_NS = 500_000_000
LATCHED = """\
- history: keep_last
  depth: 1
  reliability: reliable
  durability: transient_local
  deadline: {sec: 9223372036, nsec: 854775807}
  lifespan: {sec: 9223372036, nsec: 854775807}
  liveliness: automatic
  liveliness_lease_duration: {sec: 9223372036, nsec: 854775807}
  avoid_ros_namespace_conventions: false
"""

Note = tuple[int, int, bytes]  # time [ns], channel, message


class Drain:
    """A file that is written at once and remembers what arrived whole."""

    def __init__(self, path: Path) -> None:
        self._raw = open(path, "wb", buffering=0)  # noqa: SIM115 (closed by close)
        self.size = self.whole = 0

    def write(self, data: bytes) -> int:
        """Write all of it."""
        rest = memoryview(data)
        while rest:
            sent = self._raw.write(rest) or 0
            self.size += sent
            rest = rest[sent:]
        return len(data)

    def tell(self) -> int:
        """Bytes written."""
        return self.size

    def flush(self) -> None:
        """What is written now is whole."""
        self.whole = self.size

    def close(self, *, cut: bool = False) -> None:
        """Close; `cut` takes off what did not arrive whole."""
        if cut:
            self._raw.truncate(self.whole)
        self._raw.close()


class McapSink:
    """Writes a recording as it happens.

    Topics: `/radar/<sensor>/frame`, `settings`, `profile` (points for eyes) and `detections`; `/tf`; `/odom` and
    `/truth/odom` of the body; `/map` and `/map/cells`; `/world`.

    Args:
        path: the `.mcap` file, or a folder, which gets `frames.mcap` and, at the end, rosbag2's `metadata.yaml`.
        overwrite: replace a recording that is there already.
        profile: write each profile a second time as a PointCloud2 that viewers show without knowing ullage.

    Raises:
        InputError: it exists already, or cannot be written.
    """

    def __init__(self, path: str | Path, *, overwrite: bool = False, profile: bool = True) -> None:
        from mcap.writer import CompressionType, Writer

        self.path = Path(path)
        self._profile = profile
        if self.path.suffix.lower() != ".mcap":
            self.path = self.path / "frames.mcap"
        if self.path.exists() and not overwrite:
            raise InputError("exists already", where=self.path, allowed="a new name, or overwrite=True")
        try:
            self.path.parent.mkdir(parents=True, exist_ok=True)
            drain = Drain(self.path)
        except OSError as error:
            raise InputError(f"cannot write: {error.strerror}", where=self.path) from None
        self._file: Drain | None = drain
        self._writer = Writer(drain, chunk_size=4 << 20, compression=CompressionType.ZSTD)  # type: ignore[arg-type]
        self._channels: dict[str, tuple[int, str, str]] = {}  # id, type, quality of service
        self._schemas: dict[str, int] = {}
        self._counts: dict[int, int] = {}
        self._settings: dict[str, tuple[Any, ...]] = {}
        self._told: set[str] = set()  # roles of body paths that were handed in as such
        self._waiting: list[Item] = []  # what has no time of its own, until something that has comes
        self._first_ns, self._last_ns, self._flushed_ns = -1, 0, -1
        self._flushed_s = time.monotonic()
        with self._saying_when_full():
            self._writer.start(profile="ros2", library="ullage")

    def write(self, item: Item, *, role: Literal["believed", "truth"] = "believed") -> None:
        """Take frames (of one sensor or of several by name), a body trajectory, a map, detections or the scene.

        Args:
            item: what to record.
            role: what a trajectory is.

        Raises:
            InputError: the recording is closed, or the disk is full; what was written so far stays readable.
        """
        if self._file is None:
            raise InputError("the recording is closed", where=self.path)
        if isinstance(item, Scene | OccupancyMap) and self._first_ns < 0:
            self._waiting.append(item)
            return
        with unbroken():
            notes = list(self._notes(item, role))
            early, self._waiting = self._waiting, []
            if early:
                self._last_ns = min(note[0] for note in notes)
                notes += [note for thing in early for note in self._notes(thing, role)]
            self._put(sorted(notes, key=lambda note: note[0]))

    def _notes(self, item: object, role: str) -> Iterator[Note]:
        if isinstance(item, Frames | Mapping):
            yield from self._frame_notes(sensors_of(item))
        elif isinstance(item, Trajectory):
            self._told.add(role)
            yield from self._body_notes(item, role)
        elif isinstance(item, OccupancyMap):
            yield from self._map_notes(item)
        elif isinstance(item, Detections):
            channel = self._channel(f"/radar/{topic_name(item.sensor)}/detections", ros.CLOUD)
            yield from ((t_ns, channel, data) for t_ns, data in conversions.detection_notes(item))
        elif isinstance(item, Scene):
            channel = self._channel("/world", ros.MARKERS, LATCHED)
            yield self._last_ns, channel, conversions.scene_note(item, self._last_ns)
        elif isinstance(item, Passed):
            yield item.t_ns, self._channel(f"/{item.topic}", item.kind), item.data
        elif not isinstance(item, Image):  # an image lies beside the recording, as a picture
            raise InputError(f"cannot record a {type(item).__name__}", where=self.path, allowed="frames, maps, ...")

    def _frame_notes(self, parts: list[Frames]) -> Iterator[Note]:
        for frames in parts:
            topic = f"/radar/{topic_name(frames.sensor)}"
            yield from self._settings_notes(frames, topic)
            channel = self._channel(f"{topic}/frame", ros.FRAME)
            yield from noted(frames, channel, conversions.frame_notes(frames, self._counts.get(channel, 0)))
            if self._profile:
                channel = self._channel(f"{topic}/profile", ros.CLOUD)
                yield from noted(frames, channel, conversions.profile_notes(frames))
        yield from self._pose_notes(parts)

    def _settings_notes(self, frames: Frames, topic: str) -> Iterator[Note]:
        known = (frames.spec, frames.unit, frames.calibration, frames.range_m.tobytes())
        before = self._settings.get(frames.sensor, (None,))
        t_ns = int(frames.t_ns[0])
        if before[0] != known:
            yield t_ns, self._channel(f"{topic}/settings", ros.SETTINGS, LATCHED), conversions.settings_note(frames)
        if frames.track is not None and before[-1] is not frames.track:
            note = conversions.track_note(frames.track, frames.sensor, t_ns)
            yield t_ns, self._channel(f"{topic}/track", ros.TRACK, LATCHED), note
        self._settings[frames.sensor] = (known, frames.track)

    def _pose_notes(self, parts: list[Frames]) -> Iterator[Note]:
        """/tf of the sensors, in one message where they share their times, and odometry of the body."""
        placed = {topic_name(f.sensor): f.poses for f in parts if f.poses is not None}
        while placed:
            first = next(iter(placed.values()))
            together = {name: path for name, path in placed.items() if np.array_equal(path.t_ns, first.t_ns)}
            channel = self._channel("/tf", ros.TRANSFORMS)
            yield from noted(first, channel, conversions.transform_notes(together))
            placed = {name: path for name, path in placed.items() if name not in together}
        lead = parts[0]
        sensor_from_body = invert(lead.spec.mount.body_from_sensor())
        for role, path in (("believed", lead.poses), ("truth", lead.truth)):
            if path is not None and role not in self._told:
                yield from self._body_notes(path.mounted(sensor_from_body), role)

    def _body_notes(self, path: Trajectory, role: str) -> Iterator[Note]:
        topic = "/odom" if role == "believed" else "/truth/odom"
        yield from noted(path, self._channel(topic, ros.ODOMETRY), conversions.odometry_notes(path))
        if role == "believed":
            channel = self._channel("/tf", ros.TRANSFORMS)
            yield from noted(path, channel, conversions.transform_notes({conversions.BODY: path}))

    def _map_notes(self, omap: OccupancyMap) -> Iterator[Note]:
        t_ns = self._last_ns
        yield t_ns, self._channel("/map/cells", ros.CELLS, LATCHED), conversions.cells_note(omap, t_ns)
        if omap.grid.dims == 2:
            yield t_ns, self._channel("/map", ros.GRID, LATCHED), conversions.grid_note(omap, t_ns)
        else:
            yield t_ns, self._channel("/map/occupied", ros.CLOUD, LATCHED), conversions.occupied_note(omap, t_ns)

    def _channel(self, topic: str, kind: str, quality: str = "") -> int:
        if topic not in self._channels:
            if kind not in self._schemas:
                text = ros.schema_text(kind)
                self._schemas[kind] = self._writer.register_schema(kind, "ros2msg", text.encode())
            about = {"offered_qos_profiles": quality, "topic_type_hash": ros.typestore().hash_rihs01(kind)}
            number = self._writer.register_channel(topic, "cdr", self._schemas[kind], about)
            self._channels[topic] = (number, kind, quality)
        return self._channels[topic][0]

    def _put(self, notes: list[Note]) -> None:
        with self._saying_when_full():
            for t_ns, channel, data in notes:
                if self._first_ns < 0:
                    self._first_ns = self._flushed_ns = t_ns
                self._counts[channel] = self._counts.get(channel, 0) + 1
                self._writer.add_message(channel, t_ns, data, t_ns, self._counts[channel] - 1)
                self._last_ns = max(self._last_ns, t_ns)
                if t_ns - self._flushed_ns >= FLUSH_NS:
                    self._flush(t_ns)
            if notes and time.monotonic() - self._flushed_s >= FLUSH_NS * 1e-9:
                self._flush(self._last_ns)

    def _flush(self, t_ns: int) -> None:
        self._writer.flush()  # type: ignore[no-untyped-call]
        self._flushed_ns, self._flushed_s = t_ns, time.monotonic()

    @contextmanager
    def _saying_when_full(self) -> Iterator[None]:
        try:
            yield
        except OSError as error:
            broken, self._file = self._file, None
            if broken is not None:
                broken.close(cut=True)
            until = f"; readable up to {self._flushed_ns * 1e-9:.2f} s" if self._first_ns >= 0 else ""
            raise InputError(f"cannot write: {error.strerror}{until}", where=self.path) from None

    def close(self) -> None:
        """Finish the file with its index."""
        if self._file is None:
            return
        if self._waiting:
            self._first_ns = 0
            waiting, self._waiting = self._waiting, []
            for item in waiting:
                self.write(item)
        with unbroken(), self._saying_when_full():
            self._writer.finish()  # type: ignore[no-untyped-call]
            self._file.close()
            self._file = None
            if self.path.name == "frames.mcap":
                self._write_metadata()

    def _write_metadata(self) -> None:
        """Rosbag2's description of the folder, which its readers start from."""
        import yaml

        class Unshared(yaml.SafeDumper):
            def ignore_aliases(self, data: Any) -> bool:
                return True

        total = sum(self._counts.values())
        start = {"nanoseconds_since_epoch": max(self._first_ns, 0)}
        span = {"nanoseconds": self._last_ns - max(self._first_ns, 0)}
        topics = [
            {
                "topic_metadata": {
                    "name": topic, "type": kind, "serialization_format": "cdr",
                    "offered_qos_profiles": yaml.safe_load(quality) or [],
                    "type_description_hash": ros.typestore().hash_rihs01(kind),
                },
                "message_count": self._counts.get(number, 0),
            }
            for topic, (number, kind, quality) in self._channels.items()
        ]  # fmt: skip
        file = {"path": self.path.name, "starting_time": start, "duration": span, "message_count": total}
        about = {
            "version": 9, "storage_identifier": "mcap", "relative_file_paths": [self.path.name], "duration": span,
            "starting_time": start, "message_count": total, "topics_with_message_count": topics,
            "compression_format": "", "compression_mode": "", "files": [file], "custom_data": None,
            "ros_distro": "jazzy",
        }  # fmt: skip
        text = yaml.dump({"rosbag2_bagfile_information": about}, sort_keys=False, Dumper=Unshared)
        write_whole(self.path.with_name("metadata.yaml"), lambda out: out.write(text.encode()))

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *error: object) -> None:
        self.close()


def noted(timed: Frames | Trajectory, channel: int, data: list[bytes]) -> Iterator[Note]:
    """Messages with their times and channel."""
    return ((t_ns, channel, note) for t_ns, note in zip(timed.t_ns.tolist(), data, strict=True))


@contextmanager
def unbroken() -> Iterator[None]:
    """Hold Ctrl-C back until a record is written whole."""
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    caught: list[tuple[int, FrameType | None]] = []
    before = signal.signal(signal.SIGINT, lambda number, frame: caught.append((number, frame)))
    try:
        yield
    finally:
        signal.signal(signal.SIGINT, before if before is not None else signal.SIG_DFL)
    if caught and callable(before):
        before(*caught[0])
