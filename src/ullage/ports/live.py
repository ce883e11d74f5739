"""Live ports: `scheme:address?key=value` names a port, its peer and its options."""

from __future__ import annotations

import importlib
import math
import re
import time
from abc import abstractmethod
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Any, Literal, NamedTuple, Self, TypeVar
from urllib.parse import parse_qsl

from ullage import plugins
from ullage.data import Frames, gathered
from ullage.errors import InputError
from ullage.flow import Closing
from ullage.ports.intake import PATIENCE_S, Counters, Inbox, Log, warn
from ullage.ports.protocol import Passing, Source, one_or_all
from ullage.specs import Spec
from ullage.world.scene import Scene

SCHEME = re.compile(r"([A-Za-z][A-Za-z0-9+-]+):")
Part = Literal["source", "sink", "drone", "controls", "poses"]


class Port(NamedTuple):
    """Parts of a live port, each `module.name` beneath `ullage.ports`; empty: the port has no such part.

    A part is a class of a place and its options, which `settings` of the class names, or a function of a place and a
    dict of options.
    """

    source: str
    sink: str = ""
    drone: str = ""  # takes commands; of a place and the options that its `settings` name
    controls: str = ""  # gives commands
    poses: str = ""  # gives poses of a vehicle, as `pose_events.Feed` does


LIVE = {
    "ros2": Port(
        "ros2.source.open_source",
        "ros2.sink.Ros2Sink",
        "ros2.commands.RosDrone",
        "ros2.commands.open_controls",
        "ros2.cosimulation.open_poses",
    ),
    "gazebo": Port(
        "gazebo.transport_source.open_source", "gazebo.topics.open_transport_sink", "gazebo.topics.GazeboDrone"
    ),
    "gazebo-classic": Port("gazebo.classic_source.open_source", "gazebo.topics.open_classic_sink"),
    "imc": Port("imc.source.ImcSource", "imc.frames.ImcSink", "imc.backseat.ImcDrone", poses="imc.source.PoseFeed"),
    "mavlink": Port(
        "mavlink.source.open_source",
        "mavlink.sink.MavlinkSink",
        "mavlink.drone.MavlinkDrone",
        poses="mavlink.source.open_poses",
    ),
    "x4": Port("instruments.x4.open_source"),
    "mrm": Port("instruments.mrm.open_source"),
    "acconeer": Port("instruments.acconeer.open_source"),
}
"""Ports by scheme."""
ADDED: tuple[plugins.Group, plugins.Group] = ("ullage.sources", "ullage.sinks")
"""Entry point groups for live ports of other packages: each a function of the place and the options."""
LISTED = ", ".join(f"{scheme}:" for scheme in LIVE)
INSTRUMENTS = tuple(scheme for scheme, port in LIVE.items() if port.source.startswith("instruments."))
LISTED_POSES = ", ".join(f"{scheme}:" for scheme, port in LIVE.items() if port.poses)
LISTED_SINKS = ", ".join(f"{scheme}:" for scheme, port in LIVE.items() if port.sink)


def named(place: str) -> Any:
    """Import what `module.name` beneath `ullage.ports` names."""
    module, _, name = place.rpartition(".")
    return getattr(importlib.import_module(f"ullage.ports.{module}"), name)


class LiveSource(Closing, Source):
    """Source that measures continuously: its stream can be read once, and the past is not available.

    Args:
        log: takes lines for the user; None: they become warnings.
        lag_s: what is later than this is left out [s]; None: nothing is.
    """

    where = "frames"
    """What complaints name."""
    counters: Counters
    """Count what is received and dropped."""
    scene: Scene | None = None
    """The world, if the port knows it."""

    def __init__(self, *, log: Log | None = None, lag_s: float | None = None) -> None:
        self._log, self._logged_s = log or warn, dict[str, float]()
        self.lag_s = lag_s
        self.passing = Passing()
        self._limit_s: float | None = None  # what is later is left out; None: nothing is
        self._inbox: Inbox[Any] | None = None  # what waits to be used, if it waits here
        self._stopping = self._ended = self._closed = False

    def stream(self, chunk: int = 64) -> Iterator[dict[str, Frames]]:
        """Give frames as they come, at most about `chunk` of each radar at once, until Ctrl-C, an end, or `stop`."""
        try:
            while not (self._ended or self._closed or self._over()):
                yield from self._step(chunk, stopping=self._stopping)
                self.counters.report()
        finally:
            self._finish()
            for line in self._lines():
                self._log(line)
            self.close()

    @abstractmethod
    def _step(self, chunk: int, *, stopping: bool) -> Iterator[dict[str, Frames]]:
        """Wait a moment for messages and give the frames that they make.

        Args:
            chunk: most frames of each radar at once.
            stopping: nothing more is waited for; set `_ended` once nothing is left.
        """

    def _over(self) -> bool:
        """Return whether the given duration has passed."""
        return False

    def _finish(self) -> None:
        """Drop what still waits, at the end of the stream."""

    def _lines(self) -> list[str]:
        """Return what the user should know at the end of the stream."""
        return self.counters.lines()

    def frames(self, sensor: str | None = None) -> Frames | dict[str, Frames]:
        """Return all frames until the peer ends or the duration is over.

        Raises:
            InputError: no end is set, no frames came, or there is no such sensor.
        """
        if ends := self._without_end():
            raise InputError("a live port has no end", where=self.where, allowed=f"{ends}, or stream()")
        whole = gathered(self.stream())
        if not whole:
            raise InputError("no frames came", where=self.where)
        return one_or_all(whole, sensor)

    def _without_end(self) -> str:
        """Return the options that would end the stream; empty if it ends."""
        return ""

    @property
    def behind_s(self) -> float:
        """How long the oldest message waits already [s]."""
        return self._inbox.behind_s if self._inbox is not None else 0.0

    def keep_up(self, lag_s: float) -> None:
        """From now on leave out what is later than this [s]."""
        self._limit_s = lag_s
        if self._inbox is not None:
            self._inbox.lag_s = lag_s

    def stop(self) -> None:
        """End the stream after what has come so far; safe to call from another thread."""
        if self._inbox is not None:
            self._inbox.lag_s = None
        self._stopping = True

    def close(self) -> None:
        """Close sockets and end threads."""
        if not self._closed:
            self._closed = True
            self._release()

    @abstractmethod
    def _release(self) -> None:
        """Close sockets and end threads; called once."""

    def _log_throttled(self, text: str, *, kind: str = "") -> None:
        """Log a line, but the same kind at most once every few seconds."""
        now = time.monotonic()
        if now - self._logged_s.get(kind or text, -PATIENCE_S) >= PATIENCE_S:
            self._logged_s[kind or text] = now
            self._log(text)


@dataclass(frozen=True, slots=True)
class Address:
    """Scheme, place and options of a live port."""

    scheme: str
    place: str
    options: dict[str, Any]

    @classmethod
    def of(cls, target: object, **options: Any) -> Self | None:
        """Split `scheme:place?key=value&key=value`; return None for another form.

        Args:
            target: text of the user.
            **options: override those of the target.

        Raises:
            InputError: an option is not key=value, or comes twice.
        """
        text = str(target)
        found = SCHEME.match(text)
        if not found:
            return None
        place, _, query = text[found.end() :].partition("?")
        try:
            pairs = parse_qsl(query, keep_blank_values=True, strict_parsing=bool(query))
        except ValueError:
            raise InputError(f"cannot read the options {query!r}", where=text, allowed="key=value&key=value") from None
        keys = [key for key, _ in pairs]
        if twice := next((key for key in keys if keys.count(key) > 1), None):
            raise InputError(f"option {twice!r} comes twice", where=text)
        return cls(found[1].lower(), place, dict(pairs) | options)

    def __str__(self) -> str:
        """Return it without its options."""
        return f"{self.scheme}:{self.place}"

    @property
    def known(self) -> bool:
        """Whether there is such a port."""
        return self.scheme in LIVE or any(self.scheme in plugins.names(group) for group in ADDED)

    def part(self, name: Part) -> Callable[..., Any] | None:
        """Return what opens a part of the port; None if the port has no such part."""
        if self.scheme in LIVE:
            place = getattr(LIVE[self.scheme], name)
            return named(place) if place else None
        group = {"source": ADDED[0], "sink": ADDED[1]}.get(name)
        return plugins.load(group, self.scheme) if group is not None else None

    def open(self, name: Part) -> Any:
        """Open a part of the port with the options of the address.

        Raises:
            InputError: there is no such part, or an option is not valid.
        """
        made, where = self.part(name), str(self)
        if made is None:
            raise InputError(f"live {self.scheme} is not part of this version", where=where, allowed=LISTED)
        kind = getattr(made, "settings", None)
        return made(self.place, self.options if kind is None else options_of(kind, self.options, where))


Options = TypeVar("Options", bound=Spec)


def options_of(kind: type[Options], values: dict[str, Any], where: str) -> Options:
    """Return the checked options of a port.

    Raises:
        InputError: an option is unknown, or its value is not valid.
    """
    known = kind.model_fields
    for name in values:
        if name not in known:
            raise InputError(f"no option {name!r}", where=where, allowed=", ".join(known))
    return kind(**values)


def point_of(text: str, name: str, *, where: str, yaw: bool = False) -> tuple[float, ...]:
    """Read the x, y, z [m] of a point, and with `yaw` a heading [deg] if one is given, with commas between them.

    Raises:
        InputError: there are too many or too few numbers, or one is not finite.
    """
    try:
        numbers = tuple(float(part) for part in text.split(","))
    except ValueError:
        numbers = ()
    if len(numbers) not in (3, 3 + yaw) or not all(map(math.isfinite, numbers)):
        allowed = "X,Y,Z or X,Y,Z,YAW in metres and degrees" if yaw else "X,Y,Z in metres"
        raise InputError(f"{name} is {text!r}", where=where, allowed=allowed)
    return numbers
