"""Obstacle distances for an autopilot: `--to mavlink:udp://HOST:PORT`."""

from __future__ import annotations

import math
import queue
import time
from collections import deque
from collections.abc import Iterable, Mapping

import numpy as np

from ullage.data import Frames
from ullage.errors import InputError
from ullage.flow import Due, Sink
from ullage.ports.intake import Log, Once, Worker, warn
from ullage.ports.mavlink.brake import ModeBrake
from ullage.ports.mavlink.encode import distance_sensors, obstacle_distance
from ullage.ports.mavlink.link import leave, open_link
from ullage.ports.mavlink.options import SinkOptions
from ullage.ports.protocol import Item
from ullage.ports.publisher import is_present
from ullage.ports.rate_limiter import STEP_BACK_S, RateLimiter
from ullage.processing.obstacles import STALE_S, ObstacleSectors, ObstacleStage

AHEAD_S = 2.0
"""How far the source may run ahead of what was sent [s of stream]."""
WAIT_S = 0.1
"""Between two looks at how old the last distances are [s]."""
MOST_AGES = 100_000
LEAST_HZ = 10.0
"""Fewer distances a second make an autopilot slow or stop."""
TELL_S = 10.0
"""Between two texts of a fault that lasts [s]."""
TOPIC = "OBSTACLE_DISTANCE"


class MavlinkSink(Sink):
    """Sends the obstacle distances of a run to an autopilot, from a thread of its own, at the pace of the frames.

    The run's own `ObstacleSectors` are sent where there are some; else an `ObstacleStage` makes them of its frames.
    Distances that are older than half a second are not sent, and none are repeated: the autopilot must know that the
    radars are silent.

    Args:
        place: `udp://HOST:PORT`, `udpin://HOST:PORT`, `tcp://HOST:PORT` or `serial:///dev/NAME`.
        options: what is sent, and how.
        log: takes lines for the user; None: they become warnings.

    Raises:
        InputError: the place cannot be opened, or no autopilot is there where one is waited for.
        MissingExtra: pymavlink or pyserial is not installed.
    """

    settings = SinkOptions
    takes_obstacles = sends = True
    """Its messages leave this machine's process at once."""

    def __init__(self, place: str, options: SinkOptions, *, log: Log | None = None) -> None:
        self._options, self._log = options, log or warn
        self.link = open_link(place, options, role="sink", log=self._log)
        try:
            if options.wait_s:
                self.link.wait_heartbeat(options.wait_s)
        except BaseException:
            leave(self.link, "sink")
            raise
        self._stage: ObstacleStage | None = ObstacleStage()  # None: the run has its own
        self._first: Mapping[str, Frames] | None = None  # the first frames: a run's own distances come after them
        self._own = False  # the run has none
        self._limiter = RateLimiter(options.pace)
        self._live: bool | None = None  # whether stamps are of the present: the first item decides, as it comes
        self._due = Due(1 / options.obstacle_hz, STEP_BACK_S)
        self._once, self._begun_s, self._count = Once(self._log), 0.0, 0
        self._faults: dict[str, str] = {}  # that the autopilot was told of
        self._told_s = 0.0
        self._ages_s: deque[float] = deque(maxlen=MOST_AGES)  # from frames of the present to their messages
        self._newest: ObstacleSectors | None = None
        self._brake = ModeBrake(self.link, options, self._send_text) if options.guard == "brake" else None
        self._queue: queue.Queue[ObstacleSectors | None] = queue.Queue(max(round(AHEAD_S * options.obstacle_hz), 1))
        self._closed = False
        self._worker = Worker(self._run, "ullage mavlink sink")
        self._worker.start()

    def write(self, item: Item) -> None:
        """Take frames, or the obstacles of the run; everything else passes by.

        Raises:
            InputError: the sink is closed.
        """
        if self._closed:
            raise InputError("the sink is closed", where=f"mavlink:{self.link.name}")
        if isinstance(item, ObstacleSectors):
            self._see(item.t_ns)
            self._stage, self._first = None, None
            self._queue_up([item])
        elif isinstance(item, Frames | Mapping) and self._stage is not None:
            chunk = {item.sensor: item} if isinstance(item, Frames) else item
            self._see(max((int(part.t_ns[-1]) for part in chunk.values() if len(part)), default=None))
            if self._first is None and not self._own:
                self._first = chunk
                return
            self._begin()
            self._queue_up(self._stage.update(chunk))

    def _see(self, t_ns: int | None) -> None:
        """Decide whether the stream is live: not by distances, which may be late from the start."""
        if self._live is None and t_ns is not None:
            self._live = is_present(t_ns)

    def _begin(self) -> None:
        """Make distances of the frames that waited to see whether the run has its own."""
        first, self._first = self._first, None
        if first is not None and self._stage is not None:
            self._own = True
            self._queue_up(self._stage.update(first))

    def _queue_up(self, found: Iterable[ObstacleSectors]) -> None:
        """Hand over at most `obstacle_hz` a second; waits while the thread is far behind."""
        for sectors in found:
            if self._due.reached(sectors.t_ns):
                self._put(sectors)
                self._worker.check()

    def _put(self, item: ObstacleSectors | None) -> None:
        """Hand over one item, or the end, unless the thread has failed."""
        while self._worker.error is None:
            try:
                return self._queue.put(item, timeout=0.1)
            except queue.Full:
                continue

    def _run(self) -> None:
        while True:
            try:
                sectors = self._queue.get(timeout=WAIT_S)
            except queue.Empty:
                sectors = self._newest
            else:
                if sectors is None:
                    return
                self._newest = sectors
                self._send_in_time(sectors)
            if self._live and sectors is not None:
                self._judge(sectors, time.time() - sectors.t_ns * 1e-9)

    def _judge(self, sectors: ObstacleSectors, age_s: float) -> None:
        """Brake where it must, and make the state critical where no distances were sent for half a second."""
        d = self.link.dialect
        if self._brake is not None:
            self._brake.judge(sectors, age_s)
        if age_s > STALE_S and self.link.state == d.MAV_STATE_ACTIVE:
            self.link.state = int(d.MAV_STATE_CRITICAL)
            text = f"no distances for {STALE_S:g} s"
            self._log(f"{self.link.name}: {text}, so none are sent; the autopilot must stop")
            self._send_text(d.MAV_SEVERITY_CRITICAL, text)

    def _send_in_time(self, sectors: ObstacleSectors) -> None:
        boot_ns: int | None = None
        if self._live:
            if (age_s := time.time() - sectors.t_ns * 1e-9) > STALE_S:
                self.link.counters.drop(TOPIC, "late", f"distances {age_s:.2g} s old")
                return
            boot_ns = self.link.boot_ns(sectors.t_ns)
        elif self._options.pace:
            self._limiter.wait(sectors.t_ns)
        t_ns = sectors.t_ns if boot_ns is None else boot_ns
        if self._options.sensors:  # before the other: where both tell of one direction, autopilots keep the later
            for message in distance_sensors(sectors, t_ns // 1_000_000):
                self.link.send(message)
        self.link.send(obstacle_distance(sectors, t_ns // 1000))
        if self._live:
            self._ages_s.append(time.time() - sectors.t_ns * 1e-9)
        self._tell_faults(sectors)
        self._check_rate(time.monotonic())

    def _check_rate(self, now_s: float) -> None:
        """Report once that distances go out too rarely for an autopilot."""
        self._begun_s = self._begun_s or now_s
        took_s = now_s - self._begun_s
        if took_s > 2.0 and (rate := self._count / took_s) < 0.9 * LEAST_HZ:
            self._once(f"{rate:.1f} distances a second are sent; autopilots expect {LEAST_HZ:g}", kind="rate")
        self._count += 1

    def _tell_faults(self, sectors: ObstacleSectors) -> None:
        """Make a faulty radar our critical state and a text on the pilot's screen: ArduPilot takes no data as free."""
        d, now = self.link.dialect, time.monotonic()
        faults = {name: why for name, why in zip(sectors.sensors, sectors.fault, strict=True) if why}
        self.link.state = int(d.MAV_STATE_CRITICAL if faults else d.MAV_STATE_ACTIVE)
        again = bool(faults) and now - self._told_s > TELL_S
        for name, why in faults.items():
            if again or name not in self._faults:
                self._told_s = now
                self._send_text(d.MAV_SEVERITY_CRITICAL, f"radar {name}: {why}; its sector is blind")
        for name in self._faults.keys() - faults.keys():
            self._send_text(d.MAV_SEVERITY_NOTICE, f"radar {name}: sound again")
        self._faults = faults

    def _send_text(self, severity: int, text: str) -> None:
        self._log(f"{self.link.name}: {text}")
        self.link.send(self.link.dialect.MAVLink_statustext_message(severity, text.encode("ascii", "replace")[:50]))

    def close(self) -> None:
        """Send what waits, and leave the link."""
        if self._closed:
            return
        self._closed = True
        try:
            self._begin()
            self._put(None)
            self._worker.join()
            if self._brake is not None and self._live and self._newest is not None:
                self._brake.judge(self._newest, math.inf)  # no more distances come
            if self.link.autopilot is None:
                self._log(f"{self.link.name}: no HEARTBEAT of an autopilot came; the distances may have reached nobody")
            if self._ages_s:
                middle, most = np.percentile(self._ages_s, [50, 99]) * 1e3
                self._log(f"{self.link.name}: from frame to message {middle:.0f} ms (median), {most:.0f} ms (99 %)")
            for line in self.link.counters.lines():
                self._log(line)
        finally:
            leave(self.link, "sink")
        self._worker.check()
