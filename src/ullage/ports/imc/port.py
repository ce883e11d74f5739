"""Entry points of the IMC port: `imc:tcp://HOST:PORT?key=value`."""

from __future__ import annotations

from typing import Any

from ullage.ports.protocol import Sink, Source


def open_source(address: str, options: dict[str, Any]) -> Source:
    """Receive from a bus: `tcp://host:port`, `udp://host:port`, or nothing for peers that announce themselves."""
    from ullage.ports.cosimulation import options_of
    from ullage.ports.imc.options import SourceOptions
    from ullage.ports.imc.source import ImcSource

    return ImcSource(address, options_of(SourceOptions, options, "imc"))


def open_sink(address: str, options: dict[str, Any]) -> Sink:
    """Send on a bus, at the same addresses."""
    from ullage.ports.cosimulation import options_of
    from ullage.ports.imc.options import SinkOptions
    from ullage.ports.imc.sink import ImcSink

    return ImcSink(address, options_of(SinkOptions, options, "imc"))
