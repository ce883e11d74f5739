"""Opens links by their place; a source and a sink of one program that name one place share one link.

To others a system has one address: of two that announce the same one with different ports, they hear the last.
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
class _Held:
    """An open link, and who uses it."""

    link: Link
    roles: set[Role] = field(default_factory=set)


_open: dict[Hashable, _Held] = {}
_lock = threading.Lock()


def open_link(place: str, options: LinkOptions, me: Identity, *, role: Role, log: Log) -> Link:
    """A link to a place; to be left by `leave`.

    Args:
        place: `tcp://host:port`, `udp://host:port`, or nothing.
        options: how; where the link is open already they stand as it was opened.
        me: who we are.
        role: a source and a sink share a link; a vehicle, which takes another's address, has its own.
        log: told of waiting and of peers that go.

    Raises:
        InputError: the place cannot be understood.
    """
    where = endpoint(place)
    key = (where, me.system_id, me.name, options.interface, options.port, options.xml)
    with _lock:
        held = _open.get(key)
        if held is not None and role != "vehicle" and role not in held.roles and not held.link.finished:
            held.roles.add(role)
            held.link.join(me, listens=role == "source")
            return held.link
    counters = Counters(log)
    wire = _wire(where, options, me, log, counters)
    link = Link(wire, me, table=options.table(), log=log, listens=role != "sink", counters=counters)
    with _lock:
        if role != "vehicle":
            _open[key] = _Held(link, {role})
    return link


def leave(link: Link, role: Role) -> None:
    """Close the link, unless the other one of a source and a sink uses it still."""
    with _lock:
        for key, held in list(_open.items()):
            if held.link is link:
                held.roles.discard(role)
                if held.roles:
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
