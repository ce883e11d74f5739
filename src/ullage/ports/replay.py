"""Read recordings: complete ones, and the readable part of truncated or damaged ones.

Files are read from front to back, a chunk at a time, so memory stays flat and no index is needed.
"""

from __future__ import annotations

import io
import struct
import warnings
import zlib
from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from ullage.data import Frames, Trajectory
from ullage.errors import InputError
from ullage.grids import OccupancyMap
from ullage.ports import conversions
from ullage.ports import schema as ros
from ullage.ports.intake import Clock, Counters, Stamped, Stream, warn
from ullage.ports.protocol import Recording, of_one_kind
from ullage.untrusted import reading

if TYPE_CHECKING:
    from ullage.flight.live import Wish

SHORTEST = 20
"""A message with a header and a name is longer [bytes]."""
MAGIC = b"\x89MCAP0\r\n"
MOST_CHUNK_BYTES = 256 * 2**20
RECORD = struct.Struct("<BQ")
"""Opcode and length of a record."""
FIELDS = struct.Struct("<HIQQ")
"""Channel, sequence, log time and publish time, before the data of a message."""


@dataclass
class Waiting:
    """Messages of one sensor that are to become Frames, and what holds for them."""

    stream: Stream[bytes]
    settings: dict[str, Any] = field(default_factory=dict)
    messages: list[Stamped[bytes]] = field(default_factory=list)


class McapSource(Recording):
    """Reads a recording, in bounded memory when streamed.

    Args:
        path: the `.mcap` file.

    Raises:
        InputError: it is not a recording, or cannot be read.
    """

    holds = f"messages of {ros.FRAME}"

    def __init__(self, path: str | Path) -> None:
        super().__init__(path)
        self.imu_files = (self.path,)
        with reading(self.path), open(self.path, "rb") as file:
            magic = file.read(len(MAGIC))
        if magic != MAGIC:
            raise InputError("not an MCAP recording" if magic else "empty file", where=self.path, allowed="MCAP")
        self.place = ""

    def _names(self) -> Iterator[str]:
        return (conversions.text_in(data, 1) for _, _, data in self.messages(ros.FRAME))

    def stream(self, chunk: int = 64) -> Iterator[dict[str, Frames]]:
        """The same in pieces of at most `chunk` frames of each sensor, in order of time.

        Raises:
            InputError: what was recorded makes no frames.
        """
        counters = Counters(lambda text: warn(f"{self.path}: {text}"))
        waiting: dict[str, Waiting] = {}
        for _, kind, data in self.messages(ros.FRAME, ros.SETTINGS, ros.TRACK):
            mine = self._sensor(data, waiting, counters) if len(data) > SHORTEST else None
            if mine is None:
                counters.drop("messages", "bad", "they name no sensor")
                continue
            full = len(mine.messages) >= chunk or (mine.messages and len(mine.messages[0].item) != len(data))
            if mine.messages and (full or kind != ros.FRAME):
                yield from self._made(waiting, counters)
            if kind == ros.FRAME:
                mine.messages += mine.stream.take(conversions.time_in(data), data)
            else:
                self._set(mine, kind, data, counters)
        for mine in waiting.values():
            mine.stream.finish()
        yield from self._made(waiting, counters)
        self._warn_of_dropped(counters)

    def _sensor(self, data: bytes, waiting: dict[str, Waiting], counters: Counters) -> Waiting | None:
        """What waits of the sensor that a message names; None where it cannot be read."""
        try:
            name = conversions.text_in(data, 1)
        except ValueError:  # no text
            return None
        if name not in waiting:  # each sensor has a clock of its own: a file may hold one after the other
            waiting[name] = Waiting(Clock(counters).stream(name))
        return waiting[name]

    def _set(self, mine: Waiting, kind: str, data: bytes, counters: Counters) -> None:
        try:
            known = conversions.settings_of(data) if kind == ros.SETTINGS else {"track": conversions.track_of(data)}
        except Exception as error:  # a damaged message can raise any error in the decoders
            counters.drop(mine.stream.topic, "bad", f"{kind}: {type(error).__name__}")
            return
        mine.settings = {**mine.settings, **known}

    def _made(self, waiting: dict[str, Waiting], counters: Counters) -> Iterator[dict[str, Frames]]:
        """The frames that wait, if there are any."""
        out = {}
        for name, mine in waiting.items():
            messages, mine.messages = mine.messages, []
            counters.receive(name, len(messages))
            out[name] = sound_frames(name, mine.settings, messages, counters) if messages else []
        yield from of_one_kind(out)

    def trajectory(self) -> Trajectory | None:
        """Return the estimated path of the body, if known."""
        messages = [data for topic, _, data in self.messages(ros.ODOMETRY) if topic == "/odom"]
        return conversions.odometry_path(messages) if messages else None

    def commands(self) -> list[tuple[int, Wish]]:
        """Return the commands of whoever flew by hand, each with its time [ns]."""
        wanted = {f"/{ros.PILOT_VELOCITY}": ros.TWIST_STAMPED, f"/{ros.PILOT_PLACE}": ros.POSE}
        found = ((kind, data) for topic, kind, data in self.messages(*wanted.values()) if wanted.get(topic) == kind)
        return [conversions.command_of(kind, data) for kind, data in found]

    def map(self) -> OccupancyMap | None:
        """The last map recorded, where there is one."""
        last = {kind: data for _, kind, data in self.messages(ros.CELLS, ros.GRID)}
        if ros.CELLS in last:
            return conversions.cells_of(last[ros.CELLS])
        return conversions.grid_of(last[ros.GRID]) if last else None

    def has_frames(self) -> bool:
        """Whether a RadarFrame is in it."""
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # said when it is read
            return any(True for _ in self.messages(ros.FRAME))

    def topics(self) -> dict[str, str]:
        """Topics that have messages, with their types."""
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            return {topic: kind for topic, kind, _ in self.messages()}

    def messages(self, *kinds: str) -> Iterator[tuple[str, str, bytes]]:
        """Topic, type and CDR bytes of each message of these kinds, or of all, as far as the file can be read."""
        from mcap.records import Channel, Message, Schema

        names: dict[int, str] = {}
        channels: dict[int, tuple[str, str]] = {}
        for number, record in enumerate(self.records()):
            if isinstance(record, Schema):
                names[record.id] = record.name
            elif isinstance(record, Channel):
                kind = names.get(record.schema_id, "")
                if record.message_encoding == "cdr" and (not kinds or kind in kinds):
                    channels[record.id] = record.topic, kind
            elif isinstance(record, Message) and record.channel_id in channels:
                if record.data[:2] != b"\0\1":
                    continue  # big endian: no ROS 2 machine of today writes it
                self.place = f"record {number}"
                yield *channels[record.channel_id], record.data

    def records(self) -> Iterator[Any]:
        """Records in and outside chunks; damaged chunks are left out, with one warning at the end."""
        from mcap.exceptions import EndOfFile
        from mcap.records import Chunk
        from mcap.stream_reader import StreamReader

        broken: Counter[str] = Counter()
        with open(self.path, "rb") as file:
            reader = StreamReader(file, emit_chunks=True, record_size_limit=self.path.stat().st_size)
            records = iter(reader.records)
            while True:
                try:
                    record = next(records)
                except StopIteration:
                    break
                except EndOfFile:
                    broken["it was never finished, or cut"] += 1
                    break
                except unreadable() as error:
                    broken[f"it ends in what is no record, at byte {file.tell()} ({type(error).__name__})"] += 1
                    break
                try:
                    inner = chunk_records(record) if isinstance(record, Chunk) else [record]
                except unreadable():
                    broken["damaged chunks"] += 1
                    continue
                yield from inner
        if broken:
            what = "; ".join(f"{count} {why}" if count > 1 else why for why, count in broken.items())
            warn(f"{self.path}: {what}; all that can be read is used")


def sound_frames(
    name: str, settings: dict[str, Any], messages: list[Stamped[bytes]], counters: Counters, *, topic: str = ""
) -> list[Frames]:  # fmt: skip
    """Decode RadarFrame messages of one sensor at once, or one by one where some cannot be read; these are counted.

    Args:
        name: of the sensor.
        settings: fields of Frames, from `settings_of`.
        messages: with their times.
        counters: count those that cannot be read.
        topic: for the counts; empty: the sensor's name.
    """
    try:
        t_ns = np.array([message.t_ns for message in messages])
        return conversions.frames_of([message.item for message in messages], name, settings, t_ns)
    except Exception as error:  # damaged messages can raise any error in the decoders
        if len(messages) == 1:
            counters.drop(topic or name, "bad", str(error).partition("\n")[0] or type(error).__name__)
            return []
    return [one for message in messages for one in sound_frames(name, settings, [message], counters, topic=topic)]


def unreadable() -> tuple[type[Exception], ...]:
    """Errors of the MCAP reader on damaged bytes."""
    from mcap.exceptions import McapError
    from zstandard import ZstdError

    return (McapError, ZstdError, struct.error, ValueError, RuntimeError, MemoryError, OverflowError)


def chunk_records(chunk: Any) -> list[Any]:
    """The records of a chunk, its checksum compared.

    The library takes eight reads for a message; here the fixed fields are unpacked at once.

    Raises:
        ValueError: it is larger than allowed, not of the size that it promises, or its checksum is wrong; and what the
            libraries raise.
    """
    from mcap.data_stream import ReadDataStream
    from mcap.opcode import Opcode
    from mcap.records import Channel, Message, Schema

    data = unpacked(chunk.data, chunk.compression, chunk.uncompressed_size)
    if chunk.uncompressed_crc and zlib.crc32(data) != chunk.uncompressed_crc:
        raise ValueError("a wrong checksum")
    described: dict[int, Any] = {int(Opcode.SCHEMA): Schema, int(Opcode.CHANNEL): Channel}
    message, out, at = int(Opcode.MESSAGE), [], 0
    while at < len(data):
        opcode, length = RECORD.unpack_from(data, at)
        start, at = at + RECORD.size, at + RECORD.size + length
        if at > len(data):
            raise ValueError("a record longer than its chunk")
        if opcode == message:
            if length < FIELDS.size:
                raise ValueError(f"a message of {length} bytes")
            channel, sequence, logged, published = FIELDS.unpack_from(data, start)
            out.append(Message(channel, logged, data[start + FIELDS.size : at], published, sequence))
        elif opcode in described:
            out.append(described[opcode].read(ReadDataStream(io.BytesIO(data[start:at]))))
    return out


def unpacked(data: bytes, compression: str, size: int) -> bytes:
    """The plain bytes of packed data that promises to hold `size` of them.

    Raises:
        ValueError: the promise is not kept, too large, or the compression not known.
    """
    if size > MOST_CHUNK_BYTES:
        raise ValueError(f"a chunk of {size} bytes")
    if compression == "":
        return data
    if compression == "zstd":
        import zstandard

        out = zstandard.ZstdDecompressor().stream_reader(data, read_across_frames=True).read(size + 1)
    elif compression == "lz4":
        import lz4.frame

        out = lz4.frame.LZ4FrameDecompressor().decompress(data, max_length=size + 1)
    else:
        raise ValueError(f"compression {compression!r}")
    if len(out) != size:
        raise ValueError(f"a chunk that promises {size} bytes and does not hold them")
    return bytes(out)
