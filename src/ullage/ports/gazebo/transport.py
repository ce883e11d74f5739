"""A peer of Gazebo Transport: finds topics by multicast, sends and receives messages over ZeroMQ.

ZeroMQ signals what comes by a descriptor that is readable once for any number of messages, and any call may take the
signal. So every socket is read until it is empty, also after each call that may have taken it. Nothing polls a socket:
a poll takes the first part of a message, and libzmq aborts if the connection is cut then (`!_more`, issue 2163).
"""

from __future__ import annotations

import contextlib
import getpass
import os
import queue
import socket
import struct
import time
import uuid
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

from ullage.errors import InputError, need
from ullage.ports.gazebo.messages import gz
from ullage.ports.gazebo.peer import MOST_WAITING, Peer, ProcessLeft, Received, TopicOffered
from ullage.ports.network import datagrams, join_group, udp_socket

HEARTBEAT_S, SILENCE_S = 1.0, 3.0
"""Time between two heartbeats, and the silence after which a peer counts as gone [s]."""
MOST_OFFERS = 10_000
"""Greatest number of known publishers; further ones are ignored."""
MOST_BYTES = 64 * 2**20
"""Longest message [bytes]; the publisher of a longer one is disconnected."""
ADVERTISE, SUBSCRIBE, UNADVERTISE, HEARTBEAT, BYE, NEW_CONNECTION, END_CONNECTION = range(1, 8)
"""Kinds of a discovery datagram."""
EVERYWHERE = 2
"""Scope of a topic that other hosts receive; 0 stays in the process, 1 on the host."""
WIRE_VERSION = 10
GROUP, MESSAGE_PORT, SERVICE_PORT = "239.255.0.7", 10317, 10318
IP_MULTICAST_ALL = 49
"""Linux: with 0, a socket receives only from the groups that it joined itself."""


@dataclass(slots=True)
class Call:
    """Call of a service, sent once a server of it is found; the answer is None where the server refuses."""

    topic: str
    kinds: tuple[str, str]  # of the request and of the answer
    answer: queue.SimpleQueue[bytes | None]
    sent: bool = False


class TransportPeer(Peer):
    """One process on the network of Gazebo Transport.

    Args:
        host: address of the interface to use; the loopback keeps everything on this machine.
        partition: peers of other partitions are ignored; None: the default of this host and user, as in Gazebo.
        silence_s: after how long a silence another process counts as gone [s].
        most_waiting: messages that may wait to be taken; further ones are lost and counted.

    Raises:
        MissingExtra: pyzmq or protobuf is not installed.
        InputError: there is no such interface.
    """

    def __init__(
        self, host: str = "127.0.0.1", partition: str | None = None, *, silence_s: float = SILENCE_S,
        most_waiting: int = MOST_WAITING,
    ) -> None:  # fmt: skip
        super().__init__(host, tick_s=HEARTBEAT_S, most_waiting=most_waiting)
        self._zmq: Any = need("zmq", extra="gazebo")
        gz()
        self._silence_s = silence_s
        self.partition = usual_partition() if partition is None else partition
        self.uuid, self._node = new_uuid(), new_uuid()
        self._context = self._zmq.Context()
        self._alive: dict[str, float] = {}  # process to the time of its last heartbeat
        self._offers: dict[tuple[str, str], Any] = {}  # (full topic, node) to publisher
        self._joined: dict[str, set[str]] = {}  # address to processes behind it
        self._calls: dict[str, Call] = {}
        self._servers: set[str] = set()  # addresses of servers that we connected to
        self._group: dict[int, socket.socket] = {}  # by port
        try:
            for port in (MESSAGE_PORT, SERVICE_PORT):
                self._group[port] = discovery_socket(port, host)
            self._give, self._take = self._context.socket(self._zmq.PUB), self._context.socket(self._zmq.SUB)
            self._take.setsockopt(self._zmq.RCVHWM, 0)
            self._take.setsockopt(self._zmq.MAXMSGSIZE, MOST_BYTES)
            self._give.setsockopt(self._zmq.LINGER, 200)
            self._address = bound(self._give, host)
            self._asking, self._answers = self._context.socket(self._zmq.ROUTER), self._context.socket(self._zmq.ROUTER)
            self._asking.setsockopt(self._zmq.ROUTER_MANDATORY, 1)
            self._asking.setsockopt(self._zmq.LINGER, 0)
            self._answers.setsockopt_string(self._zmq.IDENTITY, self._node)
            self._answer_address = bound(self._answers, host)
        except BaseException:
            self._close_sockets()
            raise
        self._start()

    def request(self, topic: str, *, kinds: tuple[str, str], timeout_s: float = 3.0) -> bytes | None:
        """Call a service with an empty request and return its answer, or None if none comes or the service refuses.

        Args:
            topic: of the service.
            kinds: type of the request and of the answer.
            timeout_s: how long to wait [s].
        """
        answer: queue.SimpleQueue[bytes | None] = queue.SimpleQueue()
        self._do(self._ask, Call(self._name(topic), kinds, answer))
        try:
            return answer.get(timeout=timeout_s)
        except queue.Empty:
            return None

    def _name(self, topic: str) -> str:
        return full_topic(topic, self.partition)

    async def _begin(self) -> None:
        zmq_fds = [sock.getsockopt(self._zmq.FD) for sock in (self._take, self._answers)]
        for fd in (*zmq_fds, *self._group.values()):
            self._loop.add_reader(fd, self._serve)

    def _serve(self) -> None:
        for port in self._group:
            self._receive_group(port)
        self._receive_topics()
        self._receive_answers()

    async def _tick(self) -> None:
        """Send the heartbeat and our offers; drop the peers that fell silent."""
        self._send_discovery(HEARTBEAT)
        for full in tuple(self._mine):  # the caller's thread adds to them
            self._announce(full)
        for call in self._calls.values():
            self._find_server(call)
        now = time.monotonic()
        for process in [p for p, last_s in self._alive.items() if now - last_s > self._silence_s]:
            self._lose(process)
        self._serve()

    async def _leave(self) -> None:
        self._send_discovery(BYE)
        self._close_sockets()

    def _close_sockets(self) -> None:
        for sock in self._group.values():
            sock.close()
        self._context.destroy(linger=200)

    def _send_discovery(self, kind: int, *, port: int = MESSAGE_PORT, **parts: Any) -> None:
        with contextlib.suppress(OSError):  # an interface that is down may come back; else the silence is reported
            self._group[port].sendto(datagram(kind, self.uuid, **parts), (GROUP, port))

    def _receive_group(self, port: int) -> None:
        for data, _ in datagrams(self._group[port]):
            found = read_datagram(data)
            if found is not None and found.process_uuid != self.uuid:
                self._take_in(found, port)

    def _take_in(self, found: Any, port: int) -> None:
        if port == MESSAGE_PORT:
            if found.type == BYE:
                self._lose(found.process_uuid)
                return
            self._alive[found.process_uuid] = time.monotonic()
        if found.type == SUBSCRIBE and found.sub.topic in self._mine:
            self._announce(found.sub.topic)
        elif found.type == UNADVERTISE:
            self._offers.pop((found.pub.topic, found.pub.node_uuid), None)
        elif found.type == ADVERTISE and found.pub.scope and self._reachable(found.pub.address):
            if port == SERVICE_PORT:
                self._call(found.pub)
            else:
                self._met(found.pub)

    def _reachable(self, address: str) -> bool:
        """On the loopback, connect only to loopback addresses: no other host can make us connect to it."""
        return not self.host.startswith("127.") or address.startswith("tcp://127.")

    def _met(self, pub: Any) -> None:
        if not pub.topic.startswith(self._name("/x")[:-1]):
            return  # peers of other partitions give no events
        key = (pub.topic, pub.node_uuid)
        if key not in self._offers:
            if len(self._offers) >= MOST_OFFERS:
                return
            self._offers[key] = pub
            self.events.put(TopicOffered(short_topic(pub.topic), pub.msg_pub.msg_type, pub.process_uuid))
        if pub.topic in self._wanted:
            self._join(pub)

    def _join(self, pub: Any) -> None:
        """Connect, and announce it to the publisher, which sends nothing otherwise."""
        if pub.address not in self._joined:
            try:
                self._take.connect(pub.address)
            except self._zmq.ZMQError:
                self.counters.drop(short_topic(pub.topic), "bad", f"no such address: {pub.address[:60]!r}")
                return
        self._joined.setdefault(pub.address, set()).add(pub.process_uuid)
        ours = gz().Publisher()
        ours.CopyFrom(pub)
        ours.process_uuid, ours.node_uuid, ours.msg_pub.ctrl = self.uuid, self._node, pub.process_uuid
        self._send_discovery(NEW_CONNECTION, pub=ours)

    def _lose(self, process: str) -> None:
        self._alive.pop(process, None)
        known = [key for key, pub in self._offers.items() if pub.process_uuid == process]
        for key in known:
            del self._offers[key]
        for address, behind in list(self._joined.items()):
            behind.discard(process)
            if not behind:
                del self._joined[address]
                with contextlib.suppress(self._zmq.ZMQError):
                    self._take.disconnect(address)
        if known:
            self.events.put(ProcessLeft(process))

    def _receive_topics(self) -> None:
        for parts in arrived(self._zmq, self._take):
            topic = short_topic(parts[0].decode(errors="replace"))
            if len(parts) >= 4:  # a fifth holds statistics
                received = Received(topic, parts[2], parts[3].decode(errors="replace"))
                self.events.put(received, topic=topic, size=len(parts[2]))
            else:
                self.counters.drop(topic, "bad", f"a message of {len(parts)} parts")

    def _subscribe(self, name: str, kind: str) -> None:
        if name in self._wanted:
            return
        self._wanted[name] = kind
        self._take.setsockopt_string(self._zmq.SUBSCRIBE, name)
        self._send_discovery(SUBSCRIBE, sub=gz().Subscriber(topic=name))
        for pub in [pub for (topic, _), pub in self._offers.items() if topic == name]:
            self._join(pub)
        self._serve()

    def _announce(self, name: str) -> None:
        about = gz().MessagePublisher(msg_type=self._mine[name], msgs_per_sec=2**64 - 1)
        offer = gz().Publisher(
            topic=name, address=self._address, process_uuid=self.uuid, node_uuid=self._node, scope=EVERYWHERE,
            msg_pub=about,
        )  # fmt: skip
        self._send_discovery(ADVERTISE, pub=offer)

    def _send(self, name: str, data: bytes) -> None:
        self._give.send_multipart([name.encode(), self._address.encode(), data, self._mine[name].encode()])

    def _ask(self, call: Call) -> None:
        self._calls = {key: other for key, other in self._calls.items() if other.topic != call.topic}
        self._calls[new_uuid()] = call
        self._find_server(call)

    def _find_server(self, call: Call) -> None:
        if not call.sent:
            self._send_discovery(SUBSCRIBE, port=SERVICE_PORT, sub=gz().Subscriber(topic=call.topic))

    def _call(self, pub: Any) -> None:
        """Send the calls of a service that a peer offers."""
        for key, call in self._calls.items():
            if call.topic != pub.topic or call.sent:
                continue
            with contextlib.suppress(self._zmq.ZMQError):  # no such address, or not connected yet: ask again
                if pub.address not in self._servers:
                    self._asking.connect(pub.address)
                    self._servers.add(pub.address)
                words = [pub.srv_pub.socket_id, call.topic, self._answer_address, self._node, self._node, key]
                parts = [word.encode() for word in words] + [b"", *(kind.encode() for kind in call.kinds)]
                self._asking.send_multipart(parts, self._zmq.NOBLOCK)
                call.sent = True

    def _receive_answers(self) -> None:
        for parts in arrived(self._zmq, self._answers):
            call = self._calls.pop(parts[3].decode(errors="replace"), None) if len(parts) >= 6 else None
            if call is not None:
                call.answer.put(parts[4] if parts[5] == b"1" else None)


def bound(sock: Any, host: str) -> str:
    """Bind a ZeroMQ socket to a free port and return its address."""
    return f"tcp://{host}:{sock.bind_to_random_port(f'tcp://{host}')}"


def arrived(zmq: Any, sock: Any) -> Iterator[list[bytes]]:
    """Give the messages that wait at a ZeroMQ socket, each as its parts."""
    with contextlib.suppress(zmq.Again):
        while True:
            yield sock.recv_multipart(zmq.NOBLOCK)


def usual_partition() -> str:
    """Return the partition: GZ_PARTITION, IGN_PARTITION (up to Fortress), or the default of this host and user."""
    given = os.environ.get("GZ_PARTITION") or os.environ.get("IGN_PARTITION")
    return given or f"{socket.gethostname()}:{getpass.getuser()}"


def full_topic(topic: str, partition: str) -> str:
    """Return the name of a topic on the wire.

    Raises:
        InputError: the name is not a topic.
    """
    if not topic.startswith("/") or len(topic) < 2 or any(c in topic for c in " @~\t\n") or "//" in topic:
        raise InputError(f"{topic!r} is not a topic", where="topic", allowed="/one/like/this")
    return f"@{partition if partition.startswith('/') or not partition else '/' + partition}@{topic}"


def short_topic(full: str) -> str:
    """Return the topic without its partition."""
    return full.rpartition("@")[2]


def datagram(kind: int, process: str, **parts: Any) -> bytes:
    """Return the bytes of one discovery message."""
    body: bytes = gz().Discovery(version=WIRE_VERSION, process_uuid=process, type=kind, **parts).SerializeToString()
    return struct.pack("<H", len(body)) + body


def read_datagram(raw: bytes) -> Any | None:
    """Return the discovery message in a datagram; None if there is none, or its wire version differs."""
    if len(raw) < 2 or struct.unpack_from("<H", raw)[0] != len(raw) - 2:
        return None
    message = gz().Discovery()
    try:
        message.ParseFromString(raw[2:])
    except Exception:  # protobuf raises kinds of its own, by implementation
        return None
    return message if message.version % 100 == WIRE_VERSION else None


def new_uuid() -> str:
    """Return a new unique id."""
    return str(uuid.uuid4())


def discovery_socket(port: int, host: str) -> socket.socket:
    """Open a UDP socket in the discovery group, only on the interface with this address.

    Raises:
        InputError: no interface has this address, or the port cannot be opened.
    """
    out = udp_socket()
    try:
        out.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        if hasattr(socket, "SO_REUSEPORT"):
            out.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEPORT, 1)
        out.setsockopt(socket.IPPROTO_IP, socket.IP_MULTICAST_IF, socket.inet_aton(host))
        out.setsockopt(socket.IPPROTO_IP, socket.IP_MULTICAST_LOOP, 1)
        _bind_to_group(out, port)
        join_group(out, GROUP, host)
    except OSError as error:
        out.close()
        raise InputError(
            f"cannot listen there: {error.strerror or error}",
            where=f"host {host}",
            allowed="an address of this machine",
        ) from None
    return out


def _bind_to_group(sock: socket.socket, port: int) -> None:
    try:
        sock.bind((GROUP, port))  # so that nothing but the group's datagrams comes in
        sock.setsockopt(socket.IPPROTO_IP, IP_MULTICAST_ALL, 0)
    except OSError:  # not on every system
        sock.bind(("", port))
