"""Entry points of the IMC port and of DUNE's logs: `imc:tcp://HOST:PORT?key=value`."""

from __future__ import annotations

from pathlib import Path
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


def open_log(path: Path, options: dict[str, Any]) -> Source:
    """Open a log of DUNE."""
    from ullage.ports.cosimulation import options_of
    from ullage.ports.imc.lsf import LsfSource
    from ullage.ports.imc.options import LogSourceOptions

    return LsfSource(path, options_of(LogSourceOptions, options, "imc"))


def write_log(path: Path, options: dict[str, Any]) -> Sink:
    """Open a new log in DUNE's format."""
    from ullage.ports.cosimulation import options_of
    from ullage.ports.imc.lsf import LsfSink
    from ullage.ports.imc.options import LogOptions

    return LsfSink(path, options_of(LogOptions, options, "imc"))
