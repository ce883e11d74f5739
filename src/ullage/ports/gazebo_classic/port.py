"""Entry points of the Gazebo Classic port: `gazebo-classic:HOST:PORT?model=NAME&key=value`."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from ullage.ports.protocol import Sink, Source

__all__ = ["open_sink", "open_source"]


def open_source(address: str, options: dict[str, Any]) -> Source:
    """Open radars on a model in a running gzserver: `gazebo-classic:HOST:PORT?model=NAME&key=value`."""
    from ullage.ports.gazebo_classic.source import source_of

    return source_of(address, options)


def open_sink(address: str, options: dict[str, Any]) -> Sink:
    """Open gzserver's topics for frames from any source: `gazebo-classic:HOST:PORT?model=NAME&key=value`."""
    from ullage.ports.gazebo_classic.sink import ClassicSink

    return ClassicSink(address, options)
