"""Several instruments as one source, in order of time, and their frames at the poses that another port gives.

Each instrument has a reader, and the poses have one. What they give meets in one inbox. A frame waits until every
instrument that gives frames has given later ones, and until poses before and after it are known. Both waits are
bounded.
"""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace
from functools import partial
from itertools import groupby
from typing import Any, NamedTuple

from ullage.arrays import Floats
from ullage.data import Frames, Trajectory, joined
from ullage.errors import InputError, one_line
from ullage.ports.cosimulation import rig_of
from ullage.ports.instruments.source import BATCH_S, RETRY_S, InstrumentClock, InstrumentSource, NotReadyError
from ullage.ports.intake import PATIENCE_S, Counters, Inbox, Log, Place, PoseQueue, checked_pose
from ullage.ports.live import INSTRUMENTS, LISTED_POSES, Address, LiveSource
from ullage.ports.pose_events import BodyState, ModelPose, PoseTrack, TimedPose, path_through
from ullage.ports.protocol import of_one_kind
from ullage.ports.publisher import is_present
from ullage.specs import Rig

FIRST_POSE_S = 30.0
"""How long frames wait for the first pose of all [s]."""
POSE_S = 1.0
"""How long they wait for later ones; longer gaps are not interpolated [s]."""
ORDER_S = 0.5
"""An instrument that gave nothing for so long is not waited for [s]."""
MOST = 100_000
"""Frames of a radar that wait: half a minute of the fastest."""


class _Row(NamedTuple):
    """One frame that waits."""

    t_ns: int
    part: Frames
    number: int  # in its part


class _Pose(NamedTuple):
    """One pose as it came."""

    pose: ModelPose | BodyState
    arrived_s: float  # on this computer's clock [s]


class InstrumentGroup(LiveSource):
    """Frames of several instruments, in order of time.

    An instrument that is not ready is waited for, as long as another one measures.

    Args:
        addresses: of the instruments; each has a name of its own.
        poses: of what gives poses of the body that carries them; None: frames have none.
        log: takes lines for the user; None: they become warnings.

    Raises:
        InputError: two instruments have one name, none is ready, or an option or the place of the poses cannot be used.
    """

    def __init__(self, addresses: Sequence[Address], poses: Address | None = None, *, log: Log | None = None) -> None:
        super().__init__(log=log)
        self.where = ", ".join(map(str, addresses))
        self._addresses = named(addresses)
        self.counters = Counters(self._log)
        self._inbox: Inbox[Frames | _Pose | str | InputError] = Inbox(self.counters, received=False)
        self._leaving = threading.Event()
        self._sources: dict[str, InstrumentSource] = {}
        self._running = set(self._addresses)
        self._queues: dict[str, PoseQueue[_Row]] = {}
        self._newest: dict[str, tuple[int, float]] = {}  # time of the last frame [ns], and when it came [s]
        self._begun_s = time.monotonic()
        self._until_ns = 0  # all instruments have given their frames up to then
        self._feed: Any = poses.open("poses") if poses is not None else None
        self._poses_of = str(poses)
        self._track, self._clock = PoseTrack(), InstrumentClock()
        self._posed_s: float | None = None  # when the last pose came
        self._last: dict[str, TimedPose] = {}  # of the last frame of each instrument, for the next one's velocity
        self._given, self._unposed, self._lacking = 0, 0, False
        self._threads: list[threading.Thread] = []
        try:
            self._open()
        except BaseException:
            self._release()
            raise
        lags = [one.lag_s for one in self._sources.values()]
        self.lag_s = None if None in lags else max(lag for lag in lags if lag)
        works: list[Callable[[], None]] = [partial(self._receive, name) for name in self._addresses]
        for work in works if self._feed is None else [self._listen, *works]:
            self._threads.append(threading.Thread(target=work, name=self.where, daemon=True))
            self._threads[-1].start()

    @property
    def sensors(self) -> tuple[str, ...]:
        """Names of the radars."""
        return tuple(self._addresses)

    def stop(self) -> None:
        """End the stream after what has come so far; safe to call from another thread."""
        super().stop()
        for one in list(self._sources.values()):
            one.stop()

    def _without_end(self) -> str:
        endless = any("duration_s" not in address.options for address in self._addresses.values())
        return "duration_s=SECONDS for each" if endless else ""

    def trajectory(self) -> Trajectory | None:
        """Return the body's path in the last half minute; None before the first pose."""
        return self._track.path()

    def _open(self) -> None:
        """Open all instruments at once; those that are not ready are tried again later.

        Raises:
            InputError: none is ready, or a setting cannot be used.
        """
        with ThreadPoolExecutor(len(self._addresses)) as pool:
            opened = {name: pool.submit(address.open, "source") for name, address in self._addresses.items()}
        errors = {name: error for name, one in opened.items() if (error := one.exception()) is not None}
        self._sources = {name: one.result() for name, one in opened.items() if name not in errors}
        for error in errors.values():
            if not self._sources or not isinstance(error, NotReadyError):
                raise error
            self._log(f"{error}; waiting for it")

    def _receive(self, name: str) -> None:
        """Take one instrument's frames until its end; the others go on without it."""
        try:
            while name not in self._sources and not (self._leaving.wait(RETRY_S) or self._stopping):
                try:
                    self._sources[name] = self._addresses[name].open("source")
                except NotReadyError:
                    continue
                self._inbox.put(f"{self._addresses[name]}: measures")
                if self._stopping or self._leaving.is_set():
                    self._sources[name].stop()
            for piece in self._sources[name].stream() if name in self._sources else ():
                for part in piece.values():
                    self._inbox.put(part, topic=name, size=part.samples.nbytes, count=len(part))
        except Exception as error:
            self._inbox.put(f"{self._addresses[name]}: ended by {type(error).__name__}: {one_line(str(error))}")
        finally:
            self._running.discard(name)

    def _listen(self) -> None:
        """Take poses until the end."""
        try:
            while not self._leaving.is_set():
                found = self._feed.next(BATCH_S)
                if isinstance(found, ModelPose | BodyState):
                    self._inbox.put(_Pose(found, time.time()))
                elif found is not None:
                    self._inbox.put(str(found.text))
        except Exception as error:
            line = f"{self._poses_of}: {type(error).__name__}: {one_line(str(error))}"
            self._inbox.put(error if isinstance(error, InputError) else line)

    def _step(self, chunk: int, *, stopping: bool) -> Iterator[dict[str, Frames]]:
        running = bool(self._running)
        found = self._inbox.get(BATCH_S)
        while found is not None:
            self._take(found)
            found = self._inbox.get(0.0)
        yield from self._ready()
        if self._only_silent():
            self.stop()
        self._ended = not running and not any(map(len, self._queues.values()))

    def _only_silent(self) -> bool:
        """Return whether some instruments have come to their end, and the others give nothing any more."""
        early_s = time.monotonic() - PATIENCE_S
        silent = {name for name in self._running.copy() if self._heard(name)[1] < early_s}
        return len(self._running) < len(self._addresses) and silent == self._running

    def _take(self, found: Frames | _Pose | str | InputError) -> None:
        now_s = time.monotonic()
        if isinstance(found, Frames):
            queue = self._queues.setdefault(found.sensor, PoseQueue(self.counters, found.sensor, most=MOST, keeps=True))
            for number, t_ns in enumerate(found.t_ns.tolist()):
                queue.put(_Row(t_ns, found, number), now_s)
            self._newest[found.sensor] = int(found.t_ns[-1]), now_s
        elif isinstance(found, _Pose):
            self._add(found, now_s)
        elif isinstance(found, str):
            self._log(found)
        elif not self._given:
            raise found
        else:
            self._log(str(found))

    def _add(self, found: _Pose, now_s: float) -> None:
        """Add a pose; where its stamp is not of this computer's clock, its arrival puts it there."""
        pose, t_ns = checked_pose(found.pose.position, found.pose.quat_xyzw), found.pose.t_ns
        if isinstance(pose, str):
            self.counters.drop(self._poses_of, "bad", pose)
            return
        if not is_present(t_ns):
            t_ns = round(self._clock.at(t_ns * 1e-9, found.arrived_s) * 1e9)
        self._track.add(t_ns, *pose)
        self._posed_s = now_s

    def _heard(self, name: str) -> tuple[int, float]:
        """Return the time of an instrument's last frame [ns], and when it came; else when it was started [s]."""
        return self._newest.get(name, (0, self._begun_s))

    def _ready(self) -> Iterator[dict[str, Frames]]:
        """Give what need not wait any longer, in pieces of one kind: with poses, or without."""
        now_s = time.monotonic()
        heard = [self._heard(name) for name in self._running.copy() if name in self._sources]
        self._until_ns = min((t_ns for t_ns, came_s in heard if now_s - came_s < ORDER_S), default=2**63 - 1)
        found: dict[str, list[Frames]] = {}
        for name, queue in self._queues.items():
            queue.patience_s = FIRST_POSE_S if self._feed is not None and self._posed_s is None else POSE_S
            rows = list(queue.ready(partial(self._place, now_s), now_s))
            for _, some in groupby(rows, key=lambda row: (id(row[0].part.spec), row[1] is None)):
                found.setdefault(name, []).append(self._together(name, list(some)))
        yield from of_one_kind(found)

    def _place(self, now_s: float, row: _Row) -> Place[tuple[Floats, Floats]]:
        """Find the pose of the body at a frame."""
        if row.t_ns > self._until_ns:
            return Place("wait")
        if self._feed is None:
            return Place("known")
        if self._posed_s is None:
            return Place("wait")
        answer = self._track.at(row.t_ns)
        return Place("never") if answer.status == "wait" and now_s - self._posed_s > POSE_S else answer

    def _together(self, name: str, rows: list[tuple[_Row, tuple[Floats, Floats] | None]]) -> Frames:
        """Return rows of one kind as one piece."""
        parts = []
        for _, some in groupby((row for row, _ in rows), key=lambda row: id(row.part)):
            here = list(some)
            part = here[0].part
            parts.append(part if len(here) == len(part) else part[here[0].number : here[-1].number + 1])
        frames, known = joined(parts), [(row.t_ns, *pose) for row, pose in rows if pose is not None]
        self._given += len(frames)
        if not known:
            self._unposed += len(frames)
            self._report_poses(name, lacking=self._feed is not None)
            return frames
        self._report_poses(name, lacking=False)
        before = self._last.get(name)
        near = before is not None and known[0][0] - before[0] <= POSE_S * 1e9
        self._last[name] = known[-1]
        path = path_through(before if near else None, known)
        return replace(frames, poses=path.mounted(frames.spec.mount.body_from_sensor()))

    def _report_poses(self, name: str, *, lacking: bool) -> None:
        """Log that poses end or come again; frames from before the first one only count."""
        if lacking != self._lacking and (not lacking or name in self._last or self._posed_s is None):
            self._lacking = lacking
            what = "no poses; frames are kept without them" if lacking else "poses come again"
            self._log(f"{self._poses_of}: {what}")

    def _lines(self) -> list[str]:
        lines = super()._lines()
        if self._feed is not None and self._unposed:
            lines.append(f"{self._unposed:,} of {self._given:,} frames have no pose")
        return lines

    def _release(self) -> None:
        self._leaving.set()
        for one in list(self._sources.values()):
            one.close()
        for thread in self._threads:
            thread.join(5.0)
        if self._feed is not None:
            self._feed.close()


def named(addresses: Sequence[Address]) -> dict[str, Address]:
    """Return the addresses of instruments by the name of their radar, which is their scheme unless they have one.

    Raises:
        InputError: two have one name.
    """
    out: dict[str, Address] = {}
    for address in addresses:
        name = address.options.get("sensor") or address.scheme
        if name in out:
            where = f"{out[name]} and {address}"
            raise InputError(f"two radars are named {name!r}", where=where, allowed="sensor=NAME, another for each")
        out[name] = (
            address if "sensor" in address.options else replace(address, options=address.options | {"sensor": name})
        )
    return out


def mounted(addresses: Sequence[Address], rig: Rig) -> list[Address]:
    """Return the addresses with the mounts that a rig has for these names; an address's own mount stays.

    Raises:
        InputError: two have one name, or the rig has no such radar.
    """
    out = []
    for name, address in named(addresses).items():
        if name not in rig.sensors:
            raise InputError(f"no radar {name!r} in the rig", where=str(address), allowed=", ".join(rig.sensors))
        out.append(replace(address, options={"mount": rig.sensors[name].mount, **address.options}))
    return out


@dataclass(frozen=True, slots=True)
class LiveTarget:
    """Live ports that are received together."""

    addresses: tuple[Address, ...]
    poses: Address | None = None

    @classmethod
    def of(cls, sources: Sequence[str], poses: str = "") -> LiveTarget | None:
        """Return what several sources, or one beside a port of poses, name; None: one source of any kind.

        Args:
            sources: what `ullage run` is given.
            poses: a live port that gives poses; empty: none.

        Raises:
            InputError: a source is no instrument, or nothing gives poses at `poses`.
        """
        if len(sources) == 1 and not poses:
            return None
        found = [Address.of(source) for source in sources]
        for source, address in zip(sources, found, strict=True):
            if address is None or address.scheme not in INSTRUMENTS:
                what = f"{source!r} together with {'a port of poses' if poses else 'other sources'}"
                raise InputError(
                    what, where="run", allowed=f"instruments: {', '.join(f'{one}:' for one in INSTRUMENTS)}"
                )
        posed = Address.of(poses) if poses else None
        if posed is not None and (not posed.known or posed.part("poses") is None):
            raise InputError(f"no poses come from {poses!r}", where="--poses", allowed=LISTED_POSES)
        return cls(tuple(address for address in found if address is not None), posed)

    @property
    def kind(self) -> str:
        """Its schemes, for the name of a run."""
        return "-".join(dict.fromkeys(address.scheme for address in self.addresses))

    def __str__(self) -> str:
        """Return the places, for people."""
        places = ", ".join(map(str, self.addresses))
        return places if self.poses is None else f"{places} with poses of {self.poses}"

    def open(self, rig: str = "") -> Any:
        """Open the source.

        Args:
            rig: preset or file that has the mounts of instruments by name; empty: each has its own.

        Raises:
            InputError: a port, an option or the rig cannot be used.
        """
        addresses = list(self.addresses)
        if all(address.scheme in INSTRUMENTS for address in addresses):
            if rig:
                addresses = mounted(addresses, rig_of(rig, None, "", where="sensing.rig"))
            if len(addresses) > 1 or self.poses is not None:
                return InstrumentGroup(addresses, self.poses)
        return addresses[0].open("source")
