"""Frames from an instrument: a thread takes its scans as they come, and finds it again when it was gone.

The counter of the instrument puts the scans on this computer's clock [BarShalomEtAl2001].
"""

from __future__ import annotations

import math
import threading
import time
from abc import ABC, abstractmethod
from collections.abc import Iterator
from typing import Any, ClassVar, NamedTuple

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from ullage.data import Frames, Unit
from ullage.errors import InputError
from ullage.ports.intake import PATIENCE_S, Counters, Inbox, LiveOptions, Log
from ullage.ports.live import LiveSource, options_of
from ullage.specs import RadarSpec
from ullage.untrusted import load_yaml

RETRY_S = 0.5
"""Between two attempts to open an instrument that is gone [s]."""
BATCH_S = 0.1
"""Scans are given on together that came within this [s]."""
DRIFT = 1e-3
"""One sigma of how much faster the instrument's clock runs: its frame rate may be rounded."""
DRIFT_WALK, OFFSET_WALK_S = 1e-8, 1e-6
"""What drift and offset change in a second."""
FIRST_JITTER_S = 5e-3
MEMORY = 0.02
"""Weight of a new scan in the jitter."""
LATE_SIGMAS = 3.0
"""A scan that comes later than this weighs less: an operating system delays, but never hurries."""


class Scan(NamedTuple):
    """One scan as it came."""

    samples: NDArray[Any]  # (b)
    device_s: float  # time on the instrument's clock [s]
    arrived_s: float  # on this computer's clock [s]


class Instrument(ABC):
    """A radar that measures on request.

    Args:
        address: where it is, after the scheme.
        spec: its settings.
        options: those of its kind, as `settings` lists them.

    Raises:
        InputError: the address is none, or a setting is none of the instrument's.
        MissingExtra: its library is not installed.
    """

    scheme: ClassVar[str]
    """Of its addresses, and its name unless it is given one."""
    settings: ClassVar[type[InstrumentOptions]]
    preset: ClassVar[str]
    unit: Unit = "normalised"

    def __init__(self, address: str, spec: RadarSpec, options: Any) -> None:
        self.place, self._options = f"{self.scheme}:{address}", options
        self.spec = self._wanted = spec
        """As the instrument was set; its ranges are those it answered."""

    @classmethod
    def open(cls, address: str, options: dict[str, Any]) -> InstrumentSource:
        """Open an instrument with options as text: those of its kind, and fields of its RadarSpec.

        Raises:
            InputError: it cannot be opened, does not answer, or refuses a setting.
            MissingExtra: its library is not installed.
        """
        own, spec = split_options(cls.settings, options, cls.preset, f"{cls.scheme}:{address}")
        return InstrumentSource(cls(address, spec, own), own, cls.scheme)

    @abstractmethod
    def start(self) -> None:
        """Open it, set it up, and let it measure.

        Raises:
            InputError: it is not there, is in use, does not answer, or refuses a setting.
        """

    @abstractmethod
    def scans(self) -> Iterator[Scan]:
        """Give scans without an end; an OSError tells that it is gone. Return now and then without a scan."""

    @abstractmethod
    def close(self) -> None:
        """Let it rest, and close the line."""

    @abstractmethod
    def health(self) -> list[str]:
        """Return what it says of itself, for the end of a run."""


class NotReadyError(InputError):
    """An instrument that cannot be started now; later it may be."""


def begin(instrument: Instrument) -> None:
    """Start an instrument, and let go of it where that fails.

    Raises:
        NotReadyError: its `start` fails.
    """
    try:
        instrument.start()
    except (OSError, InputError) as error:
        instrument.close()
        raise NotReadyError(_why(error), where=instrument.place, allowed=getattr(error, "allowed", "")) from None


class InstrumentOptions(LiveOptions):
    """Options of every instrument; all others are fields of its RadarSpec."""

    preset: str = Field("", description="radar preset or YAML file; none: that of the instrument")
    sensor: str = Field("", description="name of the radar; none: that of the port")
    duration_s: float | None = Field(None, gt=0, description="how long to measure [s]; none: until Ctrl-C")


def split_options(kind: type[Any], values: dict[str, Any], preset: str, where: str) -> tuple[Any, RadarSpec]:
    """Split options into those of the port and a RadarSpec.

    Raises:
        InputError: an option is unknown, or its value is not valid.
    """
    own = {name: value for name, value in values.items() if name in kind.model_fields}
    options = options_of(kind, own, where)
    known = [*kind.model_fields, *RadarSpec.model_fields]
    for name in values:
        if name not in known:
            raise InputError(f"no option {name!r}", where=where, allowed=", ".join(known))
    changes = {
        name: load_yaml(value, where=where) if isinstance(value, str) else value  # a mount is a group
        for name, value in values.items()
        if name not in own
    }
    return options, RadarSpec.preset(options.preset or preset, **changes)


def host_and_port(address: str, port: int, *, where: str, allowed: str) -> tuple[str, int]:
    """Split `HOST` or `HOST:PORT`; `port` is that of an instrument without one.

    Raises:
        InputError: it is no address.
    """
    host, _, given = address.partition(":")
    if not host or (given and not (given.isdecimal() and 0 < int(given) < 65536)):
        raise InputError(f"{address!r} is no address", where=where, allowed=allowed)
    return host, int(given or port)


class InstrumentClock:
    """Estimate this computer's time less the instrument's, and its drift, by a Kalman filter.

    A scan comes when the system hands it over, with a jitter of milliseconds. The instrument counts evenly. So the
    counter gives the distances between scans, and their arrivals the offset.
    """

    def __init__(self) -> None:
        self.jitter_s = FIRST_JITTER_S
        """Standard deviation of the arrivals about the estimate [s]."""
        self._device_s: float | None = None
        self._offset_s = self._drift = 0.0
        self._p = (1.0, 0.0, DRIFT**2)  # variances of offset and drift, and in the middle their covariance

    @property
    def drift_ppm(self) -> float:
        """How much faster this computer's clock runs [ppm]."""
        return self._drift * 1e6

    def at(self, device_s: float, arrived_s: float) -> float:
        """Return a scan's time on this computer's clock [s].

        Args:
            device_s: its time on the instrument's clock [s]; one that lies behind starts the estimate anew.
            arrived_s: when it came, on this computer's clock [s].
        """
        if self._device_s is None or device_s < self._device_s:
            self._offset_s, self._drift, self._p = arrived_s - device_s, 0.0, (self.jitter_s**2, 0.0, DRIFT**2)
            self._device_s = device_s
            return arrived_s
        step_s, self._device_s = device_s - self._device_s, device_s
        a, b, c = self._p
        a += step_s * (2 * b + step_s * c) + OFFSET_WALK_S**2 * step_s
        b, c = b + step_s * c, c + DRIFT_WALK**2 * step_s
        self._offset_s += self._drift * step_s
        wrong_s = arrived_s - device_s - self._offset_s
        spread = a + self.jitter_s**2
        late = max(wrong_s / (LATE_SIGMAS * math.sqrt(spread)), 1.0)
        gain_a, gain_b = a / (a + (late * self.jitter_s) ** 2), b / (a + (late * self.jitter_s) ** 2)
        self._offset_s += gain_a * wrong_s
        self._drift += gain_b * wrong_s
        self._p = ((1 - gain_a) * a, (1 - gain_a) * b, c - gain_b * b)
        self.jitter_s = math.sqrt((1 - MEMORY) * self.jitter_s**2 + MEMORY * (wrong_s / late) ** 2)
        return device_s + self._offset_s


class InstrumentSource(LiveSource):
    """Frames of one instrument, on this computer's clock by the instrument's counter.

    Args:
        instrument: what measures; it is started here.
        options: name, duration, and what is too late.
        name: of the radar, unless the options have one.
        log: takes lines for the user; None: they become warnings.

    Raises:
        InputError: the instrument cannot be started.
    """

    def __init__(
        self, instrument: Instrument, options: InstrumentOptions, name: str, *, log: Log | None = None
    ) -> None:
        super().__init__(log=log, lag_s=options.lag_s)
        self._instrument, self._options, self.where = instrument, options, instrument.place
        self._name = options.sensor or name
        self.counters = Counters(self._log)
        self._inbox: Inbox[Scan | str] = Inbox(self.counters, lag_s=options.lag_s)
        self._clock, self._last_ns, self._first_ns = InstrumentClock(), 0, 0
        self._scans: list[Scan] = []
        self._given_s = self._heard_s = time.monotonic()
        self._leaving = threading.Event()
        begin(instrument)
        self._thread = threading.Thread(target=self._receive, name=self.where, daemon=True)
        self._thread.start()

    @property
    def sensors(self) -> tuple[str, ...]:
        """The one radar."""
        return (self._name,)

    def _without_end(self) -> str:
        return "duration_s=SECONDS" if self._options.duration_s is None else ""

    def _receive(self) -> None:
        """Take scans until the end; where the instrument is gone, wait for it."""
        while not self._leaving.is_set():
            before_s: float | None = None
            try:
                for scan in self._instrument.scans():
                    if before_s is not None:
                        self._count_lost(scan.device_s - before_s)
                    before_s = scan.device_s
                    self._inbox.put(scan, topic=self._name, size=scan.samples.nbytes)
                    if self._leaving.is_set():
                        break
            except (OSError, InputError) as error:
                if not self._leaving.is_set():
                    self._inbox.put(f"{self.where}: {_why(error)}; waiting for it")
                    self._await()
        self._instrument.close()

    def _count_lost(self, step_s: float) -> None:
        """Count the scans that are missing in a step of the instrument's clock."""
        lost = round(step_s * self._instrument.spec.fps) - 1
        if lost > 0:
            self.counters.receive(self._name, lost)
            self.counters.drop(self._name, "lost", "did not come whole", count=lost)

    def _await(self) -> None:
        self._instrument.close()
        while not self._leaving.wait(RETRY_S):
            try:
                begin(self._instrument)
            except NotReadyError:
                continue
            self._inbox.put(f"{self.where}: measures again")
            return

    def _step(self, chunk: int, *, stopping: bool) -> Iterator[dict[str, Frames]]:
        item = self._inbox.get(BATCH_S)
        now_s = time.monotonic()
        if isinstance(item, str):
            self._log(item)
        elif item is not None:
            self._scans.append(item)
            self._heard_s = now_s
        elif (silent_s := now_s - self._heard_s) > PATIENCE_S:
            self._log_throttled(f"{self.where}: no scan for {silent_s:.0f} s", kind="silent")
        self._ended = stopping and not len(self._inbox)
        if self._scans and (len(self._scans) >= chunk or now_s - self._given_s >= BATCH_S or self._ended):
            scans, self._scans = self._scans, []
            yield {self._name: self._frames(scans)}
            self._given_s = time.monotonic()

    def _over(self) -> bool:
        wanted = self._options.duration_s
        return wanted is not None and self._first_ns > 0 and self._last_ns - self._first_ns >= wanted * 1e9

    def _frames(self, scans: list[Scan]) -> Frames:
        times = []
        for scan in scans:
            t_ns = round(self._clock.at(scan.device_s, scan.arrived_s) * 1e9)
            self._last_ns = max(t_ns, self._last_ns + 1000)
            self._first_ns = self._first_ns or self._last_ns
            times.append(self._last_ns)
        spec = self._instrument.spec
        samples = np.stack([scan.samples for scan in scans])
        return Frames(samples, spec.range_m, np.array(times), spec, sensor=self._name, unit=self._instrument.unit)

    def _lines(self) -> list[str]:
        lines = [f"{self.where}: {line}" for line in (*self.counters.lines(), *self._instrument.health())]
        if self._first_ns:
            lines.append(
                f"{self.where}: times by the instrument's counter, {self._clock.drift_ppm:+.0f} ppm off this clock; "
                f"scans came with a jitter of {1e3 * self._clock.jitter_s:.1f} ms"
            )
        return lines

    def _release(self) -> None:
        self._leaving.set()
        self._thread.join(5.0)


def _why(error: OSError | InputError) -> str:
    return error.what if isinstance(error, InputError) else f"is gone ({error.strerror or type(error).__name__})"
