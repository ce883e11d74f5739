"""Reading recordings back: whole ones by their index or none, and what is left of cut or damaged ones.

Only RadarFrame messages become Frames; a file from elsewhere without them is refused in one line.
"""

from __future__ import annotations

import json
import struct
import warnings
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from ullage.data import Floats, Frames, Trajectory, joined
from ullage.errors import InputError, UllageWarning
from ullage.grids import OccupancyMap
from ullage.ports import messages
from ullage.ports.protocol import one_or_all
from ullage.specs import RadarSpec

FRAME, SETTINGS = "ullage_msgs/msg/RadarFrame", "ullage_msgs/msg/RadarSettings"


@dataclass
class Pending:
    """Messages of one sensor that wait to become Frames, and what holds for them."""

    settings: dict[str, Any] = field(default_factory=dict)
    notes: list[bytes] = field(default_factory=list)
    last_ns: int | None = None


class McapSource:
    """Reads a recording, in bounded memory when streamed.

    Args:
        path: the `.mcap` file.

    Raises:
        InputError: it is not a recording, or cannot be read.
    """

    def __init__(self, path: str | Path) -> None:
        self.path = Path(path)
        try:
            with open(self.path, "rb") as file:
                magic = file.read(8)
        except OSError as error:
            raise InputError(f"cannot read: {error.strerror}", where=self.path) from None
        if magic != b"\x89MCAP0\r\n":
            raise InputError("not an MCAP recording" if magic else "empty file", where=self.path, allowed="MCAP")
        self._sensors: tuple[str, ...] | None = None

    @property
    def sensors(self) -> tuple[str, ...]:
        """Names of the radars."""
        if self._sensors is None:
            self._sensors = tuple(dict.fromkeys(text(data, 1) for _, data in self._messages(FRAME)))
        return self._sensors

    def frames(self, sensor: str | None = None) -> Frames | dict[str, Frames]:
        """Everything of one sensor as Frames, or of several as a dict by name.

        Raises:
            InputError: no frames are there, or no such sensor.
        """
        parts: dict[str, list[Frames]] = {}
        for chunk in self.stream(4096):
            for name, part in chunk.items():
                parts.setdefault(name, []).append(part)
        if not parts:
            raise InputError("no radar frames in it", where=self.path, allowed=f"messages of {FRAME}")
        return one_or_all({name: joined(part) for name, part in parts.items()}, sensor)

    def stream(self, chunk: int = 64) -> Iterator[dict[str, Frames]]:
        """The same in pieces of at most `chunk` frames of each sensor, in order of time."""
        waiting: dict[str, Pending] = {}
        for kind, data in self._messages(FRAME, SETTINGS):
            mine = waiting.setdefault(text(data, 1), Pending())
            if kind == SETTINGS:
                if mine.notes:
                    yield self._made(waiting)
                mine.settings = decode_settings(data)
                continue
            if not mine.settings or (mine.notes and len(mine.notes[0]) != len(data)):
                continue
            mine.notes.append(data)
            if len(mine.notes) >= chunk:
                yield self._made(waiting)
        if any(p.notes for p in waiting.values()):
            yield self._made(waiting)

    def _made(self, waiting: dict[str, Pending]) -> dict[str, Frames]:
        out = {}
        for name, mine in waiting.items():
            if mine.notes:
                out[name] = decode_frames(mine.notes, name, mine.settings)
                mine.notes = []
        return out

    def trajectory(self) -> Trajectory | None:
        """The path of the body, where it is known."""
        return None

    def map(self) -> OccupancyMap | None:
        """The last map recorded, where there is one."""
        return None

    def _messages(self, *kinds: str) -> Iterator[tuple[str, bytes]]:
        """Messages of these kinds as far as the file can be read."""
        from mcap.exceptions import McapError
        from mcap.records import Channel, Message, Schema
        from mcap.stream_reader import StreamReader

        names: dict[int, str] = {}
        channels: dict[int, str] = {}
        with open(self.path, "rb") as file:
            reader = StreamReader(file, record_size_limit=self.path.stat().st_size)
            records = iter(reader.records)
            while True:
                try:
                    record = next(records)
                except StopIteration:
                    return
                except (McapError, ValueError, struct.error, EOFError, Exception) as error:
                    warnings.warn(
                        f"{self.path}: cut or damaged; what came before is used ({error})", UllageWarning, stacklevel=2
                    )
                    return
                if isinstance(record, Schema):
                    names[record.id] = record.name
                elif isinstance(record, Channel):
                    channels[record.id] = names.get(record.schema_id, "")
                elif isinstance(record, Message) and channels.get(record.channel_id) in kinds:
                    yield channels[record.channel_id], record.data


def text(data: bytes, index: int) -> str:
    """The string at this place among a message's first ones, which follow its stamp."""
    at = 12
    for _ in range(index):
        at += 4 + int.from_bytes(data[at : at + 4], "little")
        at += -at % 4
    size = int.from_bytes(data[at : at + 4], "little")
    return data[at + 4 : at + 3 + size].decode()


def decode_settings(data: bytes) -> dict[str, Any]:
    """Fields of Frames that a RadarSettings message holds."""
    note = messages.typestore().deserialize_cdr(data, SETTINGS)
    return {
        "unit": note.unit,
        "range_m": np.array(note.range),
        "spec": RadarSpec(**json.loads(note.settings)),
    }


def decode_frames(notes: list[bytes], sensor: str, settings: dict[str, Any]) -> Frames:
    """Frames of messages of one size."""
    frame_id, name = text(notes[0], 0).encode(), sensor.encode()
    floats = (len(notes[0]) - messages.frame_layout(frame_id, name, 1).dtype.itemsize) // 4 + 1
    layout = messages.frame_layout(frame_id, name, floats)
    records = np.frombuffer(b"".join(notes), layout.dtype)
    samples = np.ascontiguousarray(records["samples"])
    t_ns = records["sec"].astype(np.int64) * 1_000_000_000 + records["nanosec"]
    poses = {
        key: path_of(t_ns, records[name]) if records[f"has_{name}"].all() else None
        for key, name in (("poses", "believed"), ("truth", "truth"))
    }
    return Frames(
        samples.view(np.complex64) if records["kind"][0] == 0 else samples,
        t_ns=t_ns,
        sensor=sensor,
        **settings,
        **poses,
    )


def path_of(t_ns: Any, states: Floats) -> Trajectory:
    """The trajectory of columns (n, 13)."""
    return Trajectory(t_ns, states[:, :3], states[:, 3:7], states[:, 7:10], states[:, 10:])
