"""A peer of Gazebo Classic: gets the list of publishers from the master and connects to them by TCP.

A separate thread owns every socket. Events wait in `events`, in order, until the caller takes them. If the master
leaves, the peer tries to connect again and then repeats its subscriptions and offers.
"""

from __future__ import annotations

import contextlib
import queue
import selectors
import socket
import threading
import time
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any, Self

from ullage.errors import InputError
from ullage.ports.gazebo_classic.wire import Stream, framed, full_type, gz, packet
from ullage.ports.intake import Counters, Inbox

AGAIN_S = 1.0
"""Time between two attempts to reach a missing master or publisher [s]."""
ASK_S, ANSWER_S = 1.0, 3.0
"""Time between two requests to the master, and the longest wait for an answer [s].

A gzserver that is starting sometimes accepts a connection, lists its topics, and never reads that connection: our
bytes stayed unread in its socket, while it answered later connections.
"""
MOST_PATIENT_S = 60.0
"""Each silence doubles the next limit, up to this [s]: a server in a debugger does not get many connections."""
MOST_UNSENT = 64 * 2**20
"""Bytes that may wait for a slow reader before it is disconnected."""


@dataclass(frozen=True, slots=True)
class Received:
    """A message on a topic."""

    topic: str
    data: bytes


@dataclass(frozen=True, slots=True)
class Connected:
    """The master was found; it has these worlds."""

    worlds: tuple[str, ...]


@dataclass(frozen=True, slots=True)
class Disconnected:
    """The master left."""


@dataclass(frozen=True, slots=True)
class Unresponsive:
    """The master did not answer for a while; the peer connects again."""


Event = Received | Connected | Disconnected | Unresponsive


@dataclass(slots=True, eq=False)
class _Line:
    """One TCP connection."""

    sock: socket.socket
    take: Callable[[_Line, bytes], None]
    topic: str = ""
    stream: Stream = field(default_factory=Stream)
    unsent: bytearray = field(default_factory=bytearray)


class ClassicPeer:
    """One process on the network of a gzserver.

    Args:
        master: host and port of the master.
        host: our address for other peers; the loopback keeps everything on this machine.
        ask_s: how often the master is asked something [s].
        answer_s: how long its first answer may take [s].

    Raises:
        MissingExtra: protobuf is not installed.
        InputError: there is no such interface.
    """

    def __init__(
        self, master: tuple[str, int], host: str = "127.0.0.1", *, ask_s: float = ASK_S, answer_s: float = ANSWER_S
    ) -> None:
        gz()
        self.master, self.host = master, host
        self._ask_s, self._answer_s = ask_s, answer_s
        self.counters = Counters()
        self.events: Inbox[Event] = Inbox(self.counters)
        self._wanted: dict[str, str] = {}  # topic to type
        self._mine: dict[str, str] = {}
        self._offers: dict[tuple[str, str, int], Any] = {}  # of other peers, on subscribed topics
        self._publishers: dict[tuple[str, str, int], _Line] = {}
        self._readers: dict[str, set[_Line]] = {}
        self._lines: set[_Line] = set()
        self._main: _Line | None = None
        self._retry_s = 0.0
        self._asked_s = self._answered_s = 0.0  # time of the last request to the master and of its last answer
        self._patience_s = answer_s
        self._closing = threading.Event()
        self._jobs: queue.SimpleQueue[Callable[[], None]] = queue.SimpleQueue()
        self._wake, self._woken = socket.socketpair()
        self._server = socket.socket(socket.AF_INET, socket.SOCK_STREAM)
        try:
            self._server.bind((host, 0))
        except OSError as error:
            for sock in (self._server, self._wake, self._woken):
                sock.close()
            raise InputError(
                f"cannot listen there: {error.strerror or error}", where=f"host {host}",
                allowed="an address of this machine",
            ) from None  # fmt: skip
        self._server.listen()
        self.port = self._server.getsockname()[1]
        self._selector = selectors.DefaultSelector()
        for sock in (self._server, self._woken):
            sock.setblocking(False)
            self._selector.register(sock, selectors.EVENT_READ)
        self._thread = threading.Thread(target=self._loop, name="gazebo-classic", daemon=True)
        self._thread.start()

    def subscribe(self, topic: str, kind: str) -> None:
        """Receive the messages of a topic from now on; `kind` as gazebo.msgs.Pose."""
        self._do(lambda: self._subscribe(topic, kind))

    def advertise(self, topic: str, kind: str) -> None:
        """Offer a topic of this type of message."""
        self._do(lambda: self._advertise(topic, kind))

    def publish(self, topic: str, message: Any) -> None:
        """Send a message to the subscribers of a topic."""
        data = framed(message.SerializeToString())
        self._do(lambda: self._publish(topic, data))

    def wait(self, timeout_s: float) -> Event | None:
        """Return the next event, or None if none came within the timeout."""
        return self.events.get(timeout_s)

    def close(self) -> None:
        """Close every socket."""
        if not self._closing.is_set():
            self._closing.set()
            self._do(lambda: None)
            self._thread.join(timeout=5)

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *error: object) -> None:
        self.close()

    def _do(self, job: Callable[[], None]) -> None:
        self._jobs.put(job)
        with contextlib.suppress(OSError):
            self._wake.send(b".")

    def _loop(self) -> None:
        try:
            while not self._closing.is_set():
                self._connect_to_master()
                self._check_master()
                for key, mask in self._selector.select(0.25):
                    self._serve(key, mask)
                while not self._jobs.empty():
                    self._jobs.get()()
        finally:
            for line in list(self._lines):
                line.sock.close()
            for sock in (self._server, self._wake, self._woken):
                sock.close()
            self._selector.close()

    def _serve(self, key: selectors.SelectorKey, mask: int) -> None:
        if key.fileobj is self._woken:
            with contextlib.suppress(BlockingIOError):
                self._woken.recv(4096)
        elif key.fileobj is self._server:
            with contextlib.suppress(OSError):
                self._add(self._server.accept()[0], self._on_reader)
        elif key.data in self._lines:
            self._serve_line(key.data, mask)

    def _serve_line(self, line: _Line, mask: int) -> None:
        try:
            if mask & selectors.EVENT_WRITE:
                self._flush(line)
            if mask & selectors.EVENT_READ:
                raw = line.sock.recv(1 << 20)
                if not raw:
                    raise ConnectionError
                for data in line.stream.take(raw):
                    line.take(line, data)
        except BlockingIOError:
            return
        except Exception:  # gone, or not this protocol: parsers raise their own kinds of error
            self._drop(line)

    def _add(self, sock: socket.socket, take: Callable[[_Line, bytes], None], topic: str = "") -> _Line:
        sock.setblocking(False)
        sock.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        line = _Line(sock, take, topic)
        self._lines.add(line)
        self._selector.register(sock, selectors.EVENT_READ, line)
        return line

    def _drop(self, line: _Line) -> None:
        if line not in self._lines:
            return
        self._lines.discard(line)
        with contextlib.suppress(KeyError, ValueError):
            self._selector.unregister(line.sock)
        line.sock.close()
        for readers in self._readers.values():
            readers.discard(line)
        self._publishers = {key: one for key, one in self._publishers.items() if one is not line}
        if line is self._main:
            self._main = None
            self._offers.clear()
            self.events.put(Disconnected())

    def _send(self, line: _Line, data: bytes) -> None:
        if len(line.unsent) > MOST_UNSENT:
            self._drop(line)
            return
        line.unsent += data
        try:
            self._flush(line)
        except OSError:
            self._drop(line)

    def _flush(self, line: _Line) -> None:
        with contextlib.suppress(BlockingIOError):
            while line.unsent:
                del line.unsent[: line.sock.send(line.unsent)]
        both = selectors.EVENT_READ | selectors.EVENT_WRITE
        self._selector.modify(line.sock, both if line.unsent else selectors.EVENT_READ, line)

    def _connect_to_master(self) -> None:
        now = time.monotonic()
        if self._main is not None or now < self._retry_s:
            return
        self._retry_s = now + AGAIN_S
        try:
            sock = socket.create_connection(self.master, timeout=1.0)
        except OSError:
            return
        self._main = self._add(sock, self._on_master)
        self._answered_s = self._asked_s = now
        for topic, kind in self._mine.items():
            self._send_offer(topic, kind)
        for topic, kind in self._wanted.items():
            self._send_subscription(topic, kind)

    def _check_master(self) -> None:
        """Check that the master answers, disconnect if it does not, and try missing publishers again."""
        now = time.monotonic()
        if self._main is None or now - self._asked_s < self._ask_s:
            return
        if now - self._answered_s > self._patience_s:
            self._patience_s = min(2 * self._patience_s, MOST_PATIENT_S)
            silent, self._main = self._main, None  # it still exists, so no `Disconnected` event
            self._drop(silent)
            self._offers.clear()
            self.events.put(Unresponsive())
            return
        self._asked_s = now
        self._send(self._main, packet("request", gz().Request(id=0, request="get_topic_namespaces", data="")))
        for pub in list(self._offers.values()):
            self._join(pub)

    def _on_master(self, line: _Line, data: bytes) -> None:
        if line is not self._main:
            return
        message = gz().Packet.FromString(data)
        if message.type == "get_topic_namespaces_response":
            self._answered_s, self._patience_s = time.monotonic(), self._answer_s
        if message.type == "topic_namepaces_init":
            self.events.put(Connected(tuple(gz().GzString_V.FromString(message.serialized_data).data)))
        elif message.type == "topic_namespace_add":
            self.events.put(Connected((gz().GzString.FromString(message.serialized_data).data,)))
        elif message.type in ("publisher_subscribe", "publisher_advertise"):
            pub = gz().Publish.FromString(message.serialized_data)
            if pub.topic in self._wanted and (pub.host, pub.port) != (self.host, self.port):
                self._offers[_key(pub)] = pub
                self._join(pub)
        elif message.type == "unadvertise":
            key = _key(gz().Publish.FromString(message.serialized_data))
            self._offers.pop(key, None)
            if key in self._publishers:
                self._drop(self._publishers[key])

    def _join(self, pub: Any) -> None:
        if _key(pub) in self._publishers:
            return
        try:
            sock = socket.create_connection((pub.host, pub.port), timeout=1.0)
        except OSError:
            return
        line = self._publishers[_key(pub)] = self._add(sock, self._on_topic, pub.topic)
        self._send(line, packet("sub", self._want(pub.topic, pub.msg_type)))

    def _on_topic(self, line: _Line, data: bytes) -> None:
        self.events.put(Received(line.topic, data), topic=line.topic, size=len(data))

    def _on_reader(self, line: _Line, data: bytes) -> None:
        message = gz().Packet.FromString(data)
        if message.type == "sub":
            topic = gz().Subscribe.FromString(message.serialized_data).topic
            self._readers.setdefault(topic, set()).add(line)

    def _want(self, topic: str, kind: str) -> Any:
        return gz().Subscribe(topic=topic, host=self.host, port=self.port, msg_type=kind, latching=False)

    def _send_subscription(self, topic: str, kind: str) -> None:
        if self._main is not None:
            self._send(self._main, packet("subscribe", self._want(topic, kind)))

    def _send_offer(self, topic: str, kind: str) -> None:
        if self._main is not None:
            offer = gz().Publish(topic=topic, msg_type=kind, host=self.host, port=self.port)
            self._send(self._main, packet("advertise", offer))

    def _subscribe(self, topic: str, kind: str) -> None:
        if topic not in self._wanted:
            self._wanted[topic] = kind
            self._send_subscription(topic, kind)

    def _advertise(self, topic: str, kind: str) -> None:
        if topic not in self._mine:
            self._mine[topic] = kind
            self._send_offer(topic, kind)

    def _publish(self, topic: str, data: bytes) -> None:
        for line in list(self._readers.get(topic, ())):
            self._send(line, data)


def _key(pub: Any) -> tuple[str, str, int]:
    return pub.topic, pub.host, pub.port


def type_of(name: str) -> str:
    """Return the full name of a message type by its short name."""
    return full_type(getattr(gz(), name)())
