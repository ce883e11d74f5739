"""Link to an autopilot: its identity, HEARTBEAT and TIMESYNC in both directions, and the messages of its vehicle."""

from __future__ import annotations

import math
import threading
import time
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Literal, NamedTuple

import numpy as np

from ullage.errors import InputError
from ullage.flow import Closing
from ullage.ports.intake import Counters, Inbox, Log, Once, Worker
from ullage.ports.mavlink.options import LinkOptions, place_of
from ullage.ports.mavlink.wire import Decoder, Sender, StreamWire, UdpWire, mavlink, open_wire
from ullage.ports.network import Place, SharedLinks

Role = Literal["source", "sink"]
POSES = ("ODOMETRY", "LOCAL_POSITION_NED", "ATTITUDE_QUATERNION", "ATTITUDE")
USED = {"HEARTBEAT", "TIMESYNC", "SYSTEM_TIME", "COMMAND_ACK", *POSES}
OTHERS = "other messages"
TICK_S = 0.02
HEARTBEAT_S = 1.0
ASK_S, ASK_OFTEN_S = 1.0, 0.1
"""Between two TIMESYNC questions [s], and while the offset is not known or the latest answer does not fit."""
REQUEST_S = 5.0
"""Between two requests for poses, while none come [s]."""
MOST_SENDERS = 16
QUESTIONS = 16
UTC_S = 1.0
"""A difference between the autopilot's UTC and ours that is reported [s]."""
KEPT = 64
"""Exchanges that the estimate uses."""
LEAST = 5
"""Exchanges before there is an estimate."""
DRIFT = 100e-6
"""Standard deviation of the drift of a crystal, before anything is measured."""
FLOOR_NS = 20_000.0
"""Least standard deviation of one exchange [ns]."""
STEP_NS = 20_000_000
"""An exchange that differs from the estimate by more than this and half its round trip does not fit [ns]."""
STEPS = 3
"""So many exchanges in a row that do not fit are a step of the clock; a single one is dropped."""
TOPIC = "TIMESYNC"


class Exchange(NamedTuple):
    """Request and its answer."""

    at_ns: float  # middle of the round trip by this clock
    offset_ns: float  # the peer's clock less this one
    round_trip_ns: float


class ClockOffset:
    """Estimates a peer's clock less this one, as a line over time.

    The peer's time belongs to the middle of the round trip, and cannot be wrong by more than half of it [RFC5905]. So
    exchanges with long round trips have little weight in the fit. An expected drift of zero, known to 100 ppm, keeps
    the slope small while the exchanges span a short time.

    Args:
        counters: count exchanges that do not fit, and report steps of the peer's clock.
    """

    def __init__(self, counters: Counters) -> None:
        self._counters = counters
        self._exchanges: deque[Exchange] = deque(maxlen=KEPT)
        self._odd: list[Exchange] = []
        self._line: tuple[float, float, float] | None = None  # time, offset there [ns], slope
        self.sigma_s: float | None = None
        """Standard deviation of the offset at the last exchange [s]; None: not known yet."""

    @property
    def known(self) -> bool:
        """Whether there were enough exchanges."""
        return self._line is not None

    @property
    def settled(self) -> bool:
        """Whether it is known and the latest exchange fits."""
        return self._line is not None and not self._odd

    @property
    def drift_ppm(self) -> float:
        """Drift of the peer's clock relative to ours [ppm]; 0 while it is not known."""
        return self._line[2] * 1e6 if self._line is not None else 0.0

    def take(self, sent_ns: int, peer_ns: int, received_ns: int) -> None:
        """Take one exchange: when the question left, the peer's time, and when the answer came [ns]."""
        if received_ns < sent_ns or peer_ns <= 0:
            self._counters.drop(TOPIC, "bad", "an answer from before its question")
            return
        at = (sent_ns + received_ns) / 2
        found = Exchange(at, peer_ns - at, float(received_ns - sent_ns))
        if self._line is None or abs(found.offset_ns - self._at(at)) <= STEP_NS + found.round_trip_ns / 2:
            self._counters.drop(TOPIC, "bad", "a single answer that does not fit", count=len(self._odd))
            self._odd = []
            self._exchanges.append(found)
        else:
            self._odd.append(found)
            if len(self._odd) < STEPS:
                return
            step_s = (found.offset_ns - self._at(at)) * 1e-9
            self._counters.step(f"the autopilot's clock jumped {step_s:+.3g} s: it is measured anew")
            self._exchanges, self._odd = deque(self._odd, maxlen=KEPT), []
            self._line = None
        self._fit()

    def offset_ns(self, local_ns: int) -> int | None:
        """The peer's clock less this one at a time by this one [ns]; None while it is not known."""
        return round(self._at(local_ns)) if self._line is not None else None

    def _at(self, local_ns: float) -> float:
        assert self._line is not None
        at, offset, slope = self._line
        return offset + slope * (local_ns - at)

    def _fit(self) -> None:
        if len(self._exchanges) < LEAST:
            return
        at, offset, trip = (np.array(column) for column in zip(*self._exchanges, strict=True))
        weight = 1 / (FLOOR_NS**2 + ((trip - trip.min()) / 2) ** 2)
        here, base = at[-1], offset[-1]  # differences, since clocks in nanoseconds fill a float
        design = np.stack([np.ones_like(at), at - here], axis=1)
        normal = design.T @ (design * weight[:, None]) + np.diag([0.0, DRIFT**-2])
        spread = np.linalg.inv(normal)
        level, slope = spread @ (design.T @ (weight * (offset - base)))
        self._line = (float(here), float(base + level), float(slope))
        self.sigma_s = float(np.sqrt(spread[0, 0])) * 1e-9


class PoseMessage(NamedTuple):
    """A message of the autopilot."""

    topic: str  # its type
    message: Any


@dataclass(slots=True)
class Autopilot:
    """The autopilot whose messages are used."""

    system: int
    component: int
    last_heartbeat_s: float  # last HEARTBEAT
    there: bool = True


def command_to(there: Autopilot, command: int, *values: float, confirmation: int = 0) -> Any:
    """COMMAND_LONG to an autopilot, with up to seven parameters; the others are 0."""
    fields = (*values, *[0.0] * (7 - len(values)))
    return mavlink().MAVLink_command_long_message(there.system, there.component, command, confirmation, *fields)


class Link(Closing):
    """Speaks with one autopilot, from a thread of its own.

    Messages of other systems and components are ignored and counted. `wait` gives the messages that hold poses.

    Args:
        wire: carries the bytes.
        options: ids and limits.
        log: takes lines for the user.
    """

    def __init__(self, wire: UdpWire | StreamWire, options: LinkOptions, log: Log) -> None:
        self.dialect, self.options, self.name = mavlink(), options, wire.name
        self.counters = Counters(log)
        self.clock = ClockOffset(self.counters)
        self.autopilot: Autopilot | None = None
        self.state = int(self.dialect.MAV_STATE_STANDBY)
        """MAV_STATE in our HEARTBEAT."""
        self.request_hz = 0.0
        """Poses a second that the autopilot is asked for; 0: it is not asked."""
        self.poses_come = False
        """Whether poses came since the autopilot was asked; else it is asked again, save for what it denied."""
        self.listens = False
        """Whether somebody takes the poses."""
        self.watchers: list[Callable[[Any], None]] = []
        """Each takes every message of the autopilot, in the link's thread."""
        self._wire, self._log = wire, log
        self._mav = self.dialect.MAVLink(None)
        self.events: Inbox[PoseMessage] = Inbox(self.counters, most=20_000)
        self._decoders: dict[Sender, Decoder] = {}
        self._questions: list[int] = []
        self._other_systems: set[int] = set()  # systems with an autopilot that is not ours
        self._once = Once(log)
        self._sent_s = dict.fromkeys(("heartbeat", "question", "request"), -math.inf)
        self._lock = threading.Lock()
        self._met = threading.Event()
        self._closing = threading.Event()
        self._requested: tuple[str, ...] = ()  # messages that were asked for at once; none: not yet
        self._answers: list[int] = []  # to these requests, in their order
        self._denied: set[str] = set()  # messages that the autopilot does not have
        self._wall_ns = time.time_ns() - time.monotonic_ns()  # kept, so that a set clock moves nothing
        self._worker = Worker(self._run, "ullage mavlink")
        self._worker.start()

    def send(self, message: Any) -> None:
        """Send a message of the dialect."""
        self._worker.check()
        with self._lock:
            mine = self.options.system_id or (self.autopilot.system if self.autopilot else 1)
            self._mav.srcSystem, self._mav.srcComponent = mine, self.options.component_id
            data = message.pack(self._mav)
            self._mav.seq = (self._mav.seq + 1) % 256
            self._wire.send(bytes(data))

    def wait(self, timeout_s: float) -> PoseMessage | None:
        """The next message that holds a pose; None where none came for so long."""
        self._worker.check()
        return self.events.get(timeout_s)

    def wait_heartbeat(self, timeout_s: float) -> None:
        """Wait for the first HEARTBEAT of the autopilot.

        Raises:
            InputError: none came.
        """
        if not self._met.wait(timeout_s):
            raise self.missing(timeout_s)

    def missing(self, waited_s: float) -> InputError:
        """The error for an autopilot that sends no HEARTBEAT."""
        who = f"system {self.options.vehicle}" if self.options.vehicle else "an autopilot"
        systems = ", ".join(str(number) for number in sorted(self._other_systems))
        what = f"no HEARTBEAT of {who} within {waited_s:g} s" + (
            f"; HEARTBEAT of system {systems} came" if systems else ""
        )
        return InputError(what, where=f"mavlink:{self.name}", allowed="vehicle=ID of an autopilot that sends there")

    def local_ns(self, boot_ns: int) -> int | None:
        """A time of the autopilot's clock by this machine's [ns since 1970]; None while TIMESYNC gave no offset."""
        now = time.monotonic_ns()
        offset = self.clock.offset_ns(now)
        if offset is None:
            return None
        offset = self.clock.offset_ns(boot_ns - offset)  # at that time, which may be long ago
        return None if offset is None else boot_ns - offset + self._wall_ns

    def boot_ns(self, local_ns: int) -> int | None:
        """A time of this machine's clock [ns since 1970] by the autopilot's; None while TIMESYNC gave no offset."""
        offset = self.clock.offset_ns(local_ns - self._wall_ns)
        return None if offset is None else local_ns - self._wall_ns + offset

    def forget_clock(self) -> None:
        """Measure the autopilot's clock anew, as after it was started again."""
        self.clock = ClockOffset(self.counters)

    def close(self) -> None:
        """End the thread, and let go of the wire."""
        self._closing.set()
        self._worker.join(2.0)
        self._wire.close()

    def _run(self) -> None:
        while not self._closing.is_set():
            for sender, data in self._wire.receive(TICK_S):
                for message in self._decoder(sender).feed(data):
                    self._take(message)
            self._tick(time.monotonic())

    def _decoder(self, sender: Sender) -> Decoder:
        if sender not in self._decoders:
            if len(self._decoders) >= MOST_SENDERS:
                self._decoders.pop(next(iter(self._decoders)))
            self._decoders[sender] = Decoder(self.counters, self.name)
        return self._decoders[sender]

    def _take(self, message: Any) -> None:
        kind = message.get_type()
        if kind not in USED:
            self.counters.receive(OTHERS)
            return
        system, component = message.get_srcSystem(), message.get_srcComponent()
        self.counters.receive(kind)
        if kind == "HEARTBEAT":
            self._heartbeat(message, system, component)
        elif self.autopilot is None:
            self.counters.drop(kind, "bad", f"of system {system}, before a HEARTBEAT of the autopilot")
        elif system != self.autopilot.system:
            self.counters.drop(kind, "bad", f"of system {system}, not {self.autopilot.system}")
        elif component != self.autopilot.component:
            self.counters.drop(kind, "bad", f"of component {component}, not the autopilot")
        elif kind == "TIMESYNC":
            self._timesync(message)
        elif kind == "SYSTEM_TIME":
            self._system_time(message)
        elif kind == "COMMAND_ACK":
            self._acknowledged(message)
        elif self.listens:
            self.events.put(PoseMessage(kind, message))
        there = self.autopilot
        if there is not None and (system, component) == (there.system, there.component):
            for take in self.watchers:
                take(message)

    def _heartbeat(self, message: Any, system: int, component: int) -> None:
        d, now = self.dialect, time.monotonic()
        if (system, component) == (self._mav.srcSystem, self.options.component_id):
            self._once(f"another program uses system {system}, component {component}: give one of them another id")
            return
        if message.autopilot == d.MAV_AUTOPILOT_INVALID:  # a ground station, a camera, a gimbal
            return
        known = self.autopilot
        if known is None and self.options.vehicle in (0, system):
            self.autopilot = known = Autopilot(system, component, now)
            name = d.enums["MAV_AUTOPILOT"][message.autopilot].name.removeprefix("MAV_AUTOPILOT_")
            self._log(f"{self.name}: autopilot {name}, system {system}, component {component}")
            self._met.set()
        if known is None or (system, component) != (known.system, known.component):
            self._other_systems.add(system)
            wanted = known.system if known else self.options.vehicle
            self.counters.drop(
                "HEARTBEAT", "bad", f"of system {system}, component {component}; system {wanted} is used"
            )
            return
        known.last_heartbeat_s = now
        if not known.there:
            known.there = True
            self._requested = ()  # it may have been started again, with its own rates
            self._log(f"{self.name}: HEARTBEAT of system {system} is back")

    def _timesync(self, message: Any) -> None:
        now = time.monotonic_ns()
        if message.tc1 == 0:
            self.send(self.dialect.MAVLink_timesync_message(now, message.ts1))
        elif message.ts1 in self._questions:  # else it is the answer to another system
            self._questions.remove(message.ts1)
            self.clock.take(message.ts1, message.tc1, now)

    def _system_time(self, message: Any) -> None:
        unix_s = message.time_unix_usec * 1e-6
        if unix_s > 1e9 and abs(away_s := unix_s - time.time()) > UTC_S:  # before 2001: it does not know UTC
            self._once(f"{self.name}: the autopilot's UTC differs from this machine's by {away_s:+.3g} s")

    def _acknowledged(self, message: Any) -> None:
        d = self.dialect
        if message.command != d.MAV_CMD_SET_MESSAGE_INTERVAL:
            return
        self._answers.append(message.result)
        if len(self._answers) != len(self._requested):  # an answer names no message: only all of them tell which
            return
        for kind, result in zip(self._requested, self._answers, strict=True):
            if result not in (d.MAV_RESULT_ACCEPTED, d.MAV_RESULT_TEMPORARILY_REJECTED):
                self._denied.add(kind)
                entry = d.enums["MAV_RESULT"].get(result)
                why = entry.name.removeprefix("MAV_RESULT_") if entry else str(result)
                self._once(f"{self.name}: the autopilot does not set the rate of {kind} ({why})")

    def _tick(self, now: float) -> None:
        if self._is_due("heartbeat", now, HEARTBEAT_S):
            d = self.dialect
            self.send(
                d.MAVLink_heartbeat_message(d.MAV_TYPE_ONBOARD_CONTROLLER, d.MAV_AUTOPILOT_INVALID, 0, 0, self.state, 3)
            )
        there = self.autopilot
        if there is None:
            return
        if self._is_due("question", now, ASK_S if self.clock.settled else ASK_OFTEN_S):
            asked = time.monotonic_ns()
            self._questions = [*self._questions[1 - QUESTIONS :], asked]
            self.send(self.dialect.MAVLink_timesync_message(0, asked))
        if self.request_hz and (not self.poses_come or not self._requested) and self._is_due("request", now, REQUEST_S):
            self._request(there, self.request_hz)
        if there.there and now - there.last_heartbeat_s > self.options.heartbeat_s:
            there.there = False
            self._log(
                f"{self.name}: no HEARTBEAT of system {there.system} for {self.options.heartbeat_s:g} s; "
                "its poses end here until it is back"
            )

    def _is_due(self, what: str, now: float, every_s: float) -> bool:
        if now < self._sent_s[what] + every_s:
            return False
        self._sent_s[what] = now
        return True

    def _request(self, there: Autopilot, rate_hz: float) -> None:
        """Ask for the messages with poses, save for those that were denied: each denial is shown to the pilot."""
        d = self.dialect
        self._requested, self._answers = tuple(kind for kind in POSES if kind not in self._denied), []
        for kind in self._requested:
            number = getattr(d, f"MAVLINK_MSG_ID_{kind}")
            self.send(command_to(there, d.MAV_CMD_SET_MESSAGE_INTERVAL, number, 1e6 / rate_hz))


_links: SharedLinks[Link] = SharedLinks()


def open_link(text: str, options: LinkOptions, *, role: Role, log: Log) -> Link:
    """Open a link to a place; a source and a sink of one program share it. `leave` closes it.

    Args:
        text: `udp://HOST:PORT`, `udpin://HOST:PORT`, `tcp://HOST:PORT` or `serial:///dev/NAME`.
        options: of the link; an open link keeps the options that it was opened with.
        role: that uses the link.
        log: takes lines for the user.

    Raises:
        InputError: the place cannot be understood or opened.
        MissingExtra: pymavlink or pyserial is not installed.
    """
    mavlink()
    place = place_of(text)
    key: tuple[Place, int, str] = (place, options.port, options.interface)
    link, _ = _links.get(key, role, lambda: Link(open_wire(place, options, log), options, log), usable=lambda _: True)
    return link


leave = _links.leave
"""Closes a link, unless its other role still uses it."""
