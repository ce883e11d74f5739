"""Open links by place; a source and a sink of one program at one place share one link.

Other systems know one address per system. If two links announce it with different ports, peers use the last one.
"""

from __future__ import annotations

import threading
from collections.abc import Hashable
from dataclasses import dataclass, field
from typing import Literal

from ullage.ports.imc.link import Identity, Link, Wire
from ullage.ports.imc.options import LinkOptions, endpoint
from ullage.ports.imc.tcp import TcpWire
from ullage.ports.intake import Counters, Log

Role = Literal["source", "sink", "vehicle"]


@dataclass(slots=True)
class _SharedLink:
    """An open link and the roles that use it."""

    link: Link
    roles: set[Role] = field(default_factory=set)


_open: dict[Hashable, _SharedLink] = {}
_lock = threading.Lock()


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
    with _lock:
        shared = _open.get(key)
        if shared is not None and role != "vehicle" and role not in shared.roles and not shared.link.finished:
            shared.roles.add(role)
            shared.link.join(me, listens=role == "source")
            return shared.link
    counters = Counters(log)
    wire = _wire(where, options, me, log, counters)
    link = Link(wire, me, table=options.table(), log=log, listens=role != "sink", counters=counters)
    with _lock:
        if role != "vehicle":
            _open[key] = _SharedLink(link, {role})
    return link


def leave(link: Link, role: Role) -> None:
    """Close the link, unless the other role still uses it."""
    with _lock:
        for key, shared in list(_open.items()):
            if shared.link is link:
                shared.roles.discard(role)
                if shared.roles:
                    return
                del _open[key]
    link.close()


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
