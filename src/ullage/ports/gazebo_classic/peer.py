"""A peer of Gazebo Classic: told by the master who has what, and joined to them by TCP.

A thread of its own owns every socket. What arrives waits in `events`, in order, until it is taken; a master that went
is looked for again, and told anew what is wanted and offered.
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
"""How often a master that is not there is looked for, and publishers that could not be joined are tried again."""
ASK_S, DEAF_S = 1.0, 3.0
"""How often the master is asked something, and how long an answer may take.

A gzserver that is joined while it starts now and then accepts, says what it has, and never reads that connection (what
was said lay unread in its socket, while whoever came later was answered).
"""
MOST_PATIENT_S = 60.0
"""Each silence doubles the next one's limit, up to this: a server that is stopped in a debugger is not overrun."""
MOST_UNSENT = 64 * 2**20
"""Bytes that may wait for a slow reader before it is let go."""


@dataclass(frozen=True, slots=True)
class Heard:
    """A message on a topic."""

    topic: str
    data: bytes


@dataclass(frozen=True, slots=True)
class Met:
    """The master was found, with the worlds that it has."""

    worlds: tuple[str, ...]


@dataclass(frozen=True, slots=True)
class Lost:
    """The master went."""


@dataclass(frozen=True, slots=True)
class Deaf:
    """The master did not answer for a while, and is joined anew."""


Event = Heard | Met | Lost | Deaf


@dataclass(slots=True, eq=False)
class _Line:
    """One TCP connection."""

    sock: socket.socket
    take: Callable[[_Line, bytes], None]
    topic: str = ""
    stream: Stream = field(default_factory=Stream)
    unsent: bytearray = field(default_factory=bytearray)


class ClassicPeer:
    """One process among those around a gzserver.

    Args:
        master: host and port of the master.
        host: address that others reach us at; the loopback keeps everything on this machine.
        ask_s: how often the master is asked something [s].
        deaf_s: how long its first answer may take [s].

    Raises:
        MissingExtra: protobuf is not installed.
        InputError: there is no such interface.
    """

    def __init__(
        self, master: tuple[str, int], host: str = "127.0.0.1", *, ask_s: float = ASK_S, deaf_s: float = DEAF_S
    ) -> None:
        gz()
        self.master, self.host = master, host
        self._ask_s, self._deaf_s = ask_s, deaf_s
        self.counters = Counters()
        self.events: Inbox[Event] = Inbox(self.counters)
        self._wanted: dict[str, str] = {}  # topic to type
        self._mine: dict[str, str] = {}
        self._offers: dict[tuple[str, str, int], Any] = {}  # of others, on what is wanted
        self._publishers: dict[tuple[str, str, int], _Line] = {}
        self._readers: dict[str, set[_Line]] = {}
        self._lines: set[_Line] = set()
        self._main: _Line | None = None
        self._retry_s = 0.0
        self._asked_s = self._heard_s = 0.0  # when the master was asked last, and when it last answered
        self._patience_s = deaf_s
        self._closing = threading.Event()
        self._jobs: queue.SimpleQueue[Callable[[], None]] = queue.SimpleQueue()
        self._wake, self._woken = socket.socketpair()
        self._door = socket.socket(socket.AF_INET, socket.SOCK_STREAM)
        try:
            self._door.bind((host, 0))
        except OSError as error:
            for sock in (self._door, self._wake, self._woken):
                sock.close()
            raise InputError(
                f"cannot listen there: {error.strerror or error}", where=f"host {host}",
                allowed="an address of this machine",
            ) from None  # fmt: skip
        self._door.listen()
        self.port = self._door.getsockname()[1]
        self._selector = selectors.DefaultSelector()
        for sock in (self._door, self._woken):
            sock.setblocking(False)
            self._selector.register(sock, selectors.EVENT_READ)
        self._thread = threading.Thread(target=self._loop, name="gazebo-classic", daemon=True)
        self._thread.start()

    def subscribe(self, topic: str, kind: str) -> None:
        """Take what anybody says on a topic from now on; `kind` as gazebo.msgs.Pose."""
        self._do(lambda: self._subscribe(topic, kind))

    def advertise(self, topic: str, kind: str) -> None:
        """Offer a topic of this type of message."""
        self._do(lambda: self._advertise(topic, kind))

    def publish(self, topic: str, message: Any) -> None:
        """Say something on a topic, to whoever has joined it."""
        data = framed(message.SerializeToString())
        self._do(lambda: self._say(topic, data))

    def wait(self, timeout_s: float) -> Event | None:
        """The next thing that happened, waiting no longer than this for it."""
        return self.events.get(timeout_s)

    def close(self) -> None:
        """Let go of every socket."""
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
                self._look_for_master()
                self._look_after_master()
                for key, mask in self._selector.select(0.25):
                    self._serve(key, mask)
                while not self._jobs.empty():
                    self._jobs.get()()
        finally:
            for line in list(self._lines):
                line.sock.close()
            for sock in (self._door, self._wake, self._woken):
                sock.close()
            self._selector.close()

    def _serve(self, key: selectors.SelectorKey, mask: int) -> None:
        if key.fileobj is self._woken:
            with contextlib.suppress(BlockingIOError):
                self._woken.recv(4096)
        elif key.fileobj is self._door:
            with contextlib.suppress(OSError):
                self._add(self._door.accept()[0], self._on_reader)
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
        except Exception:  # gone, or speaking something else: parsers raise kinds of their own
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
            self.events.put(Lost())

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

    def _look_for_master(self) -> None:
        now = time.monotonic()
        if self._main is not None or now < self._retry_s:
            return
        self._retry_s = now + AGAIN_S
        try:
            sock = socket.create_connection(self.master, timeout=1.0)
        except OSError:
            return
        self._main = self._add(sock, self._on_master)
        self._heard_s = self._asked_s = now
        for topic, kind in self._mine.items():
            self._tell_offer(topic, kind)
        for topic, kind in self._wanted.items():
            self._tell_want(topic, kind)

    def _look_after_master(self) -> None:
        """Ask whether it still hears us, leave it if it does not, and try publishers again that could not be joined."""
        now = time.monotonic()
        if self._main is None or now - self._asked_s < self._ask_s:
            return
        if now - self._heard_s > self._patience_s:
            self._patience_s = min(2 * self._patience_s, MOST_PATIENT_S)
            deaf, self._main = self._main, None  # not lost: it is there
            self._drop(deaf)
            self._offers.clear()
            self.events.put(Deaf())
            return
        self._asked_s = now
        self._send(self._main, packet("request", gz().Request(id=0, request="get_topic_namespaces", data="")))
        for pub in list(self._offers.values()):
            self._join(pub)

    def _on_master(self, line: _Line, data: bytes) -> None:
        if line is not self._main:
            return
        said = gz().Packet.FromString(data)
        if said.type == "get_topic_namespaces_response":
            self._heard_s, self._patience_s = time.monotonic(), self._deaf_s
        if said.type == "topic_namepaces_init":
            self.events.put(Met(tuple(gz().GzString_V.FromString(said.serialized_data).data)))
        elif said.type == "topic_namespace_add":
            self.events.put(Met((gz().GzString.FromString(said.serialized_data).data,)))
        elif said.type in ("publisher_subscribe", "publisher_advertise"):
            pub = gz().Publish.FromString(said.serialized_data)
            if pub.topic in self._wanted and (pub.host, pub.port) != (self.host, self.port):
                self._offers[_key(pub)] = pub
                self._join(pub)
        elif said.type == "unadvertise":
            key = _key(gz().Publish.FromString(said.serialized_data))
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
        self.events.put(Heard(line.topic, data), topic=line.topic, size=len(data))

    def _on_reader(self, line: _Line, data: bytes) -> None:
        said = gz().Packet.FromString(data)
        if said.type == "sub":
            topic = gz().Subscribe.FromString(said.serialized_data).topic
            self._readers.setdefault(topic, set()).add(line)

    def _want(self, topic: str, kind: str) -> Any:
        return gz().Subscribe(topic=topic, host=self.host, port=self.port, msg_type=kind, latching=False)

    def _tell_want(self, topic: str, kind: str) -> None:
        if self._main is not None:
            self._send(self._main, packet("subscribe", self._want(topic, kind)))

    def _tell_offer(self, topic: str, kind: str) -> None:
        if self._main is not None:
            offer = gz().Publish(topic=topic, msg_type=kind, host=self.host, port=self.port)
            self._send(self._main, packet("advertise", offer))

    def _subscribe(self, topic: str, kind: str) -> None:
        if topic not in self._wanted:
            self._wanted[topic] = kind
            self._tell_want(topic, kind)

    def _advertise(self, topic: str, kind: str) -> None:
        if topic not in self._mine:
            self._mine[topic] = kind
            self._tell_offer(topic, kind)

    def _say(self, topic: str, data: bytes) -> None:
        for line in list(self._readers.get(topic, ())):
            self._send(line, data)


def _key(pub: Any) -> tuple[str, str, int]:
    return pub.topic, pub.host, pub.port


def type_of(name: str) -> str:
    """The full name of a message's type by its short one."""
    return full_type(getattr(gz(), name)())
