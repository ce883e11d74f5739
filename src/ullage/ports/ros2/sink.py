"""Publish the results of a run as ROS 2 topics: `--to ros2:`."""

from __future__ import annotations

import queue
import threading
import time
from collections.abc import Mapping

from ullage.data import Frames, sensors_of
from ullage.errors import InputError
from ullage.flow import Sink
from ullage.ports import schema as ros
from ullage.ports.diagnostics import TOPIC, Status
from ullage.ports.intake import Worker, warn
from ullage.ports.protocol import Item
from ullage.ports.publisher import LATE_S, STEP_BACK_S, Clock, Message, Publisher, RateLimiter, in_order, is_present, on
from ullage.ports.ros2.middleware import CLOCK, Peer
from ullage.ports.ros2.options import SinkOptions
from ullage.processing.health import HealthMonitor

AHEAD_S = 2.0
"""How far the source may run ahead of what was published [s of stream]; at least two of its pieces."""
SETTLE_S = 0.5
"""Between finding a subscriber and its having found every topic [s]."""
STEP_S = 0.02
"""Longest sleep [s], so that closing does not wait."""


class StampOrder:
    """Hold messages until no older one can come, and release them in the order of their stamps.

    A source gives frames in pieces. Results of a piece, such as detections, come after it. So when the next piece
    begins, everything older than its first stamp is complete. The first messages are released once the complete ones
    span as much time as the longest piece. A source that needs time for its pieces then does not stall listeners.
    """

    def __init__(self) -> None:
        self._held: list[Message] = []
        self._ready: list[Message] = []  # complete, while the flow has not begun
        self._flows = False
        self._newest_ns: int | None = None
        self._longest_ns = 0

    @property
    def longest_s(self) -> float:
        """Span of the longest piece so far [s]."""
        return self._longest_ns * 1e-9

    def begin_piece(self, first_ns: int, last_ns: int) -> list[Message]:
        """Return the messages that are complete when a piece of frames begins.

        Args:
            first_ns: the oldest stamp of the piece [ns].
            last_ns: the newest [ns].
        """
        back = self._newest_ns is not None and first_ns < self._newest_ns - STEP_BACK_S * 1e9
        done = self._held if back else [message for message in self._held if message.t_ns < first_ns]
        self._held = [] if back else [message for message in self._held if message.t_ns >= first_ns]
        self._ready += sorted(done, key=in_order)
        self._longest_ns = max(self._longest_ns, last_ns - first_ns)
        self._newest_ns = last_ns
        span = self._ready[-1].t_ns - self._ready[0].t_ns if self._ready else 0
        self._flows = self._flows or (bool(self._ready) and span >= self._longest_ns)
        return self._release()

    def hold(self, messages: list[Message]) -> None:
        """Add the messages of a piece or of its results."""
        self._held += messages

    def finish(self) -> list[Message]:
        """Return the remaining messages."""
        self._ready += sorted(self._held, key=in_order)
        self._held, self._flows = [], True
        return self._release()

    def _release(self) -> list[Message]:
        if not self._flows:
            return []
        out, self._ready = self._ready, []
        return out


class Ros2Sink(Sink):
    """Publish all items of a stream at the pace of their stamps, from a separate thread.

    Messages leave in order of their stamps. Those of a chunk of frames wait until the results of the chunk, such
    as detections, are ready. A stream of the present is sent as it comes, and so is any stream with pace=0.

    Args:
        namespace: of the topics.
        options: of the sink.
        peer: the node to use; None: one of its own.

    Raises:
        InputError: the namespace or a remapping is invalid.
        MissingExtra: there is no rclpy.
    """

    settings = SinkOptions
    sends = True
    """Its messages leave this machine's process at once."""

    def __init__(self, namespace: str, options: SinkOptions, *, peer: Peer | None = None) -> None:
        self._options = options
        self._peer = peer or Peer(namespace, options)
        self._peer.spin()
        clock = Clock({"on": True, "off": False}.get(options.clock), rate_hz=options.clock_hz)
        self._publisher = Publisher(
            map_full_s=options.map_full_s, frame_prefix=options.frame_prefix, clock=clock, rays=options.rays
        )
        self._order = StampOrder()
        self._limiter = RateLimiter(options.pace)
        self._at_once: bool | None = None if options.pace else True  # None: the first frames decide
        self._messages: queue.Queue[Message | None] = queue.Queue()
        self._sent_ns: int | None = None
        self._progress = threading.Condition()
        self._map_subscribers, self._sent, self._late_s = 0, 0, 0.0
        self._health, self._status = HealthMonitor(), Status(f"{options.node}: sink")
        self._status.is_due()  # the first message comes a second from now
        self._closing = threading.Event()
        self._worker = Worker(self._run, "ullage ros2", failed=self._wake)
        self._worker.start()

    def write(self, item: Item) -> None:
        """Take one item; wait while earlier items are far from published.

        Raises:
            InputError: the sink is closed.
        """
        if self._closing.is_set():
            raise InputError("the sink is closed", where="ros2:")
        found = self._publisher.messages(item)
        parts = sensors_of(item) if isinstance(item, Frames | Mapping) else []
        self._health.judge({part.sensor: part for part in parts})
        if self._at_once is None and parts:
            self._at_once = is_present(min(int(part.t_ns[0]) for part in parts))
        if self._at_once or (found and found[0].quality == "relayed"):  # forwarded messages have no pace
            self._put(found)
            return
        if parts:
            first, last = min(int(part.t_ns[0]) for part in parts), max(int(part.t_ns[-1]) for part in parts)
            self._put(self._order.begin_piece(first, last))
        self._order.hold(found)

    def _put(self, messages: list[Message]) -> None:
        for message in messages:
            self._messages.put(message)
        if messages and messages[-1].quality != "relayed":
            with self._progress:
                self._progress.wait_for(lambda: self._near(messages[-1].t_ns))
        self._worker.check()

    def _near(self, t_ns: int) -> bool:
        ahead_s = max(AHEAD_S, 2 * self._order.longest_s)
        sent = self._sent_ns
        return self._worker.error is not None or (sent is not None and t_ns - sent <= ahead_s * 1e9)

    def _run(self) -> None:
        self._await_subscribers()
        while (message := self._messages.get()) is not None:
            if message.quality == "relayed":
                self._sent += self._peer.send(message)
                continue
            if message.topic == CLOCK:
                self._closing.wait(self._peer.enter(CLOCK))
            self._wait(message.t_ns)
            self._sent += self._peer.send(message, reliable=self._options.reliable or None)
            self._report(message.t_ns)
            self._sent_ns = message.t_ns
            self._wake()

    def _wake(self) -> None:
        with self._progress:
            self._progress.notify_all()

    def _await_subscribers(self) -> None:
        """Wait for subscribers of /tf, as `ros2 topic pub --wait-matching-subscriptions` does."""
        wanted = self._options.listeners
        if not wanted:
            return
        self._peer.publisher("/tf", ros.TRANSFORMS, "transforms")
        self._peer.publisher("map", ros.GRID, "latched")
        reported = time.monotonic()
        while (found := self._peer.listeners("/tf")) < wanted and not self._closing.wait(0.05):
            if time.monotonic() - reported > 10.0:
                warn(f"waiting for subscribers of /tf: {found} of {wanted}")
                reported = time.monotonic()
        self._closing.wait(SETTLE_S)
        self._map_subscribers = self._peer.listeners("map")  # not new: they get the first map in full

    def _wait(self, t_ns: int) -> None:
        if self._at_once:
            return
        due = self._limiter.due_s(t_ns, time.monotonic())
        while (left := due - time.monotonic()) > 0:
            time.sleep(min(left, STEP_S))
        self._late_s = max(self._late_s, self._limiter.late_s, -left)

    def _report(self, t_ns: int) -> None:
        """Check for new subscribers of the map and publish diagnostics, once a second."""
        if not self._status.is_due():
            return
        subscribers = self._peer.listeners("map")
        self._publisher.map_changes.wanted |= subscribers > self._map_subscribers
        self._map_subscribers = subscribers
        late, rate = self._late_s, self._sent / self._status.span_s
        faults, behind = self._health.faulty(), [f"{late:.1f} s behind its pace"] if late >= LATE_S else []
        text = ", ".join([*faults, *behind]) or "publishing"
        values = [("messages a second", f"{rate:.1f}"), ("most behind [s]", f"{late:.3f}")]
        values += [("waiting messages", str(self._messages.qsize()))]
        values += [(f"{topic}: frames", str(count)) for topic, count in self._publisher.counts.items()]
        values += [("faults so far", "; ".join(self._health.lines()))]
        level = 2 if faults else int(late >= LATE_S)
        self._peer.send(on(TOPIC, t_ns, self._status.told(t_ns, level, text, values).data))
        self._sent, self._late_s = 0, 0.0

    def close(self) -> None:
        """Publish the waiting messages, stay for the requested time, and leave the network."""
        if self._closing.is_set():
            return
        self._closing.set()
        try:
            self._order.hold(self._publisher.finish())
            for message in self._order.finish():
                self._messages.put(message)
            self._messages.put(None)
            self._worker.join()
            self._peer.settle(1.0)
            self._peer.leave(CLOCK)
            time.sleep(self._options.linger_s)
        finally:
            self._peer.close()
        self._worker.check()
