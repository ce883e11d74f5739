"""Publish and subscribe to messages as bytes through an rclpy node.

`ports.schema` encodes and decodes CDR in microseconds. rclpy passes the bytes on and needs
only the type's support library. A missing one is reported once. What other nodes publish is left to them: whole topics
such as /clock and odom, and transforms by their child frame.
"""

from __future__ import annotations

import importlib
import random
import re
import threading
import time
import uuid
from collections import Counter, deque
from collections.abc import Callable, Iterable
from contextlib import suppress
from typing import Any, NamedTuple

from ullage.errors import InputError, need
from ullage.ports import schema as ros
from ullage.ports.intake import Counters, Inbox, Once
from ullage.ports.publisher import Message
from ullage.ports.ros2.options import NodeOptions
from ullage.ports.schema import QUALITIES, Quality

TAKEN: set[str] = set()
"""Topics that something in this program listens to: what came in there must not go out there again."""
OWN: Counter[str] = Counter()
"""Topics that this program publishes, with the number of its publishers."""
SEARCH_S = 0.2
"""How often the graph is asked for topics that somebody has begun to publish [s]."""
CLOCK = "/clock"
ONE_PUBLISHER = {CLOCK, "odom", "truth/odom"}
"""Topics that make sense from one node only."""
TRANSFORMS: dict[str, Quality] = {"/tf": "transforms", "/tf_static": "latched"}
CHECK_S = 0.1
"""How often the graph is asked who publishes [s]."""
ENTERED_S = 1.0
"""By then a node that has entered for a topic knows all others that had [s]."""
RETRY_S = (1.0, 3.0)
"""A topic that others have left is taken up after a random time between these [s]: two nodes may both be waiting."""
SENT: deque[int] = deque(maxlen=2000)
"""Hashes of the transform messages that this program sent, which it receives as well."""
REMAP = re.compile(r"[~/\w]+:=[~/\w]+")
NAMESPACE = re.compile(r"/?([A-Za-z_]\w*(/[A-Za-z_]\w*)*)?/?")


def profile(quality: Quality, *, depth: int | None = None, reliable: bool | None = None) -> Any:
    """Return the rclpy QoSProfile of a quality."""
    from rclpy.qos import DurabilityPolicy, HistoryPolicy, QoSProfile, ReliabilityPolicy

    usual, firm, kept = QUALITIES[quality]
    firm = firm if reliable is None else reliable
    return QoSProfile(
        history=HistoryPolicy.KEEP_LAST,
        depth=depth or usual,
        reliability=ReliabilityPolicy.RELIABLE if firm else ReliabilityPolicy.BEST_EFFORT,
        durability=DurabilityPolicy.TRANSIENT_LOCAL if kept else DurabilityPolicy.VOLATILE,
    )


def message_class(kind: str) -> Any:
    """Return the class of `package/msg/Name` in the installed packages; None if it is missing."""
    package, _, name = kind.split("/")
    try:
        return getattr(importlib.import_module(f"{package}.msg"), name)
    except (ImportError, AttributeError):
        return None


class Received(NamedTuple):
    """A message that waits to be used."""

    topic: str  # its full name
    kind: str
    data: bytes


class Peer:
    """Node of ullage: a given one, or one in its own context, apart from the rclpy of the calling program.

    Args:
        namespace: of its topics.
        options: domain, name and remappings.
        node: an rclpy node to use; its owner spins and destroys it.

    Raises:
        InputError: the namespace or a remapping is invalid.
        MissingExtra: there is no rclpy.
    """

    def __init__(self, namespace: str, options: NodeOptions, *, node: Any = None) -> None:
        rclpy = need("rclpy", extra="ros2")
        if not NAMESPACE.fullmatch(namespace):
            raise InputError(f"not a namespace {namespace!r}", where="ros2:", allowed="names and /, as in ros2:/drone1")
        rules = [word for word in options.remap.split(",") if word]
        if wrong := [rule for rule in rules if not REMAP.fullmatch(rule)]:
            raise InputError(f"not a remapping {wrong[0]!r}", where="remap", allowed="FROM:=TO, with commas between")
        self._context = None
        self._prefix = namespace.strip("/") + "/" if node is not None and namespace.strip("/") else ""
        if node is None:
            from rclpy.signals import SignalHandlerOptions

            self._context = rclpy.Context()
            quiet = SignalHandlerOptions.NO
            rclpy.init(context=self._context, domain_id=options.domain, signal_handler_options=quiet)
            above = "/" + namespace.strip("/")
            words = ["--ros-args", *(word for rule in rules for word in ("-r", rule))] if rules else None
            node = rclpy.create_node(
                options.node, namespace=above, context=self._context, use_global_arguments=False, cli_args=words
            )
        self.node = node
        self.counters = Counters()
        self.events: Inbox[Received] = Inbox(self.counters)
        self._appeared: set[str] = set()
        self._searched_s = 0.0
        self._publishers: dict[str, Any] = {}
        self._subscriptions: list[Any] = []
        # by topic: a hidden topic of ours, and when others know it [s]
        self._entered: dict[str, tuple[str, float]] = {}
        self._sharing = Sharing(self)
        self._once = Once()
        self._claimed: set[str] = set()
        self._executor: Any = None
        self._thread: threading.Thread | None = None

    def spin(self) -> None:
        """Spin the node in its own thread; the owner of a given node spins it."""
        if self._context is None or self._thread is not None:
            return
        from rclpy.executors import SingleThreadedExecutor

        self._executor = SingleThreadedExecutor(context=self._context)
        self._executor.add_node(self.node)
        self._thread = threading.Thread(target=self._spin, name="ullage ros2", daemon=True)
        self._thread.start()

    def _spin(self) -> None:
        from rclpy.executors import ExternalShutdownException

        with suppress(ExternalShutdownException):
            self._executor.spin()

    def claim(self, *topics: str) -> None:
        """Reserve these topics in this program until this node closes."""
        self._claimed.update(topics)
        TAKEN.update(topics)

    def topics(self) -> dict[str, str]:
        """Return topics on the network that other nodes publish, with their types."""
        named = self.node.get_topic_names_and_types()
        return {name: kinds[0] for name, kinds in named if not OWN[name] and self.node.count_publishers(name)}

    def resolved(self, topic: str) -> str:
        """Return the full name of a topic."""
        return str(self.node.resolve_topic_name(self._named(topic)))

    def speaks(self, kind: str) -> bool:
        """Return whether a message's package is installed."""
        return message_class(kind) is not None

    def _named(self, topic: str) -> str:
        return topic if topic.startswith("/") else self._prefix + topic

    def class_of(self, kind: str, topic: str) -> Any:
        """Return the class of a message, or None if its package is missing, which is reported once."""
        found = message_class(kind)
        package = kind.partition("/")[0]
        if found is None:
            how = "python -m ullage.ports.ros2.build, or from your ROS 2 distribution"
            self._once(f"{package} is not installed, so {topic} is left out; get it with: {how}", kind=package)
        return found

    def publisher(self, topic: str, kind: str, quality: Quality, *, reliable: bool | None = None) -> Any:
        """Return the publisher of a topic, made at the first call; None if its type is missing."""
        if topic not in self._publishers:
            found = self.class_of(kind, topic)
            how = profile(quality, reliable=reliable)
            OWN[self.resolved(topic)] += found is not None  # before it exists: a source checks from its own thread
            self._publishers[topic] = self.node.create_publisher(found, self._named(topic), how) if found else None
        return self._publishers[topic]

    def withdraw(self, topic: str) -> None:
        """Stop publishing a topic."""
        out = self._publishers.pop(topic, None)
        if out is not None:
            self.node.destroy_publisher(out)
            OWN[self.resolved(topic)] -= 1

    def enter(self, topic: str) -> float:
        """Enter for a topic that one node of ullage publishes for all; return the time until all are known [s]."""
        if topic not in self._entered:
            name = f"{self.resolved(topic)}/_ullage/_{uuid.uuid4().hex}"
            self.publisher(name, ros.CLOCK, "stream")
            self._entered[topic] = name, time.monotonic() + ENTERED_S
        return max(0.0, self._entered[topic][1] - time.monotonic())

    def leads(self, topic: str) -> bool:
        """Return whether this node publishes a topic already, or is the first of those that have entered for it."""
        if self._publishers.get(topic) is not None:
            return True
        if self.enter(topic):
            return False
        name = self._entered[topic][0]
        area = name.rpartition("/")[0]
        return all(name <= other for other, _ in self.node.get_topic_names_and_types() if other.startswith(area))

    def leave(self, topic: str) -> None:
        """Leave a topic to the others that have entered for it."""
        self.withdraw(topic)
        if topic in self._entered:
            self.withdraw(self._entered.pop(topic)[0])

    def others(self, topic: str) -> bool:
        """Return whether another program publishes a topic."""
        name = self.resolved(topic)
        return int(self.node.count_publishers(name)) > OWN[name]

    def send(self, message: Message, *, reliable: bool | None = None) -> bool:
        """Publish one message; return False if its type is missing or another node publishes the topic."""
        topic = message.topic
        if self._publishers.get(topic) is None and self.resolved(topic) in TAKEN:
            return False
        if topic in ONE_PUBLISHER and not self._sharing.allows(topic):
            return False
        sent = False
        for found in self._sharing.transforms(message) if topic in TRANSFORMS else [message]:
            out = self.publisher(found.topic, found.kind, found.quality, reliable=reliable)
            if out is not None:
                out.publish(found.data)
            sent = out is not None
        return sent

    def listeners(self, topic: str) -> int:
        """Count the subscribers of our topic."""
        out = self._publishers.get(topic)
        return out.get_subscription_count() if out is not None else 0

    def listen(
        self, topic: str, kind: str, quality: Quality, take: Callable[[bytes], None], *, depth: int | None = None,
        lost: Callable[[int], None] | None = None,
    ) -> None:  # fmt: skip
        """Call `take` with each message as bytes, and `lost` with the number of messages that the middleware lost."""
        found = self.class_of(kind, topic)
        if found is None:
            return
        from rclpy.event_handler import SubscriptionEventCallbacks

        how = profile(quality, depth=depth)
        events = SubscriptionEventCallbacks(
            message_lost=None if lost is None else lambda event: lost(event.total_count_change),
            use_default_callbacks=False,
        )
        subscription = self.node.create_subscription(
            found, self._named(topic), take, how, raw=True, event_callbacks=events
        )
        self._subscriptions.append(subscription)

    def receive(self, topic: str, kind: str, quality: Quality, *, depth: int | None = None) -> None:
        """Keep the messages of a topic in `events` until `wait` gives them."""
        name = self.resolved(topic)

        def put(data: bytes) -> None:
            self.events.put(Received(name, kind, data), topic=name, size=len(data))

        self.listen(topic, kind, quality, put, depth=depth)

    def wait(self, timeout_s: float) -> Received | None:
        """Return the next message, or None if none came within the timeout."""
        return self.events.get(timeout_s)

    def appeared(self, topics: Iterable[str]) -> dict[str, str]:
        """Return those of these topics that somebody has begun to publish, each once, with their types."""
        if time.monotonic() - self._searched_s < SEARCH_S:
            return {}
        self._searched_s = time.monotonic()
        there = self.topics()
        fresh = {topic: there[topic] for topic in topics if topic in there and topic not in self._appeared}
        self._appeared.update(fresh)
        return fresh

    def settle(self, timeout_s: float) -> None:
        """Wait until all reliable messages have arrived, unless the owner of the node has ended its context."""
        from rclpy.duration import Duration

        if not self.node.context.ok():
            return
        for out in self._publishers.values():
            if out is not None and out.get_subscription_count():
                out.wait_for_all_acked(Duration(seconds=timeout_s))

    def close(self) -> None:
        """Leave the network; a given node stays, without our publishers and subscriptions."""
        TAKEN.difference_update(self._claimed)
        if self._context is None or self._context.ok():
            OWN.subtract(self.resolved(topic) for topic, out in self._publishers.items() if out is not None)
        if self._context is None:
            for out in filter(None, self._publishers.values()):
                self.node.destroy_publisher(out)
            for subscription in self._subscriptions:
                self.node.destroy_subscription(subscription)
            self._publishers, self._subscriptions = {}, []
            return
        if not self._context.ok():
            return
        import rclpy

        if self._executor is not None:
            self._executor.shutdown(timeout_sec=2.0)
        rclpy.shutdown(context=self._context)
        if self._thread is not None and self._thread is not threading.current_thread():
            self._thread.join(timeout=2.0)
        self.node.destroy_node()


class Sharing:
    """Decide what a node sends when other nodes publish the same. It checks continuously, as nodes come and go.

    Args:
        node: that publishes.
    """

    def __init__(self, node: Peer) -> None:
        self._node = node
        self._others: dict[str, tuple[float, bool]] = {}  # time of the last check of a topic [s], and its result
        self._retry_s: dict[str, float] = {}
        self._once = Once()
        self._foreign: dict[str, set[str]] = {}  # by topic: child frames that other nodes publish
        self._fixed: Message | None = None  # the last complete /tf_static
        self._fixed_without: set[str] = set()  # child frames left out of it

    def allows(self, topic: str) -> bool:
        """Return whether this node may publish a topic that only one node should publish.

        Nodes of ullage that start together enter for the clock before any of them publishes it, so it never falls.
        """
        now = time.monotonic()
        if self._others_on(topic):
            self._node.withdraw(topic)
            self._retry_s[topic] = now + random.uniform(*RETRY_S)
            self._once(f"others publish {topic}; it is left to them")
            return False
        return now >= self._retry_s.get(topic, 0.0) and (topic != CLOCK or self._node.leads(topic))

    def transforms(self, message: Message) -> list[Message]:
        """Return the messages to send for one of /tf or /tf_static, without the frames that other nodes publish.

        When another node begins to publish a fixed frame, the fixed transforms are sent again without it, since a late
        subscriber receives the last message.
        """
        for topic in TRANSFORMS:
            self._watch(topic)
        foreign: set[str] = set().union(*self._foreign.values())
        out = []
        if message.topic == "/tf_static":
            self._fixed, self._fixed_without = message, foreign
            out.append(without(message, foreign))
        else:
            if self._fixed is not None and foreign != self._fixed_without:
                self._fixed_without = foreign
                out.append(without(self._fixed, foreign))
            out.append(without(message, foreign))
        kept = [found for found in out if found.topic == "/tf_static" or found.data[4:8] != bytes(4)]
        SENT.extend(hash(found.data) for found in kept)
        return kept

    def _others_on(self, topic: str) -> bool:
        now = time.monotonic()
        checked_s, found = self._others.get(topic, (-CHECK_S, False))
        if now - checked_s >= CHECK_S:
            found = self._node.others(topic)
            self._others[topic] = now, found
        return found

    def _watch(self, topic: str) -> None:
        """Track the child frames of other publishers, while there are other publishers."""
        if not self._others_on(topic):
            if topic in self._foreign:
                self._foreign[topic] = set()
        elif topic not in self._foreign:
            self._foreign[topic] = set()
            self._node.listen(
                topic, ros.TRANSFORMS, TRANSFORMS[topic], lambda data: self._read_transforms(topic, data), depth=100
            )  # fmt: skip

    def _read_transforms(self, topic: str, data: bytes) -> None:
        """Take a message of /tf or /tf_static from any publisher."""
        if hash(data) in SENT:
            return
        with suppress(Exception):  # ignore a damaged message
            self._add(topic, {found.child_frame_id for found in ros.from_bytes(ros.TRANSFORMS, data).transforms})

    def _add(self, topic: str, children: set[str]) -> None:
        for child in sorted(children - self._foreign[topic]):
            self._once(f"others publish the transform of {child}; it is left to them")
        self._foreign[topic] = self._foreign[topic] | children


def without(message: Message, children: set[str]) -> Message:
    """Return a message of transforms without those of some child frames."""
    if not children:
        return message
    found = ros.from_bytes(ros.TRANSFORMS, message.data).transforms
    kept = [transform for transform in found if transform.child_frame_id not in children]
    if len(kept) == len(found):
        return message
    return message._replace(data=ros.to_bytes(ros.TRANSFORMS, ros.make(ros.TRANSFORMS, kept)))
