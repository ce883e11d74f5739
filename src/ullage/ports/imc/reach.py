"""Opens links by their place; within one program everything that names one place shares one link."""

from __future__ import annotations

from collections.abc import Callable

from ullage.ports.imc.link import Identity, Link, Wire
from ullage.ports.imc.options import LinkOptions, endpoint
from ullage.ports.imc.tcp import TcpWire


def open_link(place: str, options: LinkOptions, me: Identity, *, say: Callable[[str], None]) -> Link:
    """A link to a place.

    Raises:
        InputError: the place cannot be understood.
    """
    kind, host, port = endpoint(place)
    table = options.table()
    wire: Wire
    if kind == "tcp":
        wire = TcpWire(
            host, port, table=table, silence_s=options.silence_s, reconnect=options.reconnect, say=say
        )  # fmt: skip
    else:
        from ullage.ports.imc.udp import UdpWire

        wire = UdpWire(
            (host, port) if kind else None, table=table, own=me, interface=options.interface, port=options.port,
            silence_s=options.silence_s, reconnect=options.reconnect, say=say,
        )  # fmt: skip
    return Link(wire, me, table=table, say=say)
