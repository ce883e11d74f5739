"""Sockets that carry packets: the client of a TCP server such as DUNE's Transports.TCP.Server, and UDP.

UDP peers find each other by announcing themselves on known ports.
"""

from __future__ import annotations

import ipaddress
import re
import select
import socket
import time
import uuid
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass, field

from ullage.ports.imc.codec import NOBODY, Malformed, Message, Packet, Parser, decode, make, readable
from ullage.ports.imc.options import LinkOptions
from ullage.ports.imc.table import Table
from ullage.ports.intake import Counters, Inbox, Log, Once
from ullage.ports.network import address_of, bound_udp, datagrams, join_group, udp_socket

MOBILE_SENSOR = 7
REPORT = 0
OUTBOX_BYTES = 8_000_000
AT_ONCE = 65536
GROUP = "224.0.75.69"
ANNOUNCE_PORTS = range(30100, 30105)
SERVICE = re.compile(r"imc\+udp://([\d.]{7,15}):(\d{1,5})(?!\d)/?", re.ASCII)
MOST_PEERS = 64
TRIES = 16
Place = tuple[str, int]


@dataclass(frozen=True, slots=True)
class Entity:
    """A part of a system that others see by its label."""

    id: int
    label: str
    component: str = ""


@dataclass(slots=True)
class Identity:
    """Our identity on the wire."""

    system_id: int
    name: str
    sys_type: int = MOBILE_SENSOR
    entities: list[Entity] = field(default_factory=list)
    shared: bool = False  # another system on the bus has our address on purpose
    uid: str = field(default_factory=lambda: uuid.uuid4().hex[:16])
    lat_rad: float = 0.0
    lon_rad: float = 0.0
    height_m: float = 0.0

    def announce(self, services: Sequence[str], table: Table) -> Message:
        """Return the message that announces us."""
        known = [f"ullage://0.0.0.0/uid/{self.uid}", "imc+info://0.0.0.0/version/5.4.31", *services]
        return make(
            "Announce", table=table, sys_name=self.name, sys_type=self.sys_type, owner=NOBODY, lat=self.lat_rad,
            lon=self.lon_rad, height=self.height_m, services=";".join(known),
        )  # fmt: skip

    def entity_list(self, table: Table) -> Message:
        """Return the labels and numbers of our parts."""
        text = ";".join(f"{e.label}={e.id}" for e in self.entities)
        return make("EntityList", table=table, op=REPORT, list=text)


def own_identity(options: LinkOptions) -> Identity:
    """Return who we are by the options of a link: a system with one part of its own name."""
    return Identity(options.system_id, options.name, entities=[Entity(1, options.name, "ullage")])


class Wire:
    """What both kinds of connection share: limits, counts, and a way to end a running `exchange` early.

    Args:
        options: when a silent peer is dropped, and whether it is waited for.
        table: the messages.
        log: takes lines for the user.
        counters: count damaged packets.
    """

    def __init__(self, options: LinkOptions, table: Table, log: Log, counters: Counters) -> None:
        self._silence, self._again, self.table = options.silence_s, options.reconnect, table
        self.log, self.counters, self._parser = log, counters, Parser(table)
        self._once = Once(log)
        self._woken, self._waking = socket.socketpair()
        self._woken.setblocking(False)
        self._waking.setblocking(False)

    @property
    def services(self) -> Sequence[str]:
        """Our services, as URIs."""
        return ()

    def wake(self) -> None:
        """End a running `exchange` early."""
        with suppress(OSError):  # full, so it will wake anyway; or closed
            self._waking.send(b"!")

    def close(self) -> None:
        """Close the sockets."""
        self._woken.close()
        self._waking.close()

    def _wait(
        self, reading: Sequence[socket.socket], writing: Sequence[socket.socket], timeout_s: float
    ) -> tuple[list[socket.socket], bool]:
        """Wait until the timeout or `wake`; return the readable sockets, and whether one takes bytes."""
        ready, writable, _ = select.select([*reading, self._woken], writing, [], timeout_s)
        if self._woken in ready:
            ready.remove(self._woken)
            with suppress(OSError):
                while self._woken.recv(4096):
                    pass
        return ready, bool(writable)

    def _report_foreign_bytes(self, where: str) -> None:
        """Log once that a peer speaks another version, or no IMC at all."""
        parser = self._parser
        if parser.strange > 1 and parser.version:
            major, minor = parser.version
            self._once(f"{where} speaks IMC {major}.{minor}; this port speaks 5.4", kind="version")
        if parser.garbage > 4096:
            self._once(f"{where} sends bytes that are no IMC; they are passed over", kind="garbage")


class TcpWire(Wire):
    """Keep a connection to one server, and connect again when it is lost.

    Args:
        place: host and port of the server.
        options: when a silent server is dropped, and whether to connect again.
        table: the messages.
        log: takes lines for the user.
        counters: count damaged packets.
    """

    def __init__(self, place: Place, options: LinkOptions, table: Table, log: Log, counters: Counters) -> None:
        super().__init__(options, table, log, counters)
        self._place, self._where = place, f"tcp://{place[0]}:{place[1]}"
        self._sock: socket.socket | None = None
        self._was_there = False
        self._next_try = self._received_s = 0.0
        self._wait_s, self._damaged = 0.25, 0
        self._rest = memoryview(b"")

    @property
    def connected(self) -> bool:
        """Whether the connection is open."""
        return self._sock is not None

    @property
    def finished(self) -> bool:
        """Whether it is lost for good."""
        return self._was_there and self._sock is None and not self._again

    def exchange(self, out: Inbox[bytes], timeout_s: float) -> list[Packet]:
        """Send and receive what is possible; wait until the timeout if nothing is."""
        sock = self._sock or self._connect(timeout_s)
        if sock is None:
            return []
        if not len(self._rest):
            self._rest = memoryview(out.get(0.0) or b"")
        ready, writable = self._wait([sock], [sock] if len(self._rest) else [], timeout_s)
        if writable:
            self._write(sock, out)
        packets = self._read(sock) if sock in ready else []
        if self._sock is not None and time.monotonic() - self._received_s > self._silence:
            self.log(f"{self._where} has said nothing for {self._silence:g} s; connecting anew")
            self._drop()
        return packets

    def _connect(self, timeout_s: float) -> socket.socket | None:
        now = time.monotonic()
        if self.finished or now < self._next_try:
            self._wait([], [], timeout_s)
            return None
        try:
            sock = socket.create_connection(self._place, timeout=2.0)
        except OSError as error:
            self._once(f"waiting for {self._where} ({error.strerror or error})", kind="waiting")
            self._next_try, self._wait_s = now + self._wait_s, min(2 * self._wait_s, 2.0)
            return None
        if sock.getsockname() == sock.getpeername():  # the socket connected to itself: nobody listens there
            sock.close()
            self._next_try = now + self._wait_s
            return None
        sock.setblocking(False)
        sock.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        sock.setsockopt(socket.SOL_SOCKET, socket.SO_KEEPALIVE, 1)
        self._sock, self._was_there, self._wait_s, self._received_s = sock, True, 0.25, time.monotonic()
        self._once.again("waiting")
        self._parser, self._damaged = Parser(self.table), 0
        return sock

    def _write(self, sock: socket.socket, out: Inbox[bytes]) -> None:
        try:
            while len(self._rest):
                self._rest = self._rest[sock.send(self._rest) :]
                if not len(self._rest):
                    self._rest = memoryview(out.get(0.0) or b"")
        except BlockingIOError:
            pass
        except OSError:
            self._drop()

    def _read(self, sock: socket.socket) -> list[Packet]:
        try:
            data = sock.recv(AT_ONCE)
        except BlockingIOError:
            return []
        except OSError:
            data = b""
        if not data:
            self._drop()
            return []
        self._received_s = time.monotonic()
        packets = list(self._parser.feed(data))
        fresh, self._damaged = self._parser.damaged - self._damaged, self._parser.damaged
        self.counters.drop(self._where, "bad", "a packet is damaged or cut", count=fresh)
        self._report_foreign_bytes(self._where)
        return packets

    def _drop(self) -> None:
        if self._sock is not None:
            self._sock.close()
        self._sock, self._rest = None, memoryview(b"")
        self._next_try = time.monotonic() + self._wait_s

    def greet(self, announce: bytes) -> None:
        """Do nothing: only the server receives."""

    def close(self) -> None:
        """Close the connection."""
        self._drop()
        super().close()


@dataclass(slots=True)
class Peer:
    """Another system."""

    name: str
    place: Place
    uid: str = ""
    received_s: float = field(default_factory=time.monotonic)


class UdpWire(Wire):
    """Exchange packets with every peer that announces itself, and with one fixed place.

    Args:
        place: a peer that does not announce itself, or None.
        own: our identity; our own announcements are ignored.
        options: the interface (on 127.0.0.1 nothing leaves this machine), the port or the next free one, and what to
            do about silent peers.
        table: the messages.
        log: takes lines for the user.
        counters: count damaged packets and peers above the limit.

    Raises:
        InputError: no port is free, or the interface is not there.
    """

    def __init__(
        self, place: Place | None, own: Identity, options: LinkOptions, table: Table, log: Log, counters: Counters
    ) -> None:
        super().__init__(options, table, log, counters)
        self._me, self._interface, port = own, options.interface, options.port
        self._fixed = (address_of(place[0], where="imc"), place[1]) if place else None
        self._local = ipaddress.ip_address(address_of(self._interface, where="imc")).is_loopback
        self._sock = _bound(self._interface, range(port, port + TRIES) if port else range(1))
        self._announce_sockets = _announce_sockets(self._interface)
        self._peers: dict[int, Peer] = {}
        self._there = False

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

    def exchange(self, out: Inbox[bytes], timeout_s: float) -> list[Packet]:
        """Send what is possible, and receive packets until the timeout."""
        self._write(out)
        ready, _ = self._wait([self._sock, *self._announce_sockets], [], timeout_s)
        packets = [packet for sock in ready for packet in self._read(sock)]
        self._drop_silent()
        return packets

    def _write(self, out: Inbox[bytes]) -> None:
        places = {peer.place for peer in self._peers.values()} | ({self._fixed} if self._fixed else set())
        if not places:
            out.clear()
            return
        while (data := out.get(0.0)) is not None:
            for place in places:
                try:
                    self._sock.sendto(data, place)
                except OSError:  # nobody listens there now, or the packet is too long for a datagram
                    continue

    def _read(self, sock: socket.socket) -> list[Packet]:
        found = []
        for data, (host, port) in datagrams(sock):
            if self._local and not ipaddress.ip_address(host).is_loopback:
                continue
            try:
                packet = decode(data, table=self.table)
            except Malformed as error:
                self.counters.drop(f"udp://{host}", "bad", str(error))
                list(self._parser.feed(data))
                list(self._parser.finish())
                self._report_foreign_bytes(f"udp://{host}:{port}")
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
            self.counters.drop("Announce", "lost", f"more than {MOST_PEERS} peers")
            return
        self._peers[number] = peer
        self._there = True

    def _twins(self, number: int, one: str, other: str) -> None:
        text = f"{one!r} and {other!r} both use the address {number:#06x}; only the first is listened to"
        self._once(text, kind=f"twins {number}")

    def _drop_silent(self) -> None:
        now = time.monotonic()
        for number, peer in list(self._peers.items()):
            if now - peer.received_s > self._silence:
                del self._peers[number]
                self.log(f"{peer.name!r} has said nothing for {self._silence:g} s")

    def greet(self, announce: bytes) -> None:
        """Announce ourselves on this machine, and on the network where the interface is one."""
        places = [("127.0.0.1", port) for port in ANNOUNCE_PORTS] if self._local else []
        for place in (*places, *((GROUP, port) for port in ANNOUNCE_PORTS)):
            try:
                self._sock.sendto(announce, place)
            except OSError:  # no route for multicast: others still hear us on this machine
                continue

    def close(self) -> None:
        """Let go of the sockets."""
        super().close()
        for sock in (self._sock, *self._announce_sockets):
            sock.close()


def _bound(interface: str, ports: range) -> socket.socket:
    sock, here = bound_udp(interface, ports, where="imc"), socket.inet_aton(address_of(interface, where="imc"))
    sock.setsockopt(socket.IPPROTO_IP, socket.IP_MULTICAST_TTL, 1)
    sock.setsockopt(socket.IPPROTO_IP, socket.IP_MULTICAST_IF, here)
    return sock


def _announce_sockets(interface: str) -> list[socket.socket]:
    """Where announcements arrive: one of the known ports on this address, and the same port of the group."""
    for port in ANNOUNCE_PORTS:
        sock = udp_socket()
        try:
            sock.bind((interface, port))
        except OSError:
            sock.close()
            continue
        return [sock, *_group(interface, port)]
    return []


def _group(interface: str, port: int) -> list[socket.socket]:
    sock = udp_socket()
    try:
        sock.bind((GROUP, port))
        join_group(sock, GROUP, address_of(interface, where="imc"))
    except OSError:  # multicast is not to be had here; announcements sent to our own address still arrive
        sock.close()
        return []
    return [sock]
