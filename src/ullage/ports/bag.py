"""Recordings: MCAP files with ROS 2 messages, which ROS 2 tools and Foxglove open and a kill leaves readable.

What is written follows the data's clock: a chunk goes to the file at least every half second of it.
"""

from __future__ import annotations

import time
from collections.abc import Iterator
from pathlib import Path
from typing import IO, Any, Self

import numpy as np

from ullage.data import Detections, Frames, Trajectory, sensors_of
from ullage.errors import InputError
from ullage.grids import OccupancyMap
from ullage.ports import messages
from ullage.ports.protocol import Item
from ullage.world.scene import Scene

FLUSH_NS = 500_000_000
KINDS = {"/tf": "tf2_msgs/msg/TFMessage"}

Note = tuple[int, int, bytes]  # time [ns], channel, message


class McapSink:
    """Writes a recording.

    Args:
        path: the `.mcap` file; `metadata.yaml` is written beside it where the folder is a run's own.
        overwrite: replace a recording that is there already.

    Raises:
        InputError: it exists already, or cannot be written.
    """

    def __init__(self, path: str | Path, *, overwrite: bool = False) -> None:
        from mcap.writer import CompressionType, Writer

        self.path = Path(path)
        if self.path.exists() and not overwrite:
            raise InputError("exists already", where=self.path, allowed="a new name, or overwrite=True")
        try:
            self._file: IO[bytes] | None = open(self.path, "wb")
        except OSError as error:
            raise InputError(f"cannot write: {error.strerror}", where=self.path) from None
        self._writer = Writer(self._file, compression=CompressionType.ZSTD)
        self._writer.start(profile="ros2", library="ullage")
        self._channels: dict[str, int] = {}
        self._schemas: dict[str, int] = {}
        self._counts: dict[int, int] = {}
        self._settings: dict[str, tuple[object, ...]] = {}
        self._flushed_ns: int | None = None
        self._flushed_s = time.monotonic()
        self._odometry_given: set[str] = set()

    def write(self, item: Item) -> None:
        """Take frames, a body trajectory, a map, detections or the scene.

        Raises:
            InputError: the disk is full; what was written so far stays readable.
        """
        if isinstance(item, Trajectory | OccupancyMap | Detections | Scene):
            raise InputError(f"cannot record {type(item).__name__} yet", where=self.path)
        notes = [note for part in sensors_of(item) for note in self._frame_notes(part)]
        self._put(sorted(notes, key=lambda note: note[0]))

    def _frame_notes(self, frames: Frames) -> Iterator[Note]:
        yield from self._settings_notes(frames)
        topic = f"/radar/{frames.sensor}"
        channel = self._channel(f"{topic}/frame", "ullage_msgs/msg/RadarFrame")
        start = self._counts.get(channel, 0)
        self._counts[channel] = start + len(frames)
        for t_ns, data in zip(frames.t_ns.tolist(), encode_frames(frames, start), strict=True):
            yield t_ns, channel, data

    def _settings_notes(self, frames: Frames) -> Iterator[Note]:
        known = (frames.spec, frames.unit, frames.range_m.tobytes())
        if self._settings.get(frames.sensor) == known:
            return
        self._settings[frames.sensor] = known
        channel = self._channel(f"/radar/{frames.sensor}/settings", "ullage_msgs/msg/RadarSettings")
        yield int(frames.t_ns[0]), channel, encode_settings(frames)

    def _channel(self, topic: str, kind: str) -> int:
        if topic not in self._channels:
            if kind not in self._schemas:
                text = messages.schema_text(kind)
                self._schemas[kind] = self._writer.register_schema(kind, "ros2msg", text.encode())
            self._channels[topic] = self._writer.register_channel(topic, "cdr", self._schemas[kind])
        return self._channels[topic]

    def _put(self, notes: list[Note]) -> None:
        for t_ns, channel, data in notes:
            if self._flushed_ns is None:
                self._flushed_ns = t_ns
            self._writer.add_message(channel, log_time=t_ns, data=data, publish_time=t_ns)
            if t_ns - self._flushed_ns >= FLUSH_NS:
                self._flush(t_ns)
        if notes and time.monotonic() - self._flushed_s >= FLUSH_NS * 1e-9:
            self._flush(notes[-1][0])

    def _flush(self, t_ns: int) -> None:
        self._writer.flush()
        self._flushed_ns, self._flushed_s = t_ns, time.monotonic()

    def close(self) -> None:
        """Finish the file with its index."""
        if self._file is None:
            return
        self._writer.finish()
        self._file.close()
        self._file = None

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *error: object) -> None:
        self.close()


def encode_frames(frames: Frames, start: int) -> list[bytes]:
    """RadarFrame messages of these frames, counted from `start`."""
    baseband = np.iscomplexobj(frames.samples)
    floats = frames.samples.view(np.float32)
    layout = messages.frame_layout(frames.sensor.encode(), frames.sensor.encode(), floats.shape[1])
    sec, nanosec = messages.stamps(frames.t_ns)
    columns: dict[str, Any] = {
        "sec": sec, "nanosec": nanosec, "index": start + np.arange(len(frames)), "kind": int(not baseband),
        "range_start": frames.range_m[0], "range_step": float(np.mean(np.diff(frames.range_m))) if len(frames.range_m) > 1 else 0.0,
        "count": floats.shape[1], "samples": floats,
    }  # fmt: skip
    for name, path in (("believed", frames.poses), ("truth", frames.truth)):
        if path is not None:
            columns[f"has_{name}"] = 1
            columns[name] = messages.states(path.position, path.quat_xyzw, *path.rates)
    return messages.split(layout.make(len(frames), **columns))


def encode_settings(frames: Frames) -> bytes:
    """The RadarSettings message of these frames."""
    sec, nanosec = messages.stamps(frames.t_ns[:1])
    types = messages.typestore().types
    header = types["std_msgs/msg/Header"](
        types["builtin_interfaces/msg/Time"](int(sec[0]), int(nanosec[0])), frames.sensor
    )
    note = types["ullage_msgs/msg/RadarSettings"](
        header, frames.sensor, frames.unit, frames.spec.model_dump_json(), frames.range_m
    )
    return bytes(messages.typestore().serialize_cdr(note, "ullage_msgs/msg/RadarSettings"))
