"""A peer of Gazebo Transport: finds topics by multicast, sends and receives messages over ZeroMQ.

A separate thread owns every socket, so that heartbeats go out while the caller computes for seconds. Events wait in
`events`, in order, until the caller takes them.
"""

from __future__ import annotations

import contextlib
import queue
import socket
import threading
import time
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Self

from ullage.errors import InputError, need
from ullage.ports.gazebo import wire
from ullage.ports.gazebo.service import Requests
from ullage.ports.intake import Counters, Inbox

HEARTBEAT_S, SILENCE_S = 1.0, 3.0
"""Time between two heartbeats, and the silence after which a peer counts as gone [s]."""
MOST_WAITING = 200_000
"""Messages that may wait to be taken."""
MOST_OFFERS = 10_000
"""Greatest number of known publishers; further ones are ignored."""
MOST_BYTES = 64 * 2**20
"""Longest message [bytes]; the publisher of a longer one is disconnected."""


@dataclass(frozen=True, slots=True)
class Received:
    """A message on a topic."""

    topic: str
    kind: str  # the type's full name, as ignition.msgs.Pose_V
    data: bytes


@dataclass(frozen=True, slots=True)
class TopicOffered:
    """A topic that a peer offers, given once for each publisher."""

    topic: str
    kind: str
    process: str


@dataclass(frozen=True, slots=True)
class ProcessLeft:
    """A process that left or fell silent."""

    process: str


Event = Received | TopicOffered | ProcessLeft


class Peer:
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
        zmq: Any = need("zmq", extra="gazebo")
        wire.gz()
        self.host, self._silence_s = host, silence_s
        self.partition = wire.usual_partition() if partition is None else partition
        self.uuid, self._node = wire.new_uuid(), wire.new_uuid()
        self.counters = Counters()
        self.events: Inbox[Event] = Inbox(self.counters, most=most_waiting)
        self._zmq, self._context = zmq, zmq.Context()
        self._alive: dict[str, float] = {}  # process to the time of its last heartbeat
        self._offers: dict[tuple[str, str], Any] = {}  # (full topic, node) to publisher
        self._wanted: set[str] = set()
        self._mine: dict[str, str] = {}  # full topic to type
        self._joined: dict[str, set[str]] = {}  # address to processes behind it
        self._parting: set[str] = set()  # addresses to disconnect when nothing waits to be read
        self._jobs: queue.SimpleQueue[Callable[[], None]] = queue.SimpleQueue()
        self._wake, self._woken = socket.socketpair()
        self._closing = threading.Event()
        self._group: list[tuple[socket.socket, int]] = []
        try:
            self._open()
        except BaseException:
            self._close_sockets()
            self._wake.close()
            self._woken.close()
            raise
        self._thread = threading.Thread(target=self._loop, name="gazebo-transport", daemon=True)
        self._thread.start()

    def _open(self) -> None:
        for port in (wire.MESSAGE_PORT, wire.SERVICE_PORT):
            self._group.append((wire.discovery_socket(port, self.host), port))
        self._give, self._take = self._context.socket(self._zmq.PUB), self._context.socket(self._zmq.SUB)
        self._take.setsockopt(self._zmq.RCVHWM, 0)
        self._take.setsockopt(self._zmq.MAXMSGSIZE, MOST_BYTES)
        self._give.setsockopt(self._zmq.LINGER, 200)
        self._address = f"tcp://{self.host}:{self._give.bind_to_random_port(f'tcp://{self.host}')}"
        self._requests = Requests(self._zmq, self._context, self.host, self._node)

    def subscribe(self, topic: str) -> None:
        """Receive the messages of a topic from now on."""
        full = wire.full_topic(topic, self.partition)
        self._do(lambda: self._subscribe(full))

    def advertise(self, topic: str, kind: str) -> None:
        """Offer a topic of this type of message, as `gz.msgs.Double`."""
        full = wire.full_topic(topic, self.partition)
        self._mine[full] = kind
        self._do(lambda: self._send_discovery(wire.ADVERTISE, pub=self._offer(full)))

    def publish(self, topic: str, message: Any) -> None:
        """Publish a message on an advertised topic.

        Raises:
            InputError: the topic was not advertised.
        """
        full = wire.full_topic(topic, self.partition)
        if full not in self._mine:
            raise InputError(f"{topic} was not advertised", where="publish", allowed="a topic that was")
        parts = [full.encode(), self._address.encode(), message.SerializeToString(), self._mine[full].encode()]
        self._do(lambda: self._give.send_multipart(parts))

    def request(self, topic: str, *, kinds: tuple[str, str], data: bytes = b"", timeout_s: float = 3.0) -> bytes | None:
        """Call a service and return its answer, or None if none comes or the service refuses.

        Args:
            topic: of the service.
            kinds: type of the request and of the answer.
            data: the request.
            timeout_s: how long to wait [s].
        """
        full = wire.full_topic(topic, self.partition)
        answer: queue.SimpleQueue[bytes | None] = queue.SimpleQueue()
        self._do(lambda: self._ask(full, kinds, data, answer))
        try:
            return answer.get(timeout=timeout_s)
        except queue.Empty:
            return None

    def wait(self, timeout_s: float) -> Event | None:
        """Return the next event, or None if none came within the timeout."""
        return self.events.get(timeout_s)

    def close(self) -> None:
        """Leave the network and close every socket."""
        if self._closing.is_set():
            return
        self._closing.set()
        self._do(lambda: None)
        self._thread.join(timeout=5)
        self._wake.close()  # not by the thread that reads it: another may be about to write
        self._woken.close()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *error: object) -> None:
        self.close()

    def _do(self, job: Callable[[], None]) -> None:
        """Run a job in the thread that owns the sockets."""
        self._jobs.put(job)
        with contextlib.suppress(OSError):
            self._wake.send(b".")

    def _loop(self) -> None:
        poller = self._zmq.Poller()
        for thing in (self._take, self._requests.answers, self._woken, *(sock for sock, _ in self._group)):
            poller.register(thing, self._zmq.POLLIN)
        beat = time.monotonic()
        try:
            while not self._closing.is_set():
                now = time.monotonic()
                if now >= beat:
                    beat = now + HEARTBEAT_S
                    self._live()
                poller.poll(max(1, int((beat - now) * 1000)))
                self._serve()
            self._send_discovery(wire.BYE)
        finally:
            self._close_sockets()

    def _serve(self) -> None:
        with contextlib.suppress(BlockingIOError):
            self._woken.recv(4096, socket.MSG_DONTWAIT)
        while not self._jobs.empty():
            self._jobs.get()()
        for sock, port in self._group:
            self._receive_group(sock, port)
        self._receive_topics()
        self._requests.receive()

    def _live(self) -> None:
        """Send the heartbeat and our offers; drop the peers that fell silent."""
        self._send_discovery(wire.HEARTBEAT)
        for full in tuple(self._mine):  # the caller's thread adds to them
            self._send_discovery(wire.ADVERTISE, pub=self._offer(full))
        if self._requests.topics:
            for full in self._requests.topics:
                self._send_discovery(wire.SUBSCRIBE, port=wire.SERVICE_PORT, sub=wire.gz().Subscriber(topic=full))
        now = time.monotonic()
        for process in [p for p, last_s in self._alive.items() if now - last_s > self._silence_s]:
            self._lose(process)

    def _send_discovery(self, kind: int, *, port: int = wire.MESSAGE_PORT, **parts: Any) -> None:
        datagram = wire.datagram(kind, self.uuid, **parts)
        with contextlib.suppress(OSError):  # an interface that is down may come back; else the silence is reported
            next(sock for sock, at in self._group if at == port).sendto(datagram, (wire.GROUP, port))

    def _receive_group(self, sock: socket.socket, port: int) -> None:
        while True:
            try:
                datagram = wire.read_datagram(sock.recv(65536))
            except BlockingIOError:
                return
            if datagram is not None and datagram.process_uuid != self.uuid:
                self._take_in(datagram, port)

    def _take_in(self, datagram: Any, port: int) -> None:
        if datagram.type in (wire.BYE,) and port == wire.MESSAGE_PORT:
            self._lose(datagram.process_uuid)
            return
        if port == wire.MESSAGE_PORT:
            self._alive[datagram.process_uuid] = time.monotonic()
        if datagram.type == wire.SUBSCRIBE and datagram.sub.topic in self._mine:
            self._send_discovery(wire.ADVERTISE, pub=self._offer(datagram.sub.topic))
        elif datagram.type == wire.UNADVERTISE:
            self._offers.pop((datagram.pub.topic, datagram.pub.node_uuid), None)
        elif datagram.type == wire.ADVERTISE and datagram.pub.scope and self._reachable(datagram.pub.address):
            if port == wire.SERVICE_PORT:
                self._requests.found(datagram.pub)
            else:
                self._met(datagram.pub)

    def _reachable(self, address: str) -> bool:
        """On the loopback, connect only to loopback addresses: no other host can make us connect to it."""
        return not self.host.startswith("127.") or address.startswith("tcp://127.")

    def _met(self, pub: Any) -> None:
        if not pub.topic.startswith(wire.full_topic("/x", self.partition)[:-1]):
            return  # peers of other partitions give no events
        key = (pub.topic, pub.node_uuid)
        if key not in self._offers:
            if len(self._offers) >= MOST_OFFERS:
                return
            self._offers[key] = pub
            self.events.put(TopicOffered(wire.short_topic(pub.topic), pub.msg_pub.msg_type, pub.process_uuid))
        if pub.topic in self._wanted:
            self._join(pub)

    def _join(self, pub: Any) -> None:
        """Connect, and announce it to the publisher, which sends nothing otherwise."""
        if pub.address not in self._joined:
            try:
                self._take.connect(pub.address)
            except self._zmq.ZMQError:
                self.counters.drop(wire.short_topic(pub.topic), "bad", f"no such address: {pub.address[:60]!r}")
                return
        self._joined.setdefault(pub.address, set()).add(pub.process_uuid)
        self._parting.discard(pub.address)
        ours = wire.gz().Publisher()
        ours.CopyFrom(pub)
        ours.process_uuid, ours.node_uuid, ours.msg_pub.ctrl = self.uuid, self._node, pub.process_uuid
        self._send_discovery(wire.NEW_CONNECTION, pub=ours)

    def _lose(self, process: str) -> None:
        self._alive.pop(process, None)
        known = [key for key, pub in self._offers.items() if pub.process_uuid == process]
        for key in known:
            del self._offers[key]
        for address, behind in self._joined.items():
            behind.discard(process)
            if not behind:
                self._parting.add(address)
        if known:
            self.events.put(ProcessLeft(process))

    def _receive_topics(self) -> None:
        while True:
            try:
                parts = self._take.recv_multipart(self._zmq.NOBLOCK)
            except self._zmq.Again:
                break
            topic = wire.short_topic(parts[0].decode(errors="replace"))
            if len(parts) >= 4:  # a fifth holds statistics
                received = Received(topic, parts[3].decode(errors="replace"), parts[2])
                self.events.put(received, topic=topic, size=len(parts[2]))
            else:
                self.counters.drop(topic, "bad", f"a message of {len(parts)} parts")
        self._part()

    def _part(self) -> None:
        """Disconnect from the peers that left while no message is half read.

        To poll a SUB socket, libzmq takes the first part of the next message off its pipe. If the pipe is cut off after
        that, the process aborts at the second part (`!_more`, fq.cpp; issue 2163 of libzmq).
        """
        for address in self._parting:
            del self._joined[address]
            with contextlib.suppress(self._zmq.ZMQError):
                self._take.disconnect(address)
        self._parting.clear()

    def _subscribe(self, full: str) -> None:
        if full in self._wanted:
            return
        self._wanted.add(full)
        self._take.setsockopt_string(self._zmq.SUBSCRIBE, full)
        self._send_discovery(wire.SUBSCRIBE, sub=wire.gz().Subscriber(topic=full))
        for pub in [pub for (topic, _), pub in self._offers.items() if topic == full]:
            self._join(pub)

    def _offer(self, full: str) -> Any:
        about = wire.gz().MessagePublisher(msg_type=self._mine[full], msgs_per_sec=2**64 - 1)
        return wire.gz().Publisher(
            topic=full, address=self._address, process_uuid=self.uuid, node_uuid=self._node, scope=wire.EVERYWHERE,
            msg_pub=about,
        )  # fmt: skip

    def _ask(self, full: str, kinds: tuple[str, str], data: bytes, answer: queue.SimpleQueue[bytes | None]) -> None:
        self._requests.ask(full, kinds, data, answer)
        self._send_discovery(wire.SUBSCRIBE, port=wire.SERVICE_PORT, sub=wire.gz().Subscriber(topic=full))

    def _close_sockets(self) -> None:
        for sock, _ in self._group:
            sock.close()
        self._context.destroy(linger=200)
