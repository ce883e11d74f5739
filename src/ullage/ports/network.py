"""Places on a network, UDP sockets at them, and links that a source and a sink of one program share."""

from __future__ import annotations

import re
import socket
import threading
from collections.abc import Callable, Hashable, Iterable, Iterator, Mapping
from typing import Generic, NamedTuple, TypeVar

from ullage.errors import InputError, shown
from ullage.flow import Closing

PLACE = re.compile(r"(\w+)://([^/:\s]+)(?::(\d+))?/?", re.ASCII)
MOST_PORT = 65535
BUFFER_BYTES = 1 << 20
AT_ONCE = 256
"""Datagrams that are read before other work."""


class Place(NamedTuple):
    """Address of a peer."""

    kind: str
    host: str
    port: int = 0


def place_of(text: str, ports: Mapping[str, int], *, where: str, allowed: str) -> Place:
    """Split `kind://HOST:PORT`.

    Args:
        text: of the user.
        ports: usual port of each kind; 0: it must be given.
        where: for messages.
        allowed: for messages.

    Raises:
        InputError: it is not such a place, or its port is out of range.
    """
    found = PLACE.fullmatch(text)
    if found is None or found[1] not in ports or not (found[3] or ports[found[1]]):
        raise InputError(f"{shown(text)} is not a place", where=where, allowed=allowed)
    port = found[3] or str(ports[found[1]])
    if len(port) > len(str(MOST_PORT)) or not 0 < int(port) <= MOST_PORT:
        raise InputError(f"port {shown(port)}", where=where, allowed=f"1 to {MOST_PORT}")
    return Place(found[1], found[2], int(port))


def address_of(host: str, *, where: str) -> str:
    """Return the IPv4 address of a host.

    Raises:
        InputError: there is no such host.
    """
    try:
        return socket.gethostbyname(host)
    except OSError:
        raise InputError(f"no such host {host!r}", where=where, allowed="a name or an IPv4 address") from None


def udp_socket() -> socket.socket:
    """Return a UDP socket that never waits."""
    sock = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    sock.setblocking(False)
    return sock


def bound_udp(host: str, ports: Iterable[int], *, where: str) -> socket.socket:
    """Return a UDP socket at the first port that is free.

    Args:
        host: address of this machine; empty: any.
        ports: to try in order; 0: any that is free.
        where: for messages.

    Raises:
        InputError: none is free, or the address is not of this machine.
    """
    sock, tried, why = udp_socket(), 0, ""
    sock.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, BUFFER_BYTES)
    for port in ports:
        try:
            sock.bind((host, port))
        except OSError as error:
            tried, why = port, error.strerror or str(error)
        else:
            return sock
    sock.close()
    what = f"cannot listen on {host or 'any address'} port {tried}: {why}"
    raise InputError(what, where=where, allowed="an address and a free port of this machine")


def datagrams(sock: socket.socket) -> Iterator[tuple[bytes, tuple[str, int]]]:
    """Give the datagrams that wait at a socket with their senders, so many at once that a flood holds up nothing."""
    for _ in range(AT_ONCE):
        try:
            yield sock.recvfrom(MOST_PORT)  # no datagram is longer
        except BlockingIOError:
            return
        except OSError:  # what was sent earlier met a closed port
            continue


def join_group(sock: socket.socket, group: str, interface: str) -> None:
    """Receive the datagrams of a multicast group on the interface with this address.

    Raises:
        OSError: no interface has it, or it knows no multicast.
    """
    sock.setsockopt(socket.IPPROTO_IP, socket.IP_ADD_MEMBERSHIP, socket.inet_aton(group) + socket.inet_aton(interface))


L = TypeVar("L", bound=Closing)


class SharedLinks(Generic[L]):
    """Open links by key, each with the roles that use it. Each role uses a link once at most."""

    def __init__(self) -> None:
        self._open: dict[Hashable, tuple[L, set[str]]] = {}
        self._lock = threading.Lock()

    def get(self, key: Hashable, role: str, make: Callable[[], L], *, usable: Callable[[L], bool]) -> tuple[L, bool]:
        """Return a usable link that this role does not use yet, or a new one, and whether it was open already.

        Args:
            key: of the place and all settings that the roles must have in common.
            role: that uses the link from now on.
            make: opens a new link.
            usable: whether an open link can still be used.
        """
        with self._lock:
            if found := self._open.get(key):
                link, roles = found
                if role not in roles and usable(link):
                    roles.add(role)
                    return link, True
            link = make()
            self._open[key] = link, {role}
            return link, False

    def leave(self, link: L, role: str) -> None:
        """Close a link, unless another role still uses it."""
        with self._lock:
            for key, (shared, roles) in list(self._open.items()):
                if shared is link:
                    roles.discard(role)
                    if roles:
                        return
                    del self._open[key]
        link.close()
