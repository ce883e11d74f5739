"""Receive frames from ROS 2 topics, with poses from transforms or odometry: `ullage run ros2:`."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from functools import partial
from typing import Any

from ullage.data import Frames
from ullage.errors import InputError
from ullage.ports import schema as ros
from ullage.ports.diagnostics import TOPIC, Status
from ullage.ports.intake import PATIENCE_S, Inbox, Log
from ullage.ports.live import LiveSource, options_of
from ullage.ports.protocol import Passed, Source
from ullage.ports.publisher import on
from ullage.ports.ros2.incoming import Incoming
from ullage.ports.ros2.middleware import Peer
from ullage.ports.ros2.options import SimulateOptions, SourceOptions

SEARCH_S = 0.5
"""How often the graph is asked for new topics [s]."""
DEPTH = 2000
"""Messages that rclpy keeps of a radar, so that a burst finds room."""
RELAYED = ("imc/", "to_imc/", "desired/")
"""Beneath the namespace: what is passed on as it comes."""


class Ros2Source(LiveSource):
    """Source of frames from the radars on a ROS 2 network.

    Args:
        namespace: namespace of their topics; empty: any.
        options: which topics, and the source of poses.
        log: takes lines for the user; None: they become warnings.
        peer: the node to use; None: one of its own.

    Raises:
        InputError: the namespace is invalid, or there is no such radar preset.
        MissingExtra: there is no rclpy.
    """

    where = "ros2:"

    def __init__(
        self, namespace: str, options: SourceOptions, *, log: Log | None = None, peer: Peer | None = None
    ) -> None:
        super().__init__(log=log, lag_s=options.lag_s)
        self._options = options
        self._incoming = Incoming(options, self._log_throttled)
        self.counters = self._incoming.counters
        self._peer = peer or Peer(namespace, options)
        self._namespace = "/" + namespace.strip("/")
        self._inbox: Inbox[tuple[str, Callable[..., None], tuple[Any, ...]]] = Inbox(self.counters)
        self._subscribed: set[str] = set()
        self._passed = False
        self._first_ns: int | None = None
        self._last_ns = 0
        self._searched_s = 0.0
        self._status = Status(f"{options.node}: source")
        self._given_s = time.monotonic()
        for topic, depth in (("/tf", None), ("/tf_static", 100)):
            fixed = topic == "/tf_static"
            taker = self._taker(topic, self._incoming.taker(topic, ros.TRANSFORMS, fixed=fixed), kept=fixed)
            self._peer.listen(topic, ros.TRANSFORMS, ros.TOPICS[topic].quality, taker, depth=depth)
        self._peer.spin()

    @property
    def sensors(self) -> tuple[str, ...]:
        """Names of the radars found so far."""
        return self._incoming.sensors

    def _step(self, chunk: int, *, stopping: bool) -> Iterator[dict[str, Frames]]:
        self._find_topics()
        end = time.monotonic() + self._options.batch_s
        while (left := end - time.monotonic()) > 0 and not (self._closed or stopping):
            self._take(min(left, 0.1))
        self._take(0.0)
        found = self._incoming.ready(chunk)
        self._report()
        if found:
            self._count(found)
            yield found
            self._given_s = time.monotonic()  # the consumer may have taken long
        elif stopping:
            self._ended = True
        elif time.monotonic() - self._given_s > PATIENCE_S:
            self._log_throttled(self._why_nothing())

    def _finish(self) -> None:
        self._incoming.finish()

    def _without_end(self) -> str:
        return "duration_s=, idle_s=" if self._options.duration_s is None and self._options.idle_s is None else ""

    def _release(self) -> None:
        self._peer.close()

    def _taker(self, topic: str, take: Callable[..., None], *first: Any, kept: bool = False) -> Callable[[bytes], None]:
        """Return a callback that passes messages from rclpy's thread to the stream's; kept ones may wait for long."""
        return lambda data: self._inbox.put((topic, take, (*first, data)), topic="" if kept else topic, size=len(data))

    def _take(self, timeout_s: float) -> None:
        found = self._inbox.get(timeout_s)
        while found is not None:
            topic, take, what = found
            self._incoming.take(topic, take, *what)
            found = self._inbox.get(0.0)

    def _find_topics(self) -> None:
        if time.monotonic() - self._searched_s < SEARCH_S:
            return
        self._searched_s = time.monotonic()
        there = self._peer.topics()
        for topic in self._wanted(there):
            if topic not in self._subscribed:
                self._listen(topic, there[topic])
        above = self._namespace.rstrip("/") + "/"
        for topic in there if self._options.relay else ():
            if topic.startswith(above) and topic[len(above) :].startswith(RELAYED) and topic not in self._subscribed:
                self._subscribed.add(topic)
                taker = self._taker(topic, self._pass, topic[len(above) :], there[topic])
                self._peer.listen(topic, there[topic], "relayed", taker)
        odom = self._options.odom and self._peer.resolved(self._options.odom)
        if odom in there and odom not in self._subscribed:
            self._subscribed.add(odom)
            self._peer.claim(odom)
            allowed = (ros.ODOMETRY, ros.POSE)
            if there[odom] not in allowed:
                raise InputError(f"{odom} carries {there[odom]}", where="odom", allowed=", ".join(allowed))
            taker = self._taker(odom, self._incoming.taker(odom, there[odom]))
            self._peer.listen(odom, there[odom], "sensor", taker, depth=200)

    def _pass(self, topic: str, kind: str, data: bytes) -> None:
        self._given_s = time.monotonic()
        self._passed = True
        t_ns = self._last_ns or time.time_ns()  # on the clock of the frames
        self.passing.give(lambda: [Passed(t_ns, topic, kind, data)])

    def _wanted(self, there: dict[str, str]) -> list[str]:
        named = [self._peer.resolved(name) for name in self._options.topics.split(",") if name]
        if named:
            return [name for name in named if name in there]
        near = [name for name in there if name.startswith(self._namespace.rstrip("/") + "/")]
        frames = [name for name in near if there[name] == ros.FRAME and self._peer.speaks(ros.FRAME)]
        profiles = [name for name in near if there[name] == ros.CLOUD and name.endswith("/profile")]
        has_frames = {name.rpartition("/")[0] for name in frames}
        return frames + [name for name in profiles if name.rpartition("/")[0] not in has_frames]

    def _listen(self, topic: str, kind: str) -> None:
        self._subscribed.add(topic)
        base = topic.rpartition("/")[0]
        self._peer.claim(*(f"{base}/{name}" for name in ("frame", "settings", "profile", "range")))
        allowed = (ros.FRAME, ros.CLOUD, ros.RANGE)
        if kind not in allowed:
            raise InputError(f"{topic} carries {kind}", where="topics", allowed=", ".join(allowed))
        if kind == ros.FRAME:
            settings = f"{base}/settings"
            taker = self._taker(settings, self._incoming.taker(settings, ros.SETTINGS), kept=True)
            self._peer.listen(settings, ros.SETTINGS, "latched", taker)
        taker = self._taker(topic, self._incoming.taker(topic, kind))
        self._peer.listen(topic, kind, "sensor", taker, depth=DEPTH, lost=partial(self._lost, topic))
        self._log(f"listening to {topic}")

    def _lost(self, topic: str, count: int) -> None:
        """Count messages that the middleware lost; frames are counted by their numbers."""
        if not topic.endswith("/frame"):
            self.counters.drop(topic, "lost", "the network or its queues", count=count)

    def _over(self) -> bool:
        length, idle = self._options.duration_s, self._options.idle_s
        begun = self._first_ns is not None or self._passed
        if idle is not None and begun and time.monotonic() - self._given_s > idle:
            return True
        return length is not None and self._first_ns is not None and self._last_ns - self._first_ns >= length * 1e9

    def _count(self, found: dict[str, Frames]) -> None:
        first = min(int(part.t_ns[0]) for part in found.values())
        self._first_ns = first if self._first_ns is None else self._first_ns
        self._last_ns = max(self._last_ns, *(int(part.t_ns[-1]) for part in found.values()))

    def _why_nothing(self) -> str:
        if not (self._subscribed - {self._options.odom}):
            return f"no radar topics under {self._namespace} (of {ros.FRAME}, or */profile of {ros.CLOUD}); waiting"
        if self._incoming.waits_for:
            return f"frames wait for poses: {self._incoming.waits_for}"
        return "no frames come any more; waiting (Ctrl-C ends)"

    def _report(self) -> None:
        if not self._status.is_due():
            return
        idle = time.monotonic() - self._given_s
        level = 0 if idle < 1.0 + self._options.patience_s else 1 if self._incoming.sensors else 3
        text = "frames come" if level == 0 else self._why_nothing()
        values = [("radars", ", ".join(self.sensors)), ("seconds since the last frame", f"{idle:.1f}")]
        told = self._status.told(time.time_ns(), level, text, [*values, *self.counters.values()])
        self._peer.send(on(TOPIC, told.t_ns, told.data))


def open_source(namespace: str, options: dict[str, Any]) -> Source:
    """Open frames from topics: `ros2:NAMESPACE?key=value`; simulated on a robot: `?simulate=WORLD`, `?fly=WORLD`.

    Raises:
        InputError: an option is unknown or of no use.
        MissingExtra: there is no rclpy.
    """
    where = f"ros2:{namespace}"
    if "fly" in options:
        from ullage.ports.ros2.commands import TopicFlyOptions, open_flight

        return open_flight(namespace, options_of(TopicFlyOptions, options, where))
    if "simulate" in options or "world" in options:
        from ullage.ports.ros2.cosimulation import Ros2Radars

        return Ros2Radars(namespace, options_of(SimulateOptions, options, where))
    return Ros2Source(namespace, options_of(SourceOptions, options, where))
