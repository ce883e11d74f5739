"""Interfaces of every port: a source of frames, what sinks take, and the repair of clocks."""

from __future__ import annotations

import warnings
from collections import deque
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass
from itertools import groupby
from pathlib import Path
from typing import Any, Protocol, runtime_checkable

import numpy as np
from numpy.typing import NDArray

from ullage import checks
from ullage.data import Detections, Frames, Trajectory, gathered, joined
from ullage.errors import DamageWarning, InputError, UllageWarning
from ullage.grids import Image, OccupancyMap
from ullage.ports.intake import Counters, warn
from ullage.processing.obstacles import ObstacleSectors
from ullage.world.scene import Scene

Chunk = Mapping[str, Frames]
"""A piece of a recording: frames of each sensor by name."""


@dataclass(frozen=True, slots=True)
class Passed:
    """A ROS message that one port receives and another may publish; it holds no radar data."""

    t_ns: int  # time of its content
    topic: str  # without the namespace
    kind: str  # `package/msg/Name`
    data: bytes  # CDR


class Passing:
    """Messages that a live source receives besides frames, passed on to a taker as they come."""

    def __init__(self) -> None:
        self._take: Callable[[Passed | Trajectory], None] | None = None
        self._waiting: deque[Callable[[], Iterable[Passed | Trajectory]]] = deque(maxlen=1000)

    def to(self, take: Callable[[Passed | Trajectory], None]) -> None:
        """Pass messages to this taker from now on; the waiting ones go first."""
        self._take = take
        while self._waiting:
            self.give(self._waiting.popleft())

    def give(self, make: Callable[[], Iterable[Passed | Trajectory]]) -> None:
        """Pass on the messages that `make` returns; it is called only once there is a taker."""
        if self._take is None:
            self._waiting.append(make)
            return
        for item in make():
            self._take(item)


Item = Frames | Chunk | Trajectory | OccupancyMap | Detections | ObstacleSectors | Scene | Image | Passed
"""Types that a sink accepts; it ignores those that it cannot use."""

MOST_JUMPS, SHARE_OF_JUMPS = 3, 0.1
"""Steps of a clock that may go back: so many, or such a share of all."""

COARSEST = 8
"""Steps of the samples' lattice within their range: fewer do not show whether a limit was reached."""


@runtime_checkable
class Source(Protocol):
    """Source of frames: an instrument, a simulation or a recording. Those that inherit it know no path and no map."""

    @property
    def sensors(self) -> tuple[str, ...]:
        """Names of the radars."""

    def frames(self, sensor: str | None = None) -> Frames | dict[str, Frames]:
        """Everything of one sensor as Frames, or of several as a dict by name."""

    def stream(self, chunk: int = 64) -> Iterator[dict[str, Frames]]:
        """The same in pieces of at most `chunk` frames of each sensor, in order of time."""

    def trajectory(self) -> Trajectory | None:
        """The path of the body, where it is known."""
        return None

    def map(self) -> OccupancyMap | None:
        """The last map recorded, where there is one."""
        return None


class Recording(Source):
    """A file whose frames are what its stream gives.

    Args:
        path: of the file.
    """

    holds = ""
    """What frames are made of, for complaints."""

    def __init__(self, path: str | Path) -> None:
        self.path = Path(path)
        self._sensors: tuple[str, ...] | None = None

    @property
    def sensors(self) -> tuple[str, ...]:
        """Names of the radars."""
        if self._sensors is None:
            self._sensors = tuple(dict.fromkeys(self._names()))
        return self._sensors

    def _names(self) -> Iterator[str]:
        """Give the name of each radar, once or more often."""
        return (name for piece in self.stream(1024) for name in piece)

    def frames(self, sensor: str | None = None) -> Frames | dict[str, Frames]:
        """Everything of one sensor as Frames, or of several as a dict by name.

        Raises:
            InputError: no frames are there, or no such sensor.
        """
        whole = gathered(self.stream(1024))
        if not whole:
            raise InputError("no radar frames in it", where=self.path, allowed=self.holds)
        return one_or_all(whole, sensor)

    def _warn_of_dropped(self, counters: Counters) -> None:
        """Warn of messages that were not used, at the end of a stream."""
        kind = DamageWarning if counters.dropped("bad") else UllageWarning
        for line in counters.lines():
            warnings.warn(f"{self.path}: {line}", kind, stacklevel=3)


class WholeSource(Source):
    """A recording held in memory.

    Args:
        frames: of each sensor by name.
        path: of the body, where it is known.
    """

    def __init__(self, frames: dict[str, Frames], *, path: Trajectory | None = None) -> None:
        self._frames, self._path = frames, path

    @property
    def sensors(self) -> tuple[str, ...]:
        """Names of the radars."""
        return tuple(self._frames)

    def frames(self, sensor: str | None = None) -> Frames | dict[str, Frames]:
        """Everything of one sensor as Frames, or of several as a dict by name."""
        return one_or_all(self._frames, sensor)

    def stream(self, chunk: int = 64) -> Iterator[dict[str, Frames]]:
        """The same in pieces of at most `chunk` frames of each sensor, in order of time."""
        return pieces(self._frames, checks.whole("chunk", chunk, "stream", low=1))

    def trajectory(self) -> Trajectory | None:
        """The path of the body, where it is known."""
        return self._path


def pieces(frames: Mapping[str, Frames], chunk: int) -> Iterator[dict[str, Frames]]:
    """Give the frames in pieces of at most `chunk` of each sensor."""
    start = 0
    while part := {name: f[start : start + chunk] for name, f in frames.items() if len(f) > start}:
        yield part
        start += chunk


def of_one_kind(parts: Mapping[str, Iterable[Frames]]) -> Iterator[dict[str, Frames]]:
    """Give parts of several sensors in pieces, as many frames together as have one spec, and all have poses or none."""
    left = {
        name: [joined(list(alike)) for _, alike in groupby(some, key=lambda part: (part.poses is None, part.spec))]
        for name, some in parts.items()
    }
    while piece := {name: some.pop(0) for name, some in left.items() if some}:
        yield piece


def one_or_all(frames: dict[str, Frames], sensor: str | None) -> Frames | dict[str, Frames]:
    """The frames of one sensor, asked for by name or the only one there; else all of them.

    Raises:
        InputError: there is no such sensor.
    """
    if sensor is not None:
        if sensor not in frames:
            raise InputError(f"no sensor {sensor!r}", where="sensor", allowed=", ".join(frames))
        return frames[sensor]
    return next(iter(frames.values())) if len(frames) == 1 else frames


def mend_clock(t_ns: NDArray[np.int64], *, where: str | Path) -> NDArray[np.int64]:
    """Times that rise: where the clock jumps back or stands still, the usual step is taken instead, with a warning.

    Raises:
        InputError: so many steps go back that the rows are out of order, which no step in between mends.
    """
    step = np.diff(t_ns)
    bad = np.flatnonzero(step <= 0)
    if not bad.size:
        return t_ns
    back = int(np.count_nonzero(step < 0))
    if back > max(MOST_JUMPS, SHARE_OF_JUMPS * len(step)):
        raise InputError(f"{back} of {len(step)} times are earlier than the one before", where=where,
                         allowed="rows in order of time")  # fmt: skip
    usual = max(int(np.median(step[step > 0])), 1) if np.any(step > 0) else 1_000_000
    jumps = [float(step[i]) * 1e-9 for i in bad[:3]]
    warn(
        f"{where}: the clock jumps back or stands still {bad.size} times, first after frame {int(bad[0])} "
        f"({jumps[0]:+.3f} s); the usual step of {usual * 1e-6:.3g} ms was taken there"
    )
    step = step.copy()
    step[bad] = usual
    return np.asarray(np.concatenate([t_ns[:1], t_ns[0] + np.cumsum(step)]), np.int64)


def warn_of_saturation(samples: NDArray[Any], path: Path) -> None:
    """Warn where samples stay at the greatest value of the recording for three bins in a row, and pile up there.

    An echo passes its greatest value in one bin. Coarse samples may repeat it, but not more often than values below. A
    converter's limit holds everything that lies beyond, so the share of saturated samples does not matter.
    """
    size = np.abs(np.stack([samples.real, samples.imag] if np.iscomplexobj(samples) else [samples]))
    limit = float(size.max())
    known = np.unique(size.ravel()[:: max(1, size.size // 100_000)])
    step = float(np.diff(known).min()) if len(known) > 1 else limit
    width = max(limit / 16, step)
    near = int(((size >= limit - width) & (size < limit)).sum())
    full = size == limit
    if limit <= COARSEST * step or full.sum() <= near * step / width:
        return
    rows = (full[:, :, 2:] & full[:, :, 1:-1] & full[:, :, :-2]).any(axis=(0, 2))
    if rows.any():
        what = f"{int(rows.sum())} of {len(rows)} scans are saturated, first scan {int(np.argmax(rows))}"
        share = f"{100 * full.mean():.2g} % of all samples lie at the limit"
        warn(f"{path}: {what}; {share}, and the strongest echoes are cut off")
