"""Obstacle distances for an autopilot: `--to mavlink:udp://HOST:PORT`.

OBSTACLE_DISTANCE says them by sector, DISTANCE_SENSOR for each radar.
"""

from __future__ import annotations

import math
import queue
import re
import time
from collections import deque
from collections.abc import Iterable, Mapping
from functools import cache
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from ullage.arrays import Floats
from ullage.data import Frames
from ullage.errors import InputError
from ullage.flow import Due, Sink
from ullage.geometry import quat_matrix, rpy_quat
from ullage.ports.intake import Log, Once, Worker, warn
from ullage.ports.mavlink.brake import ModeBrake
from ullage.ports.mavlink.link import leave, open_link
from ullage.ports.mavlink.options import SinkOptions
from ullage.ports.mavlink.wire import mavlink
from ullage.ports.ned import FLIP
from ullage.ports.protocol import Item
from ullage.ports.publisher import STEP_BACK_S, RateLimiter, is_present
from ullage.processing.obstacles import STALE_S, ObstacleSectors, ObstacleStage

CUSTOM = 100
"""MAV_SENSOR_ROTATION_CUSTOM: the quaternion says how the sensor is mounted."""
SECTORS, SECTOR_DEG = 72, 5
UNKNOWN = 65535
"""UINT16_MAX: nothing is known of this sector."""
MOST_CM = 65533  # so that "nothing there", one more, is not UNKNOWN
UNKNOWN_COVARIANCE = 255
HALF_STEPS = 2 * SECTORS
"""Directions for which the coverage of a radar is tested, 2.5 degrees apart."""


class Limits(NamedTuple):
    """Least and greatest distance that all messages name [cm]."""

    least: int
    most: int


def limits_of(sectors: ObstacleSectors) -> Limits:
    """The limits of all radars together: every one of them sees from the first to the second.

    PX4 merges what several sensors say of one direction by their greatest distance, so all messages name the same.
    """
    least = math.ceil(100 * max(float(np.max(sectors.least_m, initial=0.0)), 0.0))
    most = math.floor(100 * min(float(np.min(sectors.reach_m, initial=np.inf)), MOST_CM / 100))
    return Limits(min(least, MOST_CM - 2), max(most, least + 2))


def centimetres(distance_m: Floats, limits: Limits) -> NDArray[np.int64]:
    """Distances as both autopilots expect them [cm]: rounded down, and never below the least.

    PX4 and ArduPilot ignore readings below `min_distance`, so an obstacle that is nearer is said to be at it.
    NaN becomes UNKNOWN; what lies beyond the greatest distance, or nowhere, becomes one more than that.
    """
    known = np.nan_to_num(distance_m, nan=np.inf, posinf=np.inf)
    cm = np.floor(np.clip(100 * known, limits.least + 1, limits.most + 1))
    return np.where(np.isnan(distance_m), UNKNOWN, cm).astype(np.int64)


def sector_distances(sectors: ObstacleSectors) -> Floats:
    """The nearest obstacle (72) in each 5 degrees, clockwise from forward [m]; +inf: nothing there; NaN: unknown.

    ArduPilot centres element j on 5 j degrees, PX4 begins it there. An element covers both, from 5 j - 2.5 to 5 j + 5
    degrees. An obstacle in any part of it counts. Only where working radars cover all of it is it free.
    """
    angle = -np.radians(360 / HALF_STEPS) * np.arange(HALF_STEPS)
    level = np.stack([np.cos(angle), np.sin(angle), np.zeros(HALF_STEPS)])
    apart = np.arccos(np.clip(sectors.boresight @ level, -1, 1))
    covered = apart <= sectors.width_rad[:, None] / 2 + 1e-9
    part = (2 * np.arange(SECTORS)[:, None] + np.array([-1, 0, 1, 2])) % HALF_STEPS
    broken = (covered[:, part].any(axis=2) & ~sectors.valid[:, None]).any(axis=0)
    free = (covered & sectors.valid[:, None]).any(axis=0)[part].all(axis=1) & ~broken
    cells = sectors.nearest_m()[-np.arange(SECTORS)]  # clockwise; a cell reaches 2.5 degrees to both sides
    nearest = np.minimum(cells, np.roll(cells, -1))
    return np.where(np.isfinite(nearest), nearest, np.where(free, np.inf, np.nan))


def obstacle_distance(sectors: ObstacleSectors, time_us: int) -> Any:
    """OBSTACLE_DISTANCE in the body's frame, forward-right-down.

    Args:
        sectors: what the radars detect.
        time_us: of the autopilot's clock, or since 1970 [us].
    """
    d, limits = mavlink(), limits_of(sectors)
    cm = centimetres(sector_distances(sectors), limits)
    return d.MAVLink_obstacle_distance_message(
        max(time_us, 0), d.MAV_DISTANCE_SENSOR_RADAR, cm.tolist(), SECTOR_DEG, limits.least, limits.most,
        float(SECTOR_DEG), 0.0, d.MAV_FRAME_BODY_FRD,
    )  # fmt: skip


def distance_sensors(sectors: ObstacleSectors, time_ms: int) -> list[Any]:
    """DISTANCE_SENSOR of each radar that works; without one the autopilot forgets the others after its time limit.

    Args:
        sectors: what the radars detect.
        time_ms: of the autopilot's clock [ms].
    """
    limits = limits_of(sectors)
    cm = centimetres(sectors.distance_m, limits)
    return [_distance_sensor(sectors, k, int(cm[k]), limits, time_ms) for k in range(len(sectors)) if sectors.valid[k]]


@cache
def rotations() -> dict[int, Floats]:
    """Boresights (3), forward-right-down, by number of MAV_SENSOR_ROTATION; CUSTOM is left out."""
    out = {}
    for number, entry in mavlink().enums["MAV_SENSOR_ORIENTATION"].items():
        if not entry.name.startswith("MAV_SENSOR_ROTATION") or number == CUSTOM:
            continue
        turns = dict(re.findall(r"(ROLL|PITCH|YAW)_(\d+)", entry.name))
        roll, pitch, yaw = (math.radians(float(turns.get(name, 0))) for name in ("ROLL", "PITCH", "YAW"))
        out[int(number)] = quat_matrix(rpy_quat(roll, pitch, yaw))[:, 0]
    return out


def orientation_of(boresight_frd: Floats) -> int:
    """The first MAV_SENSOR_ROTATION whose boresight is this one (3), forward-right-down; else CUSTOM.

    A distance has no roll about the boresight, so the rotation with the lowest number stands for all.
    """
    least = math.cos(math.radians(1.0))
    found = (number for number, axis in sorted(rotations().items()) if float(np.dot(axis, boresight_frd)) >= least)
    return next(found, CUSTOM)


def _distance_sensor(sectors: ObstacleSectors, k: int, cm: int, limits: Limits, time_ms: int) -> Any:
    d = mavlink()
    bore = FLIP @ sectors.boresight[k]
    orientation = orientation_of(bore)
    quat = [0.0, 0.0, 0.0, 0.0]  # not used
    if orientation == CUSTOM:
        x, y, z, w = rpy_quat(0.0, -math.asin(float(np.clip(bore[2], -1, 1))), math.atan2(bore[1], bore[0])).tolist()
        quat = [w, x, y, z]
    width = float(sectors.width_rad[k])
    return d.MAVLink_distance_sensor_message(
        time_ms & 0xFFFFFFFF, limits.least, limits.most, cm, d.MAV_DISTANCE_SENSOR_RADAR, k, orientation,
        _covariance(float(sectors.sigma_m[k])), width, width, quat, _quality(sectors, k),
    )  # fmt: skip


def _covariance(sigma_m: float) -> int:
    """Variance [cm^2], at least 1; 255 where it is unknown or does not fit."""
    if not math.isfinite(sigma_m) or 100 * sigma_m >= math.sqrt(UNKNOWN_COVARIANCE - 1):
        return UNKNOWN_COVARIANCE
    return max(math.ceil((100 * sigma_m) ** 2), 1)


def _quality(sectors: ObstacleSectors, k: int) -> int:
    """The part of the nearest echo's amplitude that is not noise, 2 to 100; 0 without an obstacle: unknown."""
    tracks = sectors.tracks
    rows = np.flatnonzero((tracks.sensor == k) & ~tracks.outside)
    if not rows.size:
        return 0
    return int(np.clip(round(100 * (1 - 10 ** (-float(tracks.snr_db[rows[0]]) / 20))), 2, 100))


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
