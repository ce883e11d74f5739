"""A peer on the network of either Gazebo; `transport` and `classic` frame its messages.

A thread owns every socket, so that heartbeats and answers go out while the caller computes for seconds. Events wait in
`events`, in order, until the caller takes them.
"""

from __future__ import annotations

import asyncio
import contextlib
import threading
from abc import ABC, abstractmethod
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

from ullage.errors import InputError
from ullage.flow import Closing
from ullage.ports.intake import Counters, Inbox

MOST_WAITING = 200_000
"""Messages that may wait to be taken."""


@dataclass(frozen=True, slots=True)
class Received:
    """A message on a topic."""

    topic: str
    data: bytes
    kind: str = ""  # the type's full name, as ignition.msgs.Pose_V; empty in Classic, which fixes it by subscription


@dataclass(frozen=True, slots=True)
class TopicOffered:
    """A topic that a peer of Transport offers, given once for each publisher."""

    topic: str
    kind: str
    process: str


@dataclass(frozen=True, slots=True)
class ProcessLeft:
    """A process of Transport that left or fell silent."""

    process: str


@dataclass(frozen=True, slots=True)
class Connected:
    """Classic's master was found; it has these worlds."""

    worlds: tuple[str, ...]


@dataclass(frozen=True, slots=True)
class Disconnected:
    """Classic's master left."""


@dataclass(frozen=True, slots=True)
class Unresponsive:
    """Classic's master did not answer for a while; the peer connects again."""


Event = Received | TopicOffered | ProcessLeft | Connected | Disconnected | Unresponsive


class Peer(Closing, ABC):
    """One process on the network of a Gazebo.

    Args:
        host: address of the interface to use; the loopback keeps everything on this machine.
        tick_s: time between two calls of `_tick` [s].
        most_waiting: messages that may wait to be taken; further ones are lost and counted.
    """

    def __init__(self, host: str, *, tick_s: float, most_waiting: int = MOST_WAITING) -> None:
        self.host, self._tick_s = host, tick_s
        self.counters = Counters()
        self.events: Inbox[Event] = Inbox(self.counters, most=most_waiting)
        self._wanted: dict[str, str] = {}  # subscribed topic to type
        self._mine: dict[str, str] = {}  # advertised topic to type

    def _start(self) -> None:
        """Start the thread, once every socket is open."""
        self._loop = asyncio.SelectorEventLoop()
        self._wake, self._closing = asyncio.Event(), False
        self._thread = threading.Thread(target=self._run, name="gazebo", daemon=True)
        self._thread.start()

    def subscribe(self, topic: str, kind: str = "") -> None:
        """Receive the messages of a topic from now on; Classic asks for their type, as `gazebo.msgs.Pose`."""
        self._do(self._subscribe, self._name(topic), kind)

    def advertise(self, topic: str, kind: str) -> None:
        """Offer a topic of this type of message, as `gz.msgs.Double`."""
        name = self._name(topic)
        self._mine[name] = kind
        self._do(self._announce, name)

    def publish(self, topic: str, message: Any) -> None:
        """Publish a message on an advertised topic.

        Raises:
            InputError: the topic was not advertised.
        """
        name = self._name(topic)
        if name not in self._mine:
            raise InputError(f"{topic} was not advertised", where="publish", allowed="a topic that was")
        self._do(self._send, name, message.SerializeToString())

    def wait(self, timeout_s: float) -> Event | None:
        """Return the next event, or None if none came within the timeout."""
        return self.events.get(timeout_s)

    def close(self) -> None:
        """Leave the network and close every socket."""
        self._do(self._stop)
        self._thread.join(timeout=5)

    def _do(self, job: Callable[..., None], *args: Any) -> None:
        """Run a job in the thread that owns the sockets; after the end, not at all."""
        with contextlib.suppress(RuntimeError):
            self._loop.call_soon_threadsafe(job, *args)

    def _stop(self) -> None:
        self._closing = True
        self._wake.set()

    def _run(self) -> None:
        with asyncio.Runner(loop_factory=lambda: self._loop) as runner:
            runner.run(self._work())

    async def _work(self) -> None:
        try:
            await self._begin()
            while not self._closing:
                self._wake.clear()
                await self._tick()
                with contextlib.suppress(TimeoutError):
                    await asyncio.wait_for(self._wake.wait(), self._tick_s)
        finally:
            await self._leave()

    def _name(self, topic: str) -> str:
        """Return a topic's name on the wire."""
        return topic

    @abstractmethod
    async def _begin(self) -> None:
        """Serve the sockets from now on."""

    @abstractmethod
    async def _tick(self) -> None:
        """Do what falls due by time."""

    @abstractmethod
    async def _leave(self) -> None:
        """Leave the network and close every socket."""

    @abstractmethod
    def _subscribe(self, name: str, kind: str) -> None:
        """Ask the network for a topic."""

    @abstractmethod
    def _announce(self, name: str) -> None:
        """Tell the network of an advertised topic."""

    @abstractmethod
    def _send(self, name: str, data: bytes) -> None:
        """Send a message to the subscribers of a topic."""
