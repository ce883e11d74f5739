"""Write recordings: MCAP files of ROS 2 messages [MCAP] that ROS 2 tools open and that stay readable after a kill.

The file follows the data's clock: a chunk goes to the file at least every half second of data. `repair_bag` finishes
what a kill left unfinished.
"""

from __future__ import annotations

import fcntl
import os
import signal
import sys
import time
from collections import Counter
from collections.abc import Iterator, Mapping
from contextlib import contextmanager, suppress
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from ullage.data import Detections, Frames, Trajectory
from ullage.errors import InputError
from ullage.files import write_whole, writing
from ullage.flow import Sink
from ullage.grids import Image, OccupancyMap
from ullage.ports import schema as ros
from ullage.ports.intake import Once
from ullage.ports.protocol import Item, Passed
from ullage.ports.publisher import Message, Publisher
from ullage.ports.replay import MAGIC, McapSource
from ullage.ports.schema import QUALITIES, Quality
from ullage.processing.obstacles import ObstacleSectors
from ullage.stop_signals import StopFlag
from ullage.world.scene import Scene

RECORDED = (Frames, Mapping, Trajectory, OccupancyMap, Detections, ObstacleSectors, Scene, Image, Passed)
FLUSH_NS = 500_000_000
OFFERED = """\
- history: keep_last
  depth: {}
  reliability: {}
  durability: {}
  deadline: {{sec: 9223372036, nsec: 854775807}}
  lifespan: {{sec: 9223372036, nsec: 854775807}}
  liveliness: automatic
  liveliness_lease_duration: {{sec: 9223372036, nsec: 854775807}}
  avoid_ros_namespace_conventions: false
"""
CHUNK_BYTES = 4 << 20
TAIL = 8
"""Bytes at the end of a finished file."""


class Drain:
    """Unbuffered file that tracks its last complete record and is locked while its writer lives."""

    def __init__(self, path: Path) -> None:
        self._raw = open(path, "wb", buffering=0)  # noqa: SIM115 (closed by close)
        with suppress(OSError):  # a file system without locks
            fcntl.flock(self._raw, fcntl.LOCK_EX | fcntl.LOCK_NB)
        self.size = self.whole = 0

    def write(self, data: bytes) -> int:
        """Write all bytes."""
        rest = memoryview(data)
        while rest:
            sent = self._raw.write(rest) or 0
            self.size += sent
            rest = rest[sent:]
        return len(data)

    def tell(self) -> int:
        """Return the number of bytes written."""
        return self.size

    def flush(self) -> None:
        """Mark the bytes written so far as complete."""
        self.whole = self.size

    def close(self, *, cut: bool = False) -> None:
        """Close the file; `cut` removes an incomplete record at the end."""
        if cut:
            self._raw.truncate(self.whole)
        self._raw.close()


@dataclass
class Topics:
    """Topics of a bag's metadata: their types, qualities of service and message counts."""

    kinds: dict[str, str] = field(default_factory=dict)
    offered: dict[str, str] = field(default_factory=dict)
    counts: Counter[str] = field(default_factory=Counter)
    first_ns: int | None = None
    last_ns: int = 0

    def count(self, topic: str, t_ns: int) -> None:
        """Count a message."""
        self.counts[topic] += 1
        self.first_ns = t_ns if self.first_ns is None else min(self.first_ns, t_ns)
        self.last_ns = max(self.last_ns, t_ns)


class McapSink(Sink):
    """Write a recording as data arrive: the messages of `publisher.Publisher`, the same as on live topics.

    Args:
        path: the `.mcap` file, or a folder, which gets `frames.mcap` and, at the end, rosbag2's `metadata.yaml`.
        overwrite: replace an existing recording.
        profile: write each profile a second time as a PointCloud2 that viewers show without knowing ullage.

    Raises:
        InputError: it exists already, or cannot be written.
    """

    gathers = True

    def __init__(self, path: str | Path, *, overwrite: bool = False, profile: bool = True) -> None:
        self.path = Path(path)
        if self.path.suffix.lower() != ".mcap":
            self.path = self.path / "frames.mcap"
        if self.path.exists() and not overwrite:
            raise InputError("exists already", where=self.path, allowed="a new name, or overwrite=True")
        with writing(self.path):
            if self.path != Path(path):
                self.path.parent.mkdir(exist_ok=True)
            drain = Drain(self.path)
        self._file: Drain | None = drain
        self._writer = mcap_writer(drain)
        self._publisher = Publisher(profile=profile)
        self._channels: dict[str, int] = {}
        self._schemas: dict[str, int] = {}
        self._once = Once()
        self._topics = Topics()
        self._flushed_ns = -1
        self._flushed_s = time.monotonic()
        with self._saying_when_full():
            self._writer.start(profile="ros2", library="ullage")

    def write(self, item: Item) -> None:
        """Take frames (of one sensor or of several by name), the body's path, a map, detections, an image or the scene.

        Raises:
            InputError: the recording is closed, or the disk is full; the file so far stays readable.
        """
        if self._file is None:
            raise InputError("the recording is closed", where=self.path)
        if not isinstance(item, RECORDED):
            raise InputError(f"cannot record a {type(item).__name__}", where=self.path, allowed="frames, maps, ...")
        with unbroken():
            self._put(self._publisher.messages(item))

    def _channel(self, topic: str, kind: str, quality: Quality) -> int:
        if topic not in self._channels:
            if kind not in self._schemas:
                text = ros.schema_text(kind)
                self._schemas[kind] = self._writer.register_schema(kind, "ros2msg", text.encode())
            depth, reliable, kept = QUALITIES[quality]
            sent = "reliable" if reliable else "best_effort"
            offered = OFFERED.format(depth, sent, "transient_local" if kept else "volatile")
            about = {"offered_qos_profiles": offered, "topic_type_hash": ros.typestore().hash_rihs01(kind)}
            self._channels[topic] = self._writer.register_channel(topic, "cdr", self._schemas[kind], about)
            self._topics.kinds[topic], self._topics.offered[topic] = kind, offered
        return self._channels[topic]

    def _put(self, messages: list[Message]) -> None:
        with self._saying_when_full():
            for message in messages:
                self._add(message)
            if messages and time.monotonic() - self._flushed_s >= FLUSH_NS * 1e-9:
                self._flush(self._topics.last_ns)

    def _add(self, message: Message) -> None:
        topic, t_ns = "/" + message.topic.lstrip("/"), message.t_ns
        if message.quality == "relayed" and not ros.knows(message.kind):
            self._once(f"{topic} is not recorded: the definition of {message.kind} is unknown")
            return  # other sinks still get it
        channel = self._channel(topic, message.kind, message.quality)
        if self._topics.first_ns is None:
            self._flushed_ns = t_ns
        self._writer.add_message(channel, t_ns, message.data, t_ns, self._topics.counts[topic])
        self._topics.count(topic, t_ns)
        if t_ns - self._flushed_ns >= FLUSH_NS:
            self._flush(t_ns)

    def _flush(self, t_ns: int) -> None:
        self._writer.flush()
        self._flushed_ns, self._flushed_s = t_ns, time.monotonic()

    @contextmanager
    def _saying_when_full(self) -> Iterator[None]:
        try:
            yield
        except OSError as error:
            broken, self._file = self._file, None
            if broken is not None:
                broken.close(cut=True)
            until = f"; readable up to {self._flushed_ns * 1e-9:.2f} s" if self._flushed_ns >= 0 else ""
            raise InputError(f"cannot write: {error.strerror}{until}", where=self.path) from None

    def close(self) -> None:
        """Finish the file with its index."""
        if self._file is None:
            return
        with unbroken(), self._saying_when_full():
            self._put(self._publisher.finish())
            self._writer.finish()
            self._file.close()
            self._file = None
            if self.path.name == "frames.mcap":
                write_metadata(self.path, self._topics)


def mcap_writer(stream: Any) -> Any:
    """Return the MCAP writer of recordings."""
    from mcap.writer import CompressionType, Writer

    return Writer(stream, chunk_size=CHUNK_BYTES, compression=CompressionType.ZSTD)


def write_metadata(bag: Path, topics: Topics) -> None:
    """Write the `metadata.yaml` of rosbag2 for a folder with one MCAP file.

    Raises:
        InputError: the folder cannot be written, or the disk is full.
    """
    import yaml

    first_ns = topics.first_ns or 0

    def span() -> dict[str, Any]:  # made twice: YAML would give the second one as an alias
        start, duration = {"nanoseconds_since_epoch": first_ns}, {"nanoseconds": topics.last_ns - first_ns}
        return {"starting_time": start, "duration": duration, "message_count": topics.counts.total()}

    listed = [
        {
            "topic_metadata": {
                "name": topic, "type": kind, "serialization_format": "cdr",
                "offered_qos_profiles": yaml.safe_load(topics.offered.get(topic, "")) or [],
                "type_description_hash": hash_of(kind),
            },
            "message_count": topics.counts[topic],
        }
        for topic, kind in topics.kinds.items()
    ]  # fmt: skip
    about = {
        "version": 9, "storage_identifier": "mcap", "relative_file_paths": [bag.name], **span(),
        "topics_with_message_count": listed, "compression_format": "", "compression_mode": "",
        "files": [{"path": bag.name, **span()}], "custom_data": None, "ros_distro": "jazzy",
    }  # fmt: skip
    text = yaml.safe_dump({"rosbag2_bagfile_information": about}, sort_keys=False)
    write_whole(bag.with_name("metadata.yaml"), lambda out: out.write(text.encode()))


def hash_of(kind: str) -> str:
    """Return the hash of a type; empty for a type that ullage does not know."""
    store = ros.typestore()
    return str(store.hash_rihs01(kind)) if kind in store.types else ""


@contextmanager
def unbroken() -> Iterator[None]:
    """Defer Ctrl-C until a record is complete."""
    with StopFlag(raises_at=sys.maxsize) as stop:
        yield
    if stop.requested:
        signal.raise_signal(signal.SIGINT)


def repair_bag(target: str | Path) -> str:
    """Give a killed bag its index and its metadata back.

    A folder without `metadata.yaml` whose MCAP file nobody writes any more gets both; everything else is left as it is.
    What can be read of the file is kept, message by message, under its own name once it is written whole.

    Args:
        target: a run's folder, a rosbag2 folder, or the MCAP file in one.

    Returns:
        What was done, in one line; empty where there was nothing to do.

    Raises:
        InputError: the folder cannot be written, or the disk is full.
    """
    bag = _unfinished(Path(target))
    if bag is None:
        return ""
    with _owned(bag) as owned:
        if not owned:
            return ""
        finished, topics = _is_finished(bag), Topics()
        if finished:
            with open(os.devnull, "wb") as nowhere:
                _copy(bag, nowhere, topics)
        else:
            write_whole(bag, lambda out: _copy(bag, out, topics))
        if not topics.counts:
            return ""
        write_metadata(bag, topics)
    what = "metadata.yaml" if finished else "its index and metadata.yaml"
    return f"{bag.parent}: the recording was never finished; it has {what} now, with {topics.counts.total()} messages"


def _unfinished(target: Path) -> Path | None:
    """The MCAP file of a bag without a description."""
    folder = target if target.is_dir() else target.parent
    found = sorted(folder.glob("*.mcap")) if target.is_dir() else [target]
    alone = len(found) == 1 and len(list(folder.glob("*.mcap"))) == 1
    named = target.is_dir() or target.name == "frames.mcap"
    if not (alone and named and target.exists()) or (folder / "metadata.yaml").exists():
        return None
    with found[0].open("rb") as file:
        return found[0] if file.read(len(MAGIC)) == MAGIC else None


@contextmanager
def _owned(bag: Path) -> Iterator[bool]:
    """Return whether no process writes the file: a writer holds a lock until it ends, also by a kill."""
    try:
        file = open(bag, "rb")  # noqa: SIM115 (closed below)
    except OSError:
        yield False
        return
    try:
        fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
        yield os.access(bag.parent, os.W_OK)
    except BlockingIOError:
        yield False
    finally:
        file.close()


def _is_finished(bag: Path) -> bool:
    with bag.open("rb") as file:
        file.seek(max(bag.stat().st_size - TAIL, 0))
        return bag.stat().st_size > 2 * TAIL and file.read(TAIL) == MAGIC


def _copy(bag: Path, out: Any, topics: Topics) -> None:
    """Write every message that can be read anew, and count it."""
    from mcap.records import Channel, Header, Message, Schema

    writer, started = mcap_writer(out), False
    schemas: dict[int, tuple[str, int]] = {0: ("", 0)}  # name, and number in the copy
    channels: dict[int, tuple[str, int]] = {}
    for record in McapSource(bag).records():
        if not started:
            writer.start(profile=record.profile if isinstance(record, Header) else "", library="ullage")
            started = True
        if isinstance(record, Schema) and record.id not in schemas:
            schemas[record.id] = record.name, writer.register_schema(record.name, record.encoding, record.data)
        elif isinstance(record, Channel) and record.id not in channels and record.schema_id in schemas:
            topic, (kind, schema) = record.topic, schemas[record.schema_id]
            number = writer.register_channel(topic, record.message_encoding, schema, record.metadata)
            channels[record.id] = topic, number
            topics.kinds[topic], topics.offered[topic] = kind, record.metadata.get("offered_qos_profiles", "")
        elif isinstance(record, Message) and record.channel_id in channels:
            topic, number = channels[record.channel_id]
            writer.add_message(number, record.log_time, record.data, record.publish_time, record.sequence)
            topics.count(topic, record.log_time)
    if started:
        writer.finish()
