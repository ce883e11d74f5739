"""Peers by UDP, which find each other by announcing themselves on known ports."""

from __future__ import annotations

import ipaddress
import re
import select
import socket
import time
from collections.abc import Sequence
from dataclasses import dataclass, field

from ullage.errors import InputError
from ullage.ports.imc.codec import Malformed, Packet, Parser, decode, readable
from ullage.ports.imc.link import Identity, Outbox, report_foreign_bytes
from ullage.ports.imc.table import Table
from ullage.ports.imc.tcp import Waker
from ullage.ports.intake import Counters, Log

GROUP = "224.0.75.69"
ANNOUNCE_PORTS = range(30100, 30105)
SERVICE = re.compile(r"imc\+udp://([\d.]{7,15}):(\d{1,5})(?!\d)/?", re.ASCII)
MOST_PEERS = 64
MOST_REPORTED = 100
TRIES = 16
Place = tuple[str, int]


@dataclass(slots=True)
class Peer:
    """Another system."""

    name: str
    place: Place
    uid: str = ""
    received_s: float = field(default_factory=time.monotonic)


class UdpWire:
    """Exchange packets with every peer that announces itself, and with one fixed place.

    Args:
        place: a peer that does not announce itself.
        table: the messages.
        own: our identity; our own announcements are ignored.
        interface: address of the interface to use; on 127.0.0.1 nothing leaves this machine.
        port: our port; if it is taken, the next free one.
        silence_s: longest silence of a peer before it is dropped [s].
        reconnect: wait for it to come back.
        log: takes lines for the user.
        counters: count damaged packets and peers above the limit.

    Raises:
        InputError: no port is free, or the interface is not there.
    """

    def __init__(
        self, place: Place | None, *, table: Table, own: Identity, interface: str, port: int, silence_s: float,
        reconnect: bool, log: Log, counters: Counters | None = None,
    ) -> None:  # fmt: skip
        self._counters = counters or Counters()
        self._table, self._me, self._interface, self._silence = table, own, interface, silence_s
        self._again, self._log = reconnect, log
        self._fixed = (_address(place[0]), place[1]) if place else None
        self._local = ipaddress.ip_address(_address(interface)).is_loopback
        self._waker = Waker()
        self._sock = _bound(interface, range(port, port + TRIES) if port else range(1))
        self._announce_sockets = _announce_sockets(interface)
        self._peers: dict[int, Peer] = {}
        self._reported: set[str] = set()
        self._there = False
        self._parser = Parser(table)

    @property
    def services(self) -> Sequence[str]:
        """Our address, as a URI."""
        return (f"imc+udp://{self._interface}:{self._sock.getsockname()[1]}/",)

    @property
    def connected(self) -> bool:
        """Whether a peer sent something lately, or the place is fixed."""
        return bool(self._peers) or self._fixed is not None

    @property
    def finished(self) -> bool:
        """Whether every peer has gone for good."""
        return self._there and not self._peers and not self._again

    def exchange(self, out: Outbox, timeout_s: float) -> list[Packet]:
        """Send what is possible, and receive packets until the timeout."""
        self._write(out)
        ready, _, _ = select.select([self._sock, *self._announce_sockets, self._waker.reading], [], [], timeout_s)
        if self._waker.reading in ready:
            self._waker.drain()
        packets = [packet for sock in ready if sock is not self._waker.reading for packet in self._read(sock)]
        self._drop_silent()
        return packets

    def _write(self, out: Outbox) -> None:
        places = {peer.place for peer in self._peers.values()} | ({self._fixed} if self._fixed else set())
        if not places:
            out.clear()
            return
        while (data := out.take()) is not None:
            for place in places:
                try:
                    self._sock.sendto(data, place)
                except OSError:  # nobody listens there now, or the packet is too long for a datagram
                    continue

    def _read(self, sock: socket.socket) -> list[Packet]:
        found = []
        for _ in range(256):  # so that a flood does not keep us from our other work
            try:
                data, (host, port) = sock.recvfrom(65535)
            except BlockingIOError:
                break
            except OSError:  # what we sent earlier met a closed port
                continue
            if self._local and not ipaddress.ip_address(host).is_loopback:
                continue
            try:
                packet = decode(data, table=self._table)
            except Malformed as error:
                self._counters.drop(f"udp://{host}", "bad", str(error))
                list(self._parser.feed(data))
                list(self._parser.finish())
                report_foreign_bytes(self._parser, f"udp://{host}:{port}", self._log, self._reported)
                continue
            if self._known(packet, host, port):
                found.append(packet)
        return found

    def _known(self, packet: Packet, host: str, port: int) -> bool:
        """Remember the peer; false for one that uses another's number."""
        ours = packet.name == "Announce" and self._me.uid in packet["services"]
        if ours or (packet.src == self._me.system_id and not self._me.shared):
            return packet.name == "Announce" and not ours  # a twin, of whom the link complains; not our own echo
        peer = self._peers.get(packet.src)
        if packet.name == "Announce":
            return self._announced(packet, host, peer)
        if peer is None:
            if self._fixed is not None and (host, port) == self._fixed:
                self._enter(packet.src, Peer(str(packet.src), (host, port)))
                return packet.src in self._peers
            return False  # as DUNE does: who has not announced itself is not listened to
        if host != peer.place[0]:
            self._twins(packet.src, peer.name, host)
            return False
        peer.received_s = time.monotonic()
        return True

    def _announced(self, packet: Packet, host: str, peer: Peer | None) -> bool:
        services, name = packet["services"], readable(packet["sys_name"])
        places = [(a, int(p)) for a, p in SERVICE.findall(services) if 0 < int(p) < 65536]
        uid = next((s for s in services.split(";") if "/uid/" in s), "")
        lately = peer is not None and time.monotonic() - peer.received_s < 3.0
        if peer is not None and lately and uid and peer.uid and uid[:200] != peer.uid:
            self._twins(packet.src, peer.name, name)
            return False
        reachable = next((p for p in places if p[0] == host), None)
        if reachable is None:
            return peer is not None
        if peer is None:
            self._enter(packet.src, Peer(name, reachable, uid[:200]))
            return packet.src in self._peers
        peer.place, peer.uid, peer.name, peer.received_s = reachable, uid[:200], name, time.monotonic()
        return True

    def _enter(self, number: int, peer: Peer) -> None:
        if len(self._peers) >= MOST_PEERS and peer.place != self._fixed:
            self._counters.drop("Announce", "lost", f"more than {MOST_PEERS} peers")
            return
        self._peers[number] = peer
        self._there = True

    def _twins(self, number: int, one: str, other: str) -> None:
        key = f"twins {number}"
        if key not in self._reported and len(self._reported) < MOST_REPORTED:
            self._reported.add(key)
            self._log(f"{one!r} and {other!r} both use the address {number:#06x}; only the first is listened to")

    def _drop_silent(self) -> None:
        now = time.monotonic()
        for number, peer in list(self._peers.items()):
            if now - peer.received_s > self._silence:
                del self._peers[number]
                self._log(f"{peer.name!r} has said nothing for {self._silence:g} s")

    def greet(self, announce: bytes) -> None:
        """Announce ourselves on this machine, and on the network where the interface is one."""
        places = [("127.0.0.1", port) for port in ANNOUNCE_PORTS] if self._local else []
        for place in (*places, *((GROUP, port) for port in ANNOUNCE_PORTS)):
            try:
                self._sock.sendto(announce, place)
            except OSError:  # no route for multicast: others still hear us on this machine
                continue

    def wake(self) -> None:
        """End a running `exchange` early."""
        self._waker.wake()

    def close(self) -> None:
        """Let go of the sockets."""
        self._sock.close()
        for sock in self._announce_sockets:
            sock.close()
        self._waker.close()


def _address(host: str) -> str:
    try:
        return socket.gethostbyname(host)
    except OSError:
        raise InputError(f"no such host {host!r}", where="imc") from None


def _bound(interface: str, ports: range) -> socket.socket:
    sock = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    sock.setblocking(False)
    sock.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 1 << 20)
    sock.setsockopt(socket.IPPROTO_IP, socket.IP_MULTICAST_TTL, 1)
    last: OSError | None = None
    for port in ports:
        try:
            sock.bind((interface, port))
            sock.setsockopt(socket.IPPROTO_IP, socket.IP_MULTICAST_IF, socket.inet_aton(_address(interface)))
        except OSError as error:
            last = error
            continue
        return sock
    sock.close()
    raise InputError(
        f"cannot listen on {interface}: {last}", where="imc", allowed="interface= and port= of this machine"
    )


def _announce_sockets(interface: str) -> list[socket.socket]:
    """Where announcements arrive: one of the known ports on this address, and the same port of the group."""
    for port in ANNOUNCE_PORTS:
        sock = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        sock.setblocking(False)
        try:
            sock.bind((interface, port))
        except OSError:
            sock.close()
            continue
        return [sock, *_group(interface, port)]
    return []


def _group(interface: str, port: int) -> list[socket.socket]:
    sock = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    sock.setblocking(False)
    try:
        sock.bind((GROUP, port))
        member = socket.inet_aton(GROUP) + socket.inet_aton(_address(interface))
        sock.setsockopt(socket.IPPROTO_IP, socket.IP_ADD_MEMBERSHIP, member)
    except OSError:  # multicast is not to be had here; announcements sent to our own address still arrive
        sock.close()
        return []
    return [sock]
