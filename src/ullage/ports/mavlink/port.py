"""Entry points of the MAVLink port: `mavlink:udp://HOST:PORT?key=value`."""

from __future__ import annotations

from typing import Any

from ullage.ports.protocol import Sink, Source


def open_source(address: str, options: dict[str, Any]) -> Source:
    """Open radars that follow the poses of an autopilot: `udp://HOST:PORT`, `udpin://HOST:PORT`, `tcp://HOST:PORT` or `serial:///dev/NAME`.

    Raises:
        InputError: an option cannot be used, or the address cannot be opened.
        MissingExtra: pymavlink or pyserial is not installed.
    """
    from ullage.ports.mavlink.source import source_of

    return source_of(address, options)


def open_sink(address: str, options: dict[str, Any]) -> Sink:
    """Open a sink of obstacle distances for an autopilot, at the same addresses.

    Raises:
        InputError: an option cannot be used, or the address cannot be opened.
        MissingExtra: pymavlink or pyserial is not installed.
    """
    from ullage.ports.cosimulation import options_of
    from ullage.ports.mavlink.options import SinkOptions
    from ullage.ports.mavlink.sink import MavlinkSink

    return MavlinkSink(address, options_of(SinkOptions, options, f"mavlink:{address}"))
