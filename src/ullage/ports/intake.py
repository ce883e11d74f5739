"""Handle incoming data by one policy: count bad messages, check clocks, hold frames until their poses are known.

Every live port and every reader of recordings uses these objects. None of them knows a middleware.

- `Inbox` holds what one thread gives another, and bounds its number, bytes and age; `LiveOptions` set the age.
- `Worker` is such a thread: its error is raised where what it gives is taken.
- `Counters` counts the messages that were used and dropped, by topic and reason, and reports them.
- `Clock` gives times that rise, although the source's clock may step or a single stamp may be wrong.
- `checked_pose` accepts finite positions and unit quaternions only; `echo_range` ranges within a sensor's limits.
- `PoseQueue` holds frames until their poses are known, for a bounded time and in a bounded number.
"""

from __future__ import annotations

import math
import threading
import time
import warnings
from collections import Counter, deque
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from typing import Any, Generic, Literal, NamedTuple, TypeVar, get_args

import numpy as np
from numpy.typing import ArrayLike
from pydantic import Field

from ullage.arrays import Floats
from ullage.errors import InputError, UllageWarning, one_line
from ullage.specs import Spec

Log = Callable[[str], None]
"""Takes one line for a person."""
Reason = Literal["bad", "late", "lost", "duplicate", "no pose"]
"""Why a message is dropped.

bad: it cannot be read, or holds values that cannot be. late: older than one that was used. lost: no room was left, or
it never arrived. duplicate: the same stamp came twice. no pose: nothing gave the pose of a frame in time.
"""
REASONS: tuple[Reason, ...] = get_args(Reason)

GAP_NS = 2_000_000_000
"""Two stamps of one stream farther apart than this belong to two tracks."""
LATE_NS = 100_000_000
"""A stamp that lies behind by less than this came late; by more, the clock may have stepped back."""
PAUSE_NS = 100_000_000
"""Between two tracks, where the second one's own stamps would not lie behind the first one's."""
LATEST_NS = 2**62
"""Stamps beyond the year 2116 are bad: their sums would not fit 64 bits."""
MOST_TOPICS = 64
"""Topics that are counted by name; further ones are counted together."""
OTHERS = "other topics"
UNIT_TOLERANCE = 0.01
"""How far the squared norm of a quaternion may be from 1, as in tf2."""
MOST_CAUSES, MOST_LETTERS = 3, 120
"""Causes that are kept of each topic and reason, and their length."""
MOST_KINDS = 256
"""Kinds of lines that `Once` tells apart; further ones are not logged."""
MOST_STEPS = 10
"""Steps of a clock that are reported as they come; later ones at the rate of other reports."""
REPORT_S = 5.0
"""Least time between two reports on the same topic and reason [s]; it doubles with each one up to `RARELY_S`."""
RARELY_S = 60.0
PIECE_S = 0.1
"""Most that is simulated at once of what waits, so that what follows does not get old meanwhile [s]."""
PATIENCE_S = 5.0
"""Wall time between two log lines of the same kind, and before the first line that nothing comes [s]."""


class LiveOptions(Spec):
    """Options of every live source."""

    lag: float = Field(
        2.0, ge=0, description="frames later than so many seconds are left out, the oldest first; 0: none are"
    )

    @property
    def lag_s(self) -> float | None:
        """The limit [s]; None: nothing is left out."""
        return self.lag or None


def warn(text: str) -> None:
    """Issue a warning: what a port logs to where the caller gives no log."""
    warnings.warn(text, UllageWarning, stacklevel=3)


class Once:
    """Logs a line of each kind once; memory is bounded whatever a stranger sends.

    Args:
        log: takes the lines.
    """

    def __init__(self, log: Log = warn) -> None:
        self._log, self._kinds = log, set[str]()

    def __call__(self, text: str, *, kind: str = "") -> None:
        """Log a line, unless one of its kind was logged before; each text is a kind of its own unless named."""
        if (kind or text) not in self._kinds and len(self._kinds) < MOST_KINDS:
            self._kinds.add(kind or text)
            self._log(text)

    def again(self, kind: str) -> None:
        """Let a kind be logged once more."""
        self._kinds.discard(kind)


class _Entry(NamedTuple):
    topic: str
    reason: Reason


@dataclass(slots=True)
class _Reported:
    """Last report of one topic and reason."""

    count: int = 0
    next_s: float = 0.0
    wait_s: float = REPORT_S


class Counters:
    """Counts used and dropped messages by topic and reason; memory does not grow with the number of topics.

    Safe to use from several threads; only `report` and `step` call the log.

    Args:
        log: takes one line for a person; None: nothing is reported until `log` is set.
        now: gives the time that limits the rate of reports [s].
    """

    def __init__(self, log: Log | None = None, *, now: Callable[[], float] = time.monotonic) -> None:
        self.log, self._now = log or (lambda text: None), now
        self._lock = threading.Lock()
        self._received: Counter[str] = Counter()
        self._dropped: Counter[_Entry] = Counter()
        self._causes: dict[_Entry, list[str]] = {}
        self._reported: dict[_Entry, _Reported] = {}
        self._steps = 0

    def receive(self, topic: str, count: int = 1) -> None:
        """Count messages that arrived, used or not."""
        with self._lock:
            self._received[self._name(topic)] += count

    def drop(self, topic: str, reason: Reason, cause: str = "", *, count: int = 1) -> None:
        """Count messages that are not used.

        Args:
            topic: or sensor that they came from.
            reason: why.
            cause: what exactly is wrong; the first few different ones are reported.
            count: how many.
        """
        if count <= 0:
            return
        with self._lock:
            entry = _Entry(self._name(topic), reason)
            self._dropped[entry] += count
            known = self._causes.setdefault(entry, [])
            if cause and len(known) < MOST_CAUSES and (short := cause[:MOST_LETTERS]) not in known:
                known.append(short)

    @contextmanager
    def reading(self, topic: str) -> Iterator[None]:
        """Count a message that cannot be read, whatever error a stranger's bytes cause, and go on after the block."""
        try:
            yield
        except Exception as error:
            text = one_line(str(error), most=MOST_LETTERS)
            refused = isinstance(error, InputError) and text
            self.drop(topic, "bad", text if refused else f"cannot be read: {type(error).__name__} {text}".strip())

    def step(self, text: str) -> None:
        """Count a step of a clock, and report it unless the clock steps all the time."""
        with self._lock:
            self._steps += 1
            frequent = self._too_soon(_Entry("clock steps", "late"), self._steps) and self._steps > MOST_STEPS
        if not frequent:
            self.log(text)

    @property
    def steps(self) -> int:
        """Number of steps of a clock."""
        return self._steps

    def dropped(self, reason: Reason | None = None, *, topic: str | None = None) -> int:
        """Number of dropped messages, of all reasons and topics or of one."""
        with self._lock:
            return sum(
                count for entry, count in self._dropped.items()
                if reason in (None, entry.reason) and topic in (None, entry.topic)
            )  # fmt: skip

    def received(self, topic: str | None = None) -> int:
        """Number of messages that arrived, on all topics or on one."""
        with self._lock:
            return self._received[topic] if topic is not None else sum(self._received.values())

    def report(self) -> None:
        """Report what was dropped since the last report: the first time at once, later ones ever more rarely."""
        with self._lock:
            due = [entry for entry, count in self._dropped.items() if not self._too_soon(entry, count)]
            lines = [f"{entry.topic}: dropped {self._counted(entry)}" for entry in due]
        for line in lines:
            self.log(line)

    def lines(self) -> list[str]:
        """One line for each topic that lost messages, for the end of a run; empty where none did."""
        with self._lock:
            topics = sorted({entry.topic for entry in self._dropped})
            lines = [f"{topic}: {self._of(topic)}" for topic in topics]
            if self._steps > 1:  # one was reported when it came
                lines.append(f"the clock stepped {'twice' if self._steps == 2 else f'{self._steps:,} times'}")
        return lines

    def values(self) -> list[tuple[str, str]]:
        """Return the counts as pairs of key and value, for `/diagnostics`."""
        with self._lock:
            topics = sorted({entry.topic for entry in self._dropped} | self._received.keys())
            pairs = []
            for topic in topics:
                pairs.append((f"{topic}: received", str(self._received[topic])))
                pairs += [
                    (f"{topic}: {reason}", str(self._dropped[_Entry(topic, reason)]))
                    for reason in REASONS if self._dropped[_Entry(topic, reason)]
                ]  # fmt: skip
            return [*pairs, ("clock steps", str(self._steps))]

    def _name(self, topic: str) -> str:
        known = self._received.keys() | {entry.topic for entry in self._dropped}
        return topic if topic in known or len(known) < MOST_TOPICS else OTHERS

    def _too_soon(self, entry: _Entry, count: int) -> bool:
        """Whether a report must wait; takes note of it where not."""
        state, now = self._reported.setdefault(entry, _Reported()), self._now()
        if count == state.count or (state.count and now < state.next_s):
            return True
        state.wait_s = min(2 * state.wait_s, RARELY_S) if state.count else REPORT_S
        state.count, state.next_s = count, now + state.wait_s
        return False

    def _counted(self, entry: _Entry) -> str:
        causes = "; ".join(self._causes[entry])
        return f"{self._dropped[entry]:,} {entry.reason}" + (f" ({causes})" if causes else "")

    def _of(self, topic: str) -> str:
        entries = (_Entry(topic, reason) for reason in REASONS)
        dropped = ", ".join(self._counted(entry) for entry in entries if self._dropped[entry])
        received = self._received[topic]
        return f"dropped {dropped}" + (f", of {received:,} received" if received else "")


ItemT = TypeVar("ItemT")


class Stamped(NamedTuple, Generic[ItemT]):
    """A message with its time on a clock that rises."""

    item: ItemT
    t_ns: int
    """Time given on [ns]; later than that of every message before it in this stream."""
    stamp_ns: int
    """The source's own time [ns]."""
    track: int
    """Number of its track, from 0."""
    starts: bool
    """Whether it is the first of its track; what was known before it, such as a speed, does not hold."""


@dataclass(slots=True, eq=False)
class _Epoch:
    """A span of the source's clock without steps."""

    offset_ns: int  # from a stamp to the time given on
    newest_ns: int  # newest stamp of all streams


class Clock:
    """The clock of one source, which several streams share.

    A step of the clock is reported once, by the first stream that meets it; the other streams follow it. Times given
    on are the source's own, unless those have come before; then an offset is added until the clock is ahead again.

    Args:
        counters: count what is dropped, and report steps.
    """

    def __init__(self, counters: Counters) -> None:
        self.counters = counters
        self._epoch: _Epoch | None = None
        self._last_given_ns: int | None = None  # newest time given on, of all streams
        self._left_out = 0  # messages that found no room or waited too long, up to the last step

    def stream(self, topic: str) -> Stream[Any]:
        """A stream of messages with stamps of this clock."""
        return Stream(self, topic)

    @property
    def newest_ns(self) -> int:
        """Newest stamp of all streams since the clock last stepped; 0 before the first."""
        return self._epoch.newest_ns if self._epoch is not None else 0

    def near(self, stamp_ns: int) -> bool:
        """Whether a stream may begin with this stamp: no other has begun, or the others' stamps are near."""
        return self._epoch is None or abs(stamp_ns - self._epoch.newest_ns) <= GAP_NS

    def _enter(self, stream: Stream[Any], stamp_ns: int) -> _Epoch:
        """The epoch of a stamp that begins a track of a stream."""
        epoch, before_ns = self._epoch, stream.last_ns
        falls = epoch is stream.epoch and before_ns is not None and stamp_ns < before_ns
        if epoch is not None and self.near(stamp_ns) and not falls:
            return epoch  # only this stream paused, or another one has met the step before
        offset_ns = 0
        if self._last_given_ns is not None and stamp_ns <= self._last_given_ns:
            offset_ns = self._last_given_ns + PAUSE_NS - stamp_ns
        if epoch is not None:
            step_s = (stamp_ns - (epoch.newest_ns if before_ns is None else before_ns)) * 1e-9
            step = f"back {-step_s:.3g} s" if step_s < 0 else f"ahead {step_s:.3g} s"
            lost, before = self.counters.dropped("lost"), self._left_out
            why = f", {lost - before:,} messages were left out before" if lost > before else ""
            self._left_out = lost
            self.counters.step(f"time jumped {step} ({stream.topic}){why}: a new track begins, the map goes on")
        self._epoch = _Epoch(offset_ns, stamp_ns)
        return self._epoch

    def _advance(self, epoch: _Epoch, stamp_ns: int) -> int:
        epoch.newest_ns = max(epoch.newest_ns, stamp_ns)
        t_ns = stamp_ns + epoch.offset_ns
        self._last_given_ns = t_ns if self._last_given_ns is None else max(self._last_given_ns, t_ns)
        return t_ns


class Stream(Generic[ItemT]):
    """Messages of one topic, whose stamps should rise.

    A stamp that does not follow on the one before waits for the next message. If that one repeats it or follows on it,
    the clock has stepped or messages are missing: a new track begins. If not, the single stamp was wrong, and its
    message is dropped.

    Args:
        clock: of the source.
        topic: name for counts and reports.
    """

    def __init__(self, clock: Clock, topic: str) -> None:
        self.topic = topic
        self._clock, self._counters = clock, clock.counters
        self.epoch: _Epoch | None = None
        self.last_ns: int | None = None  # the last stamp used
        self._last_given_ns: int | None = None  # the last time given on
        self._waiting: tuple[int, ItemT] | None = None
        self.track = -1
        self.elapsed_ns = 0
        """Time covered by the tracks so far, without what lies between them [ns]."""

    def take(self, stamp_ns: int, item: ItemT) -> list[Stamped[ItemT]]:
        """Take one message and give those that can be used now: none, itself, or one that waited and itself.

        Args:
            stamp_ns: its time by the source's clock [ns].
            item: whatever it holds.
        """
        if not 0 <= stamp_ns <= LATEST_NS:
            self._counters.drop(self.topic, "bad", f"stamp {stamp_ns * 1e-9:.6g} s")
            return []
        if self._waiting is not None:
            return self._resolve(stamp_ns, item)
        if self.last_ns is None:
            if self._clock.near(stamp_ns):
                return self._begin(stamp_ns, item)
            self._waiting = stamp_ns, item
            return []
        ahead_ns = stamp_ns - self.last_ns
        if ahead_ns == 0:
            self._counters.drop(self.topic, "duplicate")
        elif -LATE_NS < ahead_ns < 0:
            self._counters.drop(self.topic, "late")
        elif 0 < ahead_ns <= GAP_NS:
            self.elapsed_ns += ahead_ns
            return self._give(stamp_ns, item, starts=False)
        else:
            self._waiting = stamp_ns, item
        return []

    def finish(self) -> None:
        """Drop what still waits, since no message will confirm it."""
        self._discard()

    def _resolve(self, stamp_ns: int, item: ItemT) -> list[Stamped[ItemT]]:
        """Decide on the message that waits, by the one after it."""
        assert self._waiting is not None
        waiting_ns, waiting = self._waiting
        before_ns = self._before_ns()
        goes_on = 0 < stamp_ns - before_ns <= GAP_NS
        nearer = 0 <= stamp_ns - waiting_ns < max(GAP_NS + 1, abs(stamp_ns - before_ns))
        if nearer and not goes_on:
            self._waiting = None
            return self._begin(waiting_ns, waiting) + self.take(stamp_ns, item)
        self._discard()
        return self.take(stamp_ns, item)

    def _before_ns(self) -> int:
        """What the next stamp should follow on: this stream's last one, or the clock's where the stream begins."""
        return self.last_ns if self.last_ns is not None else self._clock.newest_ns

    def _discard(self) -> None:
        if self._waiting is None:
            return
        away_ns = self._waiting[0] - self._before_ns()
        reason: Reason = "late" if -GAP_NS < away_ns < 0 else "bad"
        self._counters.drop(self.topic, reason, f"a single stamp {away_ns * 1e-9:+.6g} s away")
        self._waiting = None

    def _begin(self, stamp_ns: int, item: ItemT) -> list[Stamped[ItemT]]:
        self.epoch = self._clock._enter(self, stamp_ns)
        return self._give(stamp_ns, item, starts=True)

    def _give(self, stamp_ns: int, item: ItemT, *, starts: bool) -> list[Stamped[ItemT]]:
        assert self.epoch is not None
        self.last_ns = stamp_ns
        if self._last_given_ns is not None and stamp_ns + self.epoch.offset_ns <= self._last_given_ns:
            # another stream began this span of the clock; this one had already gone on beyond that
            self.epoch = _Epoch(self._last_given_ns + PAUSE_NS - stamp_ns, stamp_ns)
        self.track += starts
        self._last_given_ns = self._clock._advance(self.epoch, stamp_ns)
        return [Stamped(item, self._last_given_ns, stamp_ns, self.track, starts)]


class Covered:
    """The time that stamps cover, without the gaps between tracks; stamps that lie behind earlier ones add nothing.

    Args:
        gap_ns: a longer step between two stamps is a gap [ns].
    """

    def __init__(self, gap_ns: int = GAP_NS) -> None:
        self._gap_ns, self._last_ns, self._sum_ns = gap_ns, -1, 0
        self.total_s = 0.0
        """Time covered so far [s]."""

    def take(self, t_ns: ArrayLike) -> None:
        """Take the next stamps (n) [ns]."""
        times = np.atleast_1d(np.asarray(t_ns, np.int64))
        if not len(times):
            return
        first = int(times[0]) if self._last_ns < 0 else self._last_ns
        newest = np.maximum(np.maximum.accumulate(times), first)
        steps = np.diff(newest, prepend=first)
        self._last_ns = int(newest[-1])
        self._sum_ns += int(steps[steps <= self._gap_ns].sum())
        self.total_s = self._sum_ns * 1e-9


def checked_pose(position: ArrayLike, quat_xyzw: ArrayLike) -> tuple[Floats, Floats] | str:
    """The pose with a quaternion of unit length, or what is wrong with it.

    Args:
        position: (3) [m].
        quat_xyzw: (4).

    Returns:
        Position (3) and unit quaternion (4); a short text where the pose cannot be used.
    """
    at, turn = np.asarray(position, np.float64), np.asarray(quat_xyzw, np.float64)
    if not np.isfinite(at).all():
        return "position is not finite"
    if not np.isfinite(turn).all():
        return "quaternion is not finite"
    square = float(turn @ turn)
    if abs(square - 1) > UNIT_TOLERANCE:
        return "quaternion is not of unit length"
    return at, turn / np.sqrt(square)


def echo_range(range_m: ArrayLike, low_m: float, high_m: float) -> Floats:
    """Ranges as a sensor reports them, inf where it met nothing: beyond its own limits nothing is measured (REP-117).

    Raises:
        InputError: the limits are none.
    """
    if not (math.isfinite(low_m) and math.isfinite(high_m) and low_m <= high_m):
        raise InputError(f"range limits of {low_m:g} and {high_m:g} m", where="range", allowed="least <= most, finite")
    measured = np.asarray(range_m, np.float64)
    return np.where((measured >= low_m) & (measured <= high_m), measured, np.inf)


class _Waiting(NamedTuple, Generic[ItemT]):
    item: ItemT
    topic: str
    size: int
    number: int
    came_s: float


class Inbox(Generic[ItemT]):
    """The queue between two threads of a live run, bounded in number, bytes and time.

    What finds no room, or waits longer than the limit, is dropped and counted, the oldest first: so what is used is of
    now, however slow the user is.

    Args:
        counters: count what is dropped.
        most: items that may wait.
        most_bytes: their size together [bytes].
        lag_s: an item waits no longer than this [s]; None: as long as there is room.
        received: count what comes too, unless somebody else does.
        now: gives the time [s].
    """

    def __init__(
        self, counters: Counters, *, most: int = 200_000, most_bytes: int = 256 * 2**20, lag_s: float | None = None,
        received: bool = True, now: Callable[[], float] = time.monotonic,
    ) -> None:  # fmt: skip
        self._counters, self._most, self._most_bytes, self._now = counters, most, most_bytes, now
        self.lag_s, self._received = lag_s, received
        self.lost = 0
        """What was dropped so far."""
        self._first: deque[_Waiting[ItemT]] = deque()
        self._waiting: deque[_Waiting[ItemT]] = deque()
        self._bytes = 0
        self._changed = threading.Condition()

    def put(self, item: ItemT, *, topic: str = "", size: int = 0, count: int = 1, first: bool = False) -> None:
        """Add an item; the oldest ones are dropped where no room is left.

        Args:
            item: what came.
            topic: for the counts; empty: news of the connection, which is never dropped.
            size: of the item [bytes].
            count: messages or frames that it stands for.
            first: it overtakes what waits, but not others that are first.
        """
        if topic and self._received:
            self._counters.receive(topic, count)
        with self._changed:
            (self._first if first else self._waiting).append(_Waiting(item, topic, size, count, self._now()))
            self._bytes += size
            while (len(self) > self._most or self._bytes > self._most_bytes) and self._drop_oldest():
                pass
            self._changed.notify()

    def get(self, timeout_s: float) -> ItemT | None:
        """The oldest item that has not waited too long; None where none comes for so long."""
        with self._changed:
            if not len(self):
                self._changed.wait_for(lambda: len(self) > 0, timeout_s)
            while len(self):
                found = (self._first or self._waiting).popleft()
                self._bytes -= found.size
                if not (found.topic and self.lag_s and self._now() - found.came_s > self.lag_s):
                    return found.item
                self._drop(found, f"waited longer than {self.lag_s:g} s")
            return None

    @property
    def full(self) -> bool:
        """Whether more than half of the room is taken."""
        return 2 * len(self) > self._most or 2 * self._bytes > self._most_bytes

    @property
    def behind_s(self) -> float:
        """How long the oldest item waits already [s]."""
        with self._changed:
            return self._now() - self._waiting[0].came_s if self._waiting else 0.0

    def _drop_oldest(self) -> bool:
        """Drop the oldest item that may be dropped; whether there was one."""
        for line in (self._waiting, self._first):
            for place, found in enumerate(line):
                if found.topic:
                    del line[place]
                    self._bytes -= found.size
                    self._drop(found, "messages come faster than they are used")
                    return True
        return False

    def _drop(self, found: _Waiting[ItemT], cause: str) -> None:
        self.lost += found.number
        self._counters.drop(found.topic, "lost", cause, count=found.number)

    def clear(self) -> None:
        """Forget what waits."""
        with self._changed:
            self._first.clear()
            self._waiting.clear()
            self._bytes = 0

    def __len__(self) -> int:
        return len(self._first) + len(self._waiting)


class Worker(threading.Thread):
    """A thread that ends with its first error.

    Args:
        work: what it does until its end.
        name: of the thread.
        failed: called after an error, to wake those who wait for the thread.
    """

    def __init__(self, work: Callable[[], None], name: str, *, failed: Callable[[], None] = lambda: None) -> None:
        super().__init__(name=name, daemon=True)
        self._work, self._failed = work, failed
        self.error: BaseException | None = None

    def run(self) -> None:
        """Work, and keep the error."""
        try:
            self._work()
        except BaseException as error:
            self.error = error
            self._failed()

    def check(self) -> None:
        """Raise the error, if there was one; for those who take what the thread gives."""
        if self.error is not None:
            raise self.error


Placed = TypeVar("Placed")


class Place(NamedTuple, Generic[Placed]):
    """State of the pose of a frame."""

    status: Literal["known", "wait", "never"]
    pose: Placed | None = None
    missing: str = ""
    """What it waits for, or why it never comes."""


@dataclass(slots=True)
class PoseQueue(Generic[ItemT]):
    """Frames of one sensor that wait for their poses, oldest first.

    Args:
        counters: count what is dropped.
        topic: or sensor, for the counts.
        patience_s: a frame waits no longer than this [s].
        most: no more frames than this wait; the oldest is dropped.
        keeps: frames whose pose does not come are given without one.
    """

    counters: Counters
    topic: str
    patience_s: float = 2.0
    most: int = 4096
    keeps: bool = False
    waits_for: str = ""
    """What the oldest frame waits for; empty: nothing waits."""
    _frames: deque[tuple[float, ItemT]] = field(default_factory=deque)  # when it came [s]

    def __len__(self) -> int:
        return len(self._frames)

    def put(self, frame: ItemT, now_s: float) -> None:
        """Add a frame that came at `now_s`."""
        self._frames.append((now_s, frame))
        if len(self._frames) > self.most:
            self._frames.popleft()
            self.counters.drop(self.topic, "no pose", f"more than {self.most} frames wait")

    def ready(self, place: Callable[[ItemT], Place[Any]], now_s: float) -> Iterator[tuple[ItemT, Any]]:
        """Frames whose pose is known, in order, each with its pose; others are dropped, unless the queue keeps them.

        Args:
            place: gives what is known of a frame's pose.
            now_s: the time on the clock of `put` [s].
        """
        self.waits_for = ""
        while self._frames:
            came_s, frame = self._frames[0]
            answer = place(frame)
            if answer.status == "wait" and now_s - came_s <= self.patience_s:
                self.waits_for = answer.missing or "a pose"
                return
            self._frames.popleft()
            if answer.status == "known" or self.keeps:
                yield frame, answer.pose
            else:
                self.counters.drop(self.topic, "no pose", answer.missing)

    def clear(self, cause: str = "no pose will come") -> None:
        """Drop all waiting frames, as at the end of a run."""
        self.counters.drop(self.topic, "no pose", cause, count=len(self._frames))
        self._frames.clear()
