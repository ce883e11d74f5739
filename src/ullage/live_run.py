"""The loop of a live run: frames are received, and obstacles found, apart from what may be slow with them.

| thread | what it does |
|---|---|
| receiving | takes frames off the source, counts them, finds obstacles, hands both on |
| one for each sink | gives it obstacles and state first, then frames and results in their order |
| main | all other stages, such as map and image; Ctrl-C |

A queue between two threads holds what is at most `lag_s` old: what cannot keep up leaves out the oldest frames, and
counts them. Kernels release Python's lock, so a map that takes long holds no other thread up.
"""

from __future__ import annotations

import sys
import threading
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np

from ullage.data import Frames, gathered
from ullage.ports.diagnostics import Status
from ullage.ports.intake import Counters, Inbox, LiveOptions
from ullage.ports.publisher import is_present
from ullage.processing.obstacles import STALE_S, ObstacleSectors, ObstacleStage
from ullage.stop_signals import StopFlag

Chunk = dict[str, Frames]
POLL_S = 0.05
"""How often the main thread looks for Ctrl-C while nothing comes [s]."""
TOGETHER = 64
"""Frames of a radar that the slow stages take at once, of those that wait."""
FRESH_S = STALE_S / 2
"""Where obstacles are found, the source leaves out frames that are later [s]: no autopilot uses obstacles that old."""
LATE_S = 1.0
"""A map that is behind by more makes `/diagnostics` a warning [s]."""
SWITCH_S = 0.001
"""Longest that a thread keeps Python's lock while another one wants it; Python's own 5 ms add up [s]."""
GATHER_S = 0.25
"""Files take what came in so long at once, and so do slow stages beside obstacles: single frames cost much more [s]."""
END_S = 5.0
"""How long the source may take to end [s]."""


class Delays:
    """Distribution of delays, to a millisecond; its memory does not grow."""

    def __init__(self) -> None:
        self._counts = np.zeros(10_001, np.int64)

    def add(self, delay_s: float) -> None:
        """Count one delay [s]."""
        self._counts[min(max(round(delay_s * 1e3), 0), len(self._counts) - 1)] += 1

    def __len__(self) -> int:
        return int(self._counts.sum())

    def within_s(self, share: float) -> float:
        """Return the time within which such a share of all was done [s]; 0 where there was none."""
        return float(np.searchsorted(np.cumsum(self._counts), share * len(self))) * 1e-3 if len(self) else 0.0


@dataclass(frozen=True, slots=True)
class LiveStatistics:
    """How well a live run kept up."""

    left_out: int = 0  # frames that came too late for map and image
    unsent: tuple[tuple[str, int], ...] = ()  # sinks, and what came too late for each
    left_out_s: float = 0.0  # received before the second Ctrl-C, and not used [s]
    most_behind_s: float = 0.0  # greatest delay of map and image behind what was received [s]
    obstacles: int = 0
    obstacle_median_s: float = 0.0  # from the arrival of a frame until its obstacles were handed over [s]
    obstacle_p99_s: float = 0.0
    obstacle_age_p99_s: float = 0.0  # the same from the stamp of the frame, where that is of this machine's clock [s]

    def lines(self) -> list[str]:
        """Return what a person should know at the end."""
        out = []
        if self.left_out_s > 0:
            out.append(f"{self.left_out_s:.1f} s of what was received are left out, as Ctrl-C came twice")
        if self.left_out:
            out.append(f"{self.left_out:,} frames came too late for map and image and were left out")
        out += [f"{name}: {count:,} frames or results came too late and were left out" for name, count in self.unsent]
        if self.most_behind_s >= LATE_S or self.left_out:
            out.append(f"map and image were up to {self.most_behind_s:.1f} s behind")
        if self.obstacles:
            age = f", {1e3 * self.obstacle_age_p99_s:.0f} ms after its stamp" if self.obstacle_age_p99_s else ""
            out.append(
                f"obstacles: median {1e3 * self.obstacle_median_s:.0f} ms, 99 % within {1e3 * self.obstacle_p99_s:.0f} "
                f"ms of their frame{age}"
            )
        return out


@dataclass(frozen=True, slots=True)
class _Piece:
    item: Any
    came_s: float


class Count(Protocol):
    """Counts what was received."""

    frames: int

    @property
    def duration_s(self) -> float:
        """Time that the frames cover [s]."""

    def add(self, chunk: Chunk) -> None:
        """Count a piece."""


class _SinkThread:
    """Gives items to one sink, in a thread of its own unless the sink needs the main one.

    Args:
        sink: takes them; one whose `gathers` is true, as files are, gets what came in a quarter of a second at once.
        counters: count what is dropped.
        lag_s: the limit of the queue; None: whoever puts must wait.
        sent: called with an item of the front, and when its frame came, once the sink has it.
    """

    def __init__(self, sink: Any, counters: Counters, lag_s: float | None, sent: Callable[[Any, float], None]) -> None:
        self.sink, self.name, self._sent = sink, type(sink).__name__, sent
        self.queue: Inbox[_Piece] = Inbox(counters, lag_s=lag_s, received=False)
        self.error: BaseException | None = None
        self._closing = False
        self._gathers = getattr(sink, "gathers", False)
        self._thread: threading.Thread | None = None
        if not getattr(sink, "main_thread", False):
            self._thread = threading.Thread(target=self._run, name=f"ullage {self.name}", daemon=True)
            self._thread.start()

    def put(self, item: Any, *, came_s: float = 0.0, count: int = 1, size: int = 0, first: bool = False) -> None:
        if self.error is None:
            self.queue.put(_Piece(item, came_s), topic=self.name, count=count, size=size, first=first)

    def write_waiting(self, timeout_s: float = 0.0) -> None:
        """Give the sink what waits."""
        found = self.queue.get(timeout_s)
        while found is not None:
            item, after = _joined(found, self.queue) if self._gathers else (found.item, None)
            self.sink.write(item)
            if found.came_s:
                self._sent(found.item, found.came_s)
            found = after or self.queue.get(0.0)

    def finish(self) -> None:
        """Give the sink all that waits, however old, and end the thread."""
        self.queue.lag_s, self._closing = None, True
        if self._thread is None:
            self.write_waiting()
        else:
            self._thread.join()

    def _run(self) -> None:
        try:
            while True:
                closing = self._closing
                if self._gathers and not closing:
                    time.sleep(GATHER_S)
                self.write_waiting(0.0 if closing or self._gathers else POLL_S)
                if closing:
                    return
        except BaseException as error:  # raised in the main thread
            self.error = error


class LiveLoop:
    """One live run.

    Args:
        source: a live port.
        stages: obstacles are found where frames are received, also for sinks alone that take them; the others work in
            the main thread.
        sinks: take frames and results; the caller closes them.
        count: of what was received.
    """

    def __init__(self, source: Any, stages: Sequence[Any], sinks: Sequence[Any], count: Count) -> None:
        self._source, self._count = source, count
        self._first = [stage for stage in stages if isinstance(stage, ObstacleStage)]
        self._later = [stage for stage in stages if not isinstance(stage, ObstacleStage)]
        self._lag_s: float | None = getattr(source, "lag_s", LiveOptions().lag_s)
        self.counters = Counters()
        self._backlog: Inbox[_Piece] = Inbox(self.counters, lag_s=self._lag_s, received=False)
        self._delays, self._ages = Delays(), Delays()
        takers = [sink for sink in sinks if getattr(sink, "takes_obstacles", False)]
        self._obstacles_to = list(sinks) if self._first else takers
        if takers and not self._first:
            self._first = [ObstacleStage()]
        self._urgent = bool(self._first)
        if self._urgent and (trial := getattr(source, "trial", {})):
            list(ObstacleStage().update(trial))  # thresholds and kernels take a second the first time
        self._sends = any(getattr(sink, "sends", False) for sink in sinks)
        self._sink_threads = [_SinkThread(sink, self.counters, self._lag_s, self._noting(sink)) for sink in sinks]
        self.interrupted = False
        self._received = threading.Event()  # no more frames come
        self._abandoned = False
        self._error: BaseException | None = None
        self._held: _Piece | None = None  # does not go with the piece before it
        self._working_s: float | None = None  # when the piece came that the slow stages have
        self._newest_ns = 0
        self._done_ns: int | None = None
        self._most_behind_s = 0.0
        self._status = Status("ullage: run")
        self._reported_lost = 0
        self._on_lag: Callable[[float, int], None] | None = None

    @property
    def behind_s(self) -> float:
        """How old the oldest frame is that map and image lack [s]."""
        now, since = time.monotonic(), self._working_s
        waits_s = max(self._backlog.behind_s, now - since if since is not None else 0.0)
        return waits_s + float(getattr(self._source, "behind_s", 0.0))

    def run(
        self, progress: Callable[[float], None] | None, on_lag: Callable[[float, int], None] | None
    ) -> tuple[Any, ...]:
        """Receive until the source ends or Ctrl-C; return what the stages gave at the end.

        The first Ctrl-C ends the source, and what was received is worked off. The second one ends that too.
        """
        self._on_lag = on_lag
        passing = self._source.passing
        passing.to(lambda item: self._publish(item, first=True))
        if self._lag_s and (keep_up := getattr(self._source, "keep_up", None)) is not None:
            keep_up(min(self._lag_s, FRESH_S) if self._urgent else self._lag_s)
        thread = threading.Thread(target=self._receive, name="ullage receiving", daemon=True)
        with _short_turns(), StopFlag(raises_at=3) as stop:
            thread.start()
            try:
                while self._continues(stop):
                    before = self._received.is_set()
                    if (chunk := self._next()) is None:
                        if before:
                            break
                        continue
                    for stage in self._later:
                        for item in stage.update(chunk):
                            self._publish(item)
                    self._done(chunk)
                    if progress is not None:
                        progress(self._count.duration_s)
                    if on_lag is not None:
                        on_lag(self.behind_s, self._backlog.lost)
            finally:  # an instrument must not go on for a run that was refused
                self._end(thread)
            return self._finish()

    def _continues(self, stop: StopFlag) -> bool:
        """Whether frames are still used; hands the wish to end on to the source."""
        for thread in self._sink_threads:
            if thread.error is not None:
                raise thread.error
        if self._error is not None:
            raise self._error
        if stop.requested and not self.interrupted:
            self.interrupted = True
            self._backlog.lag_s = None
            if (end := getattr(self._source, "stop", None)) is not None:
                end()
            else:
                self._abandoned = True
        return stop.count < 2

    def _receive(self) -> None:
        """Receive in a thread of its own: obstacles first, then hand the frames on."""
        stream = self._source.stream()
        try:
            for chunk in stream:
                if chunk:
                    self._take(chunk)
                if self._abandoned:
                    break
        except KeyboardInterrupt:
            self.interrupted = True
        except BaseException as error:
            self._error = error
        finally:
            if hasattr(stream, "close"):
                stream.close()
            self._received.set()

    def _take(self, chunk: Chunk) -> None:
        came_s = time.monotonic()
        for stage in self._first:
            for item in stage.update(chunk):
                self._publish(item, came_s=came_s, to=self._obstacles_to)
        count, size = sum(map(len, chunk.values())), sum(part.samples.nbytes for part in chunk.values())
        self._count.add(chunk)
        self._done_ns = self._done_ns if self._done_ns is not None else min(int(p.t_ns[0]) for p in chunk.values())
        self._newest_ns = max(int(part.t_ns[-1]) for part in chunk.values())
        for thread in self._sink_threads:
            thread.put(chunk, count=count, size=size)
        self._backlog.put(_Piece(chunk, came_s), topic="map and image", count=count, size=size)
        while self._lag_s is None and not self._abandoned and self._full():
            time.sleep(POLL_S)
        self._report()

    def _full(self) -> bool:
        """Whether a queue that drops nothing has no room."""
        return any(
            queue.full
            for queue in (self._backlog, *(thread.queue for thread in self._sink_threads if not thread.error))
        )

    def _publish(self, item: Any, *, came_s: float = 0.0, first: bool = False, to: Sequence[Any] | None = None) -> None:
        """Hand an item to these sinks, or to all; obstacles and state overtake frames and maps."""
        if came_s and not self._sends:
            self._note(item, came_s)
        for thread in self._sink_threads:
            if to is None or thread.sink in to:
                thread.put(item, came_s=came_s, first=first or came_s > 0)

    def _noting(self, sink: Any) -> Callable[[Any, float], None]:
        return self._note if getattr(sink, "sends", False) else lambda item, came_s: None

    def _note(self, item: Any, came_s: float) -> None:
        self._delays.add(time.monotonic() - came_s)
        if isinstance(item, ObstacleSectors) and is_present(item.t_ns):
            self._ages.add(time.time() - item.t_ns * 1e-9)

    def _next(self) -> Chunk | None:
        """Return what waits for the slow stages, as one piece; None where nothing does."""
        for thread in self._sink_threads:
            if getattr(thread.sink, "main_thread", False):
                thread.write_waiting()
        self._working_s = None
        if (found := self._held or self._backlog.get(POLL_S)) is None:
            return None
        self._working_s = found.came_s
        if self._urgent:
            time.sleep(max(0.0, found.came_s + GATHER_S - time.monotonic()))
        chunk: Chunk
        chunk, self._held = _joined(found, self._backlog)
        return chunk

    def _done(self, chunk: Chunk) -> None:
        self._done_ns = max(int(part.t_ns[-1]) for part in chunk.values())
        self._most_behind_s = max(self._most_behind_s, self.behind_s)

    def _report(self) -> None:
        """Say once a second, also on `/diagnostics`, how far map and image are behind, however long they take."""
        if not self._status.is_due():
            return
        behind_s, lost = self.behind_s, self._backlog.lost
        if self._on_lag is not None:
            self._on_lag(behind_s, lost)
        late = behind_s > LATE_S or lost > self._reported_lost
        self._reported_lost = lost
        text = f"map and image are {behind_s:.1f} s behind" if late else "map and image keep up"
        values = [
            ("behind [s]", f"{behind_s:.3f}"),
            ("frames", str(self._count.frames)),
            ("frames left out", str(lost)),
            ("obstacles: 99 % within [s]", f"{self._delays.within_s(0.99):.3f}"),
        ]
        self._publish(self._status.told(self._newest_ns, int(late), text, values), first=True)

    def _end(self, thread: threading.Thread) -> None:
        """End the source where it has not ended by itself."""
        if not self._received.is_set():
            self._abandoned = True
            if (close := getattr(self._source, "close", None)) is not None:
                close()
        thread.join(END_S)
        self._source.passing.to(lambda item: None)

    def _finish(self) -> tuple[Any, ...]:
        if self._error is not None and not self._abandoned:
            raise self._error
        results = tuple(item for stage in (*self._first, *self._later) for item in stage.finish())
        for item in results:
            self._publish(item)
        for thread in self._sink_threads:
            thread.finish()
            if thread.error is not None:
                raise thread.error
        return results

    def statistics(self) -> LiveStatistics:
        """How well the run kept up."""
        rest = len(self._backlog) > 0 or self._held is not None
        left_out_s = (self._newest_ns - (self._done_ns or 0)) * 1e-9 if rest else 0.0
        unsent = tuple((thread.name, thread.queue.lost) for thread in self._sink_threads if thread.queue.lost)
        return LiveStatistics(
            self._backlog.lost, unsent, left_out_s, self._most_behind_s, len(self._delays), self._delays.within_s(0.5),
            self._delays.within_s(0.99), self._ages.within_s(0.99),
        )  # fmt: skip


def _joined(first: _Piece, queue: Inbox[_Piece]) -> tuple[Any, _Piece | None]:
    """Return an item, frames with those that wait behind them; and the next piece, where it does not go with them."""
    items, after = [first.item], None
    while isinstance(first.item, dict) and len(items) < TOGETHER and (after := queue.get(0.0)) is not None:
        if not (isinstance(after.item, dict) and _go_together(items[-1], after.item)):
            break
        items.append(after.item)
        after = None
    return items[0] if len(items) == 1 else gathered(items), after


def _go_together(before: Chunk, after: Chunk) -> bool:
    """Whether two pieces can be one: the radars in both have the same settings, and their clock rises."""
    both = [(before[name], after[name]) for name in before.keys() & after.keys()]
    return all(
        (a.spec, a.unit, a.poses is None, a.track, a.calibration)
        == (b.spec, b.unit, b.poses is None, b.track, b.calibration)
        and np.array_equal(a.range_m, b.range_m)
        and a.t_ns[-1] < b.t_ns[0]
        for a, b in both
    )


@contextmanager
def _short_turns() -> Iterator[None]:
    """Let threads pass Python's lock on sooner."""
    before = sys.getswitchinterval()
    sys.setswitchinterval(SWITCH_S)
    try:
        yield
    finally:
        sys.setswitchinterval(before)
