"""Live ports: `scheme:address?key=value` names a port, its peer and its options."""

from __future__ import annotations

import importlib
import importlib.util
import re
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from types import ModuleType
from typing import Any, Protocol, Self, runtime_checkable
from urllib.parse import parse_qsl

from ullage import plugins
from ullage.data import Frames
from ullage.errors import InputError
from ullage.ports.protocol import Sink, Source
from ullage.world.scene import Scene

SCHEME = re.compile(r"([A-Za-z][A-Za-z0-9+-]+):")
LIVE = {
    "ros2": "ullage.ports.ros2.port",
    "gazebo": "ullage.ports.gazebo.port",
    "gazebo-classic": "ullage.ports.gazebo.classic_port",
    "imc": "ullage.ports.imc.port",
    "mavlink": "ullage.ports.mavlink.port",
}
"""Scheme to the module with `open_source(address, options)` and `open_sink(address, options)`."""
ADDED: tuple[plugins.Group, plugins.Group] = ("ullage.sources", "ullage.sinks")
"""Entry point groups for live ports of other packages: each a function of the place and the options."""
LISTED = ", ".join(f"{scheme}:" for scheme in LIVE)


@runtime_checkable
class LiveSource(Protocol):
    """Source that measures continuously: its stream can be read once, and the past is not available."""

    scene: Scene | None  # the world, if the port knows it

    @property
    def sensors(self) -> tuple[str, ...]:
        """Names of the radars known so far."""

    def stream(self, chunk: int = 64) -> Iterator[dict[str, Frames]]:
        """Give frames with poses as they arrive, until the peer ends, the duration is over, or Ctrl-C."""

    def close(self) -> None:
        """Close sockets and nodes."""


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

    @property
    def known(self) -> bool:
        """Whether there is such a port."""
        return self.scheme in LIVE or any(self.scheme in plugins.names(group) for group in ADDED)

    def port(self) -> ModuleType:
        """Import the module of the port.

        Raises:
            InputError: it is not part of this version.
        """
        if self.scheme not in LIVE or importlib.util.find_spec(LIVE[self.scheme]) is None:
            raise InputError(
                f"live {self.scheme} is not part of this version", where=f"{self.scheme}:{self.place}", allowed=LISTED
            )
        return importlib.import_module(LIVE[self.scheme])

    def function(self, name: str) -> Callable[..., Any] | None:
        """Return another function of the port, such as `open_drone`; None if it has none."""
        found: Callable[..., Any] | None = getattr(self.port(), name, None) if self.scheme in LIVE else None
        return found

    def source(self) -> Source:
        """Open the port as a source."""
        added = None if self.scheme in LIVE else plugins.load("ullage.sources", self.scheme)
        source: Source = (added or self.port().open_source)(self.place, self.options)
        return source

    def sink(self) -> Sink:
        """Open the port as a sink."""
        added = None if self.scheme in LIVE else plugins.load("ullage.sinks", self.scheme)
        sink: Sink = (added or self.port().open_sink)(self.place, self.options)
        return sink
