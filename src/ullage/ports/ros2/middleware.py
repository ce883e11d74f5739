"""A node of ullage in rclpy: publishers and subscriptions of messages as bytes.

Messages are made and read as CDR by `ports.messages`, which takes microseconds; rclpy passes the bytes on and needs
only the type's support library, whose absence is said once.
"""

from __future__ import annotations

import importlib
import re
import warnings
from collections.abc import Callable
from typing import Any

from ullage.errors import InputError, UllageWarning, need
from ullage.ports.ros2.options import NodeOptions
from ullage.ports.ros2.outgoing import Note, Quality

HOW = {
    "sensor": (5, False, False),  # depth, reliable, kept: as rclcpp's SensorDataQoS
    "stream": (50, True, False),
    "transforms": (100, True, False),  # as tf2_ros' DynamicBroadcasterQoS
    "latched": (1, True, True),  # as nav2's and map_server's maps, and tf2_ros' StaticBroadcasterQoS
}
NAMESPACE = re.compile(r"/?([A-Za-z_]\w*(/[A-Za-z_]\w*)*)?/?")


def profile(quality: Quality, *, depth: int | None = None, reliable: bool | None = None) -> Any:
    """The rclpy QoSProfile of a quality."""
    from rclpy.qos import DurabilityPolicy, HistoryPolicy, QoSProfile, ReliabilityPolicy

    usual, firm, kept = HOW[quality]
    firm = firm if reliable is None else reliable
    return QoSProfile(
        history=HistoryPolicy.KEEP_LAST,
        depth=depth or usual,
        reliability=ReliabilityPolicy.RELIABLE if firm else ReliabilityPolicy.BEST_EFFORT,
        durability=DurabilityPolicy.TRANSIENT_LOCAL if kept else DurabilityPolicy.VOLATILE,
    )


def message_class(kind: str) -> Any:
    """The class of `package/msg/Name` in the installed packages; None where it is not there."""
    package, _, name = kind.split("/")
    try:
        return getattr(importlib.import_module(f"{package}.msg"), name)
    except (ImportError, AttributeError):
        return None


class Peer:
    """One node in a context of its own, so that a program that has its own rclpy is left alone.

    Args:
        namespace: of its topics.
        options: domain and name.

    Raises:
        InputError: the namespace is none.
        MissingExtra: there is no rclpy.
    """

    def __init__(self, namespace: str, options: NodeOptions) -> None:
        rclpy = need("rclpy", extra="ros2")
        if not NAMESPACE.fullmatch(namespace):
            raise InputError(f"not a namespace {namespace!r}", where="ros2:", allowed="names and /, as in ros2:/drone1")
        from rclpy.signals import SignalHandlerOptions

        self.context = rclpy.Context()
        rclpy.init(context=self.context, domain_id=options.domain, signal_handler_options=SignalHandlerOptions.NO)
        self.node = rclpy.create_node(
            options.node, namespace="/" + namespace.strip("/"), context=self.context, use_global_arguments=False
        )
        self._publishers: dict[str, Any] = {}
        self._told: set[str] = set()

    def class_of(self, kind: str, topic: str) -> Any:
        """The class of a message; None, said once, where its package is missing."""
        found = message_class(kind)
        package = kind.partition("/")[0]
        if found is None and package not in self._told:
            self._told.add(package)
            how = "python -m ullage.ports.ros2.build, or from your ROS 2 distribution"
            warnings.warn(f"{package} is not installed, so {topic} is left out; get it with: {how}", UllageWarning, 3)
        return found

    def publisher(self, topic: str, kind: str, quality: Quality, *, reliable: bool | None = None) -> Any:
        """The publisher of a topic, made when first asked for; None where its type is missing."""
        if topic not in self._publishers:
            found = self.class_of(kind, topic)
            quality_of = profile(quality, reliable=reliable) if found else None
            self._publishers[topic] = self.node.create_publisher(found, topic, quality_of) if found else None
        return self._publishers[topic]

    def send(self, note: Note, *, reliable: bool | None = None) -> bool:
        """Publish one message; whether there was a way to."""
        out = self.publisher(note.topic, note.kind, note.quality, reliable=reliable)
        if out is not None:
            out.publish(note.data)
        return out is not None

    def listeners(self, topic: str) -> int:
        """How many listen to a topic of ours."""
        out = self._publishers.get(topic)
        return out.get_subscription_count() if out is not None else 0

    def listen(self, topic: str, kind: str, quality: Quality, take: Callable[[bytes], None], **how: Any) -> Any:
        """Call `take` with each message as bytes; None where the type is missing."""
        found = self.class_of(kind, topic)
        return (
            None
            if found is None
            else self.node.create_subscription(found, topic, take, profile(quality, **how), raw=True)
        )

    def settle(self, timeout_s: float) -> None:
        """Wait until what was sent reliably has arrived."""
        from rclpy.duration import Duration

        for out in self._publishers.values():
            if out is not None and out.get_subscription_count():
                out.wait_for_all_acked(Duration(seconds=timeout_s))

    def close(self) -> None:
        """Leave the network."""
        import rclpy

        if self.context.ok():
            self.node.destroy_node()
            rclpy.shutdown(context=self.context)
