"""Open links by place; a source and a sink of one program at one place share one link.

Other systems know one address per system. If two links announce it with different ports, peers use the last one.
"""

from __future__ import annotations

from typing import Literal

from ullage.ports.imc.link import Identity, Link, Wire
from ullage.ports.imc.options import LinkOptions, endpoint
from ullage.ports.imc.tcp import TcpWire
from ullage.ports.intake import Counters, Log
from ullage.ports.shared_links import SharedLinks

Role = Literal["source", "sink", "vehicle"]
_links: SharedLinks[Link] = SharedLinks()


def open_link(place: str, options: LinkOptions, me: Identity, *, role: Role, log: Log) -> Link:
    """Open a link to a place; `leave` closes it.

    Args:
        place: `tcp://host:port`, `udp://host:port`, or nothing.
        options: options of the link; an open link keeps the options that it was opened with.
        me: our identity.
        role: a source and a sink share a link; a vehicle has its own, since it takes another address.
        log: takes lines for the user.

    Raises:
        InputError: the place is not valid.
    """
    where = endpoint(place)
    key = (where, me.system_id, me.name, options.interface, options.port, options.xml)

    def make() -> Link:
        counters = Counters(log)
        wire = _wire(where, options, me, log, counters)
        return Link(wire, me, table=options.table(), log=log, listens=role != "sink", counters=counters)

    if role == "vehicle":
        return make()
    link, joined = _links.get(key, role, make, usable=lambda link: not link.finished)
    if joined:
        link.join(me, listens=role == "source")
    return link


def leave(link: Link, role: Role) -> None:
    """Close the link, unless the other role still uses it."""
    _links.leave(link, role)


def _wire(where: tuple[str, str, int], options: LinkOptions, me: Identity, log: Log, counters: Counters) -> Wire:
    kind, host, port = where
    table = options.table()
    if kind == "tcp":
        return TcpWire(
            host, port, table=table, silence_s=options.silence_s, reconnect=options.reconnect, log=log,
            counters=counters,
        )  # fmt: skip
    from ullage.ports.imc.udp import UdpWire

    return UdpWire(
        (host, port) if kind else None, table=table, own=me, interface=options.interface, port=options.port,
        silence_s=options.silence_s, reconnect=options.reconnect, log=log, counters=counters,
    )  # fmt: skip
