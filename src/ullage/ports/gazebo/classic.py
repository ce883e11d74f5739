"""A peer of Gazebo Classic: gets the list of publishers from the master and connects to them by TCP.

If the master leaves, the peer tries to connect again and then repeats its subscriptions and offers.
"""

from __future__ import annotations

import asyncio
import os
import socket
import time
from collections.abc import AsyncIterator, Callable
from typing import Any
from urllib.parse import urlsplit

from ullage.errors import InputError
from ullage.ports.gazebo.messages import classic
from ullage.ports.gazebo.peer import Connected, Disconnected, Peer, Received, Unresponsive

TICK_S = 0.25
AGAIN_S = 1.0
"""Time between two attempts to reach a missing master, and how long one may take [s]."""
ASK_S, ANSWER_S = 1.0, 3.0
"""Time between two requests to the master, and the longest wait for an answer [s].

A gzserver that is starting sometimes accepts a connection, lists its topics, and never reads that connection: our
bytes stayed unread in its socket, while it answered later connections.
"""
MOST_PATIENT_S = 60.0
"""Each silence doubles the next limit, up to this [s]: a server in a debugger does not get many connections."""
MOST_UNSENT = 64 * 2**20
"""Bytes that may wait for a slow reader before it is disconnected."""
HEADER = 8
"""A message begins with its length in this many hexadecimal digits."""
MOST_BYTES = 256 * 2**20
"""Longest message [bytes]; a longer one ends the connection."""
USUAL_PORT = 11345


Line = asyncio.StreamWriter
Take = Callable[[Line, bytes], None]


class ClassicPeer(Peer):
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
        super().__init__(host, tick_s=min(TICK_S, ask_s))
        classic()
        self.master, self._ask_s, self._answer_s = master, ask_s, answer_s
        self._offers: dict[tuple[str, str, int], Any] = {}  # of other peers, on subscribed topics
        self._unjoined: list[Any] = []  # offers whose publishers to connect to at the next tick
        self._publishers: dict[tuple[str, str, int], Line] = {}
        self._readers: dict[str, set[Line]] = {}
        self._talks: set[asyncio.Task[None]] = set()
        self._main: Line | None = None
        self._told: set[str] = set()  # topics that this master knows from us
        self._retry_s = 0.0
        self._asked_s = self._answered_s = 0.0  # time of the last request to the master and of its last answer
        self._patience_s = answer_s
        self._server = socket.socket(socket.AF_INET, socket.SOCK_STREAM)
        try:
            self._server.bind((host, 0))
        except OSError as error:
            self._server.close()
            raise InputError(
                f"cannot listen there: {error.strerror or error}", where=f"host {host}",
                allowed="an address of this machine",
            ) from None  # fmt: skip
        self._server.listen()
        self.port = self._server.getsockname()[1]
        self._start()

    async def _begin(self) -> None:
        await asyncio.start_server(lambda reader, line: self._talk(reader, line, self._on_reader), sock=self._server)

    async def _tick(self) -> None:
        now = time.monotonic()
        if self._main is not None:
            self._check_master(self._main, now)
        elif now >= self._retry_s:
            self._retry_s = now + AGAIN_S
            await self._connect(self.master, self._on_master, self._greet)
        while self._unjoined:
            await self._join(self._unjoined.pop())

    async def _leave(self) -> None:
        self._server.close()

    async def _connect(self, place: tuple[str, int], take: Take, made: Callable[[Line], None]) -> None:
        try:
            async with asyncio.timeout(AGAIN_S):
                reader, line = await asyncio.open_connection(*place)
        except OSError:
            return
        made(line)
        task = self._loop.create_task(self._talk(reader, line, take))
        self._talks.add(task)
        task.add_done_callback(self._talks.discard)

    async def _talk(self, reader: asyncio.StreamReader, line: Line, take: Take) -> None:
        """Take the messages of a connection until it ends, or speaks another protocol."""
        try:
            async for data in messages(reader):
                take(line, data)
        except Exception:  # parsers raise their own kinds of error
            return
        finally:
            line.transport.abort()
            self._lost(line)

    def _lost(self, line: Line) -> None:
        for readers in self._readers.values():
            readers.discard(line)
        self._publishers = {key: one for key, one in self._publishers.items() if one is not line}
        if line is self._main:
            self._main = None
            self._offers.clear()
            self.events.put(Disconnected())

    def _greet(self, line: Line) -> None:
        """Repeat to a new master what we subscribe to and offer."""
        self._main, self._told = line, set()
        self._answered_s = self._asked_s = time.monotonic()
        for topic in tuple(self._mine):  # the caller's thread adds to them
            self._announce(topic)
        for topic in self._wanted:
            self._send_subscription(topic)

    def _check_master(self, line: Line, now: float) -> None:
        """Check that the master answers, disconnect if it does not, and try missing publishers again."""
        if now - self._asked_s < self._ask_s:
            return
        if now - self._answered_s > self._patience_s:
            self._patience_s = min(2 * self._patience_s, MOST_PATIENT_S)
            self._main = None  # it still exists, so no `Disconnected` event
            line.transport.abort()
            self._offers.clear()
            self.events.put(Unresponsive())
            return
        self._asked_s = now
        send(line, packet("request", classic().Request(id=0, request="get_topic_namespaces", data="")))
        self._unjoined = list(self._offers.values())

    def _on_master(self, line: Line, data: bytes) -> None:
        message = classic().Packet.FromString(data)
        if message.type == "get_topic_namespaces_response":
            self._answered_s, self._patience_s = time.monotonic(), self._answer_s
        if message.type == "topic_namepaces_init":
            self.events.put(Connected(tuple(classic().GzString_V.FromString(message.serialized_data).data)))
        elif message.type == "topic_namespace_add":
            self.events.put(Connected((classic().GzString.FromString(message.serialized_data).data,)))
        elif message.type in ("publisher_subscribe", "publisher_advertise"):
            pub = classic().Publish.FromString(message.serialized_data)
            if pub.topic in self._wanted and (pub.host, pub.port) != (self.host, self.port):
                self._offers[_key(pub)] = pub
                self._unjoined.append(pub)
                self._wake.set()
        elif message.type == "unadvertise":
            key = _key(classic().Publish.FromString(message.serialized_data))
            self._offers.pop(key, None)
            if key in self._publishers:
                self._publishers[key].transport.abort()

    async def _join(self, pub: Any) -> None:
        """Connect to a publisher and ask it for its topic."""

        def made(line: Line) -> None:
            self._publishers[_key(pub)] = line
            send(line, packet("sub", self._want(pub.topic, pub.msg_type)))

        def take(_: Line, data: bytes) -> None:
            self.events.put(Received(pub.topic, data), topic=pub.topic, size=len(data))

        if _key(pub) not in self._publishers:
            await self._connect((pub.host, pub.port), take, made)

    def _on_reader(self, line: Line, data: bytes) -> None:
        message = classic().Packet.FromString(data)
        if message.type == "sub":
            topic = classic().Subscribe.FromString(message.serialized_data).topic
            self._readers.setdefault(topic, set()).add(line)

    def _want(self, topic: str, kind: str) -> Any:
        return classic().Subscribe(topic=topic, host=self.host, port=self.port, msg_type=kind, latching=False)

    def _send_subscription(self, name: str) -> None:
        if self._main is not None:
            send(self._main, packet("subscribe", self._want(name, self._wanted[name])))

    def _subscribe(self, name: str, kind: str) -> None:
        if name not in self._wanted:
            self._wanted[name] = kind
            self._send_subscription(name)

    def _announce(self, name: str) -> None:
        if self._main is not None and name not in self._told:
            self._told.add(name)
            offer = classic().Publish(topic=name, msg_type=self._mine[name], host=self.host, port=self.port)
            send(self._main, packet("advertise", offer))

    def _send(self, name: str, data: bytes) -> None:
        for line in tuple(self._readers.get(name, ())):
            send(line, framed(data))


def _key(pub: Any) -> tuple[str, str, int]:
    return pub.topic, pub.host, pub.port


def send(line: Line, data: bytes) -> None:
    """Send bytes, or end the connection if too many wait already."""
    if line.transport.get_write_buffer_size() > MOST_UNSENT:
        line.transport.abort()
    else:
        line.write(data)


def framed(data: bytes) -> bytes:
    """Return a message with its length before it."""
    return f"{len(data):08X}".encode() + data


def packet(kind: str, message: Any) -> bytes:
    """Return a packet for the master, or the first one for a publisher."""
    gz = classic()
    made = gz.Packet(stamp=gz.Time(sec=0, nsec=0), type=kind, serialized_data=message.SerializeToString())
    return framed(made.SerializeToString())


async def messages(reader: asyncio.StreamReader) -> AsyncIterator[bytes]:
    """Cut a stream of bytes into messages, until it ends.

    Raises:
        ValueError: the bytes are not such messages.
        IncompleteReadError: the stream ends.
    """
    while True:
        length = int(await reader.readexactly(HEADER), 16)
        if not 0 <= length <= MOST_BYTES:
            raise ValueError(f"a message of {length} bytes")
        yield await reader.readexactly(length)


def master_of(address: str) -> tuple[str, int]:
    """Return host and port of the master: as given, from GAZEBO_MASTER_URI, or of this machine.

    Raises:
        InputError: the address is not HOST:PORT.
    """
    text = address or os.environ.get("GAZEBO_MASTER_URI", "")
    try:
        parts = urlsplit(text if "//" in text else f"//{text}")
        return parts.hostname or "127.0.0.1", parts.port or USUAL_PORT
    except ValueError:
        raise InputError(f"{text!r} is not an address", where="gazebo-classic", allowed="HOST:PORT") from None
