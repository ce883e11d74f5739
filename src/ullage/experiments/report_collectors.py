"""Stages that collect what the report needs, in bounded memory however long the run."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from ullage.arrays import Floats, Singles
from ullage.data import Frames, joined, makes_room
from ullage.flow import Stage


@dataclass(slots=True)
class _Pooled:
    """Rows of one sensor, each the highest amplitude of `stride` frames in a row."""

    range_m: Floats
    stride: int = 1
    rows: list[Singles] = field(default_factory=list)
    times: list[float] = field(default_factory=list)
    left: list[tuple[float, Singles]] = field(default_factory=list)

    def add(self, part: Frames, most: int) -> None:
        self.left += [(float(t) * 1e-9, row) for t, row in zip(part.t_ns, part.amplitude, strict=True)]
        while len(self.left) >= self.stride:
            batch, self.left = self.left[: self.stride], self.left[self.stride :]
            self.times.append(batch[0][0])
            self.rows.append(np.max([row for _, row in batch], axis=0))
        if len(self.rows) > most:
            pairs = zip(self.rows[::2], [*self.rows[1::2], self.rows[-1]], strict=False)
            self.rows = [np.maximum(a, b) for a, b in pairs]
            self.times = self.times[::2]
            self.stride *= 2


@dataclass(slots=True)
class RangeTime(Stage):
    """Range-time amplitude pictures of every sensor, at most `most` rows each."""

    most: int = 1200
    unit: str = "path_gain"
    _sensors: dict[str, _Pooled] = field(default_factory=dict)

    def update(self, chunk: dict[str, Frames]) -> Iterable[Any]:
        """Pool this chunk."""
        for name, part in chunk.items():
            self.unit = part.unit
            self._sensors.setdefault(name, _Pooled(part.range_m)).add(part, self.most)
        return ()

    def pictures(self) -> list[tuple[str, Floats, Floats, Floats]]:
        """Name, times [s], ranges [m] and amplitudes (n, b) of each sensor."""
        return [
            (name, np.array(p.times), p.range_m, np.array(p.rows, dtype=float))
            for name, p in self._sensors.items()
            if p.rows
        ]


@dataclass(slots=True)
class SampledFrames(Stage):
    """Keep every n-th frame of each sensor, at most `most` of each: enough to find the surfaces in sight."""

    most: int = 400
    _stride: dict[str, int] = field(default_factory=dict)
    _seen: dict[str, int] = field(default_factory=dict)
    _kept: dict[str, list[Frames]] = field(default_factory=dict)

    @property
    def received(self) -> int:
        """Frames of all sensors so far."""
        return sum(self._seen.values())

    def update(self, chunk: dict[str, Frames]) -> Iterable[Any]:
        """Keep some frames of this chunk."""
        for name, part in chunk.items():
            stride, seen = self._stride.setdefault(name, 1), self._seen.get(name, 0)
            kept = self._kept.setdefault(name, [])
            rows = np.arange(-seen % stride, len(part), stride)
            if len(rows) and makes_room(kept, part):
                kept.append(part[rows])  # a copy: a view would keep the whole chunk
            self._seen[name] = seen + len(part)
            while sum(map(len, self._kept[name])) > self.most:
                whole = joined(self._kept[name])
                self._kept[name] = [whole[np.arange(0, len(whole), 2)]]
                self._stride[name] *= 2
        return ()

    def number(self, name: str, index: int) -> int:
        """The number in the whole recording of a sensor's `index`-th kept frame."""
        return index * self._stride.get(name, 1)

    def frames(self) -> dict[str, Frames]:
        """Return the kept frames by sensor."""
        return {name: joined(parts) for name, parts in self._kept.items() if parts}


@dataclass(slots=True)
class QuietestFrames(Stage):
    """The chunk of each sensor that changes least: it shows the noise and the standing echoes of a radar at rest."""

    _best: dict[str, tuple[float, Frames]] = field(default_factory=dict)

    def update(self, chunk: dict[str, Frames]) -> Iterable[Any]:
        """Keep this chunk if it changes less than the quietest so far."""
        for name, part in chunk.items():
            if len(part) < 16 or part.ray_model:
                continue
            change = float(np.mean(np.abs(np.diff(part.samples, axis=0)) ** 2))
            if name not in self._best or change < self._best[name][0]:
                self._best[name] = change, part
        return ()

    def frames(self) -> dict[str, Frames]:
        """Return the quietest chunk of each sensor."""
        return {name: part for name, (_, part) in self._best.items()}
