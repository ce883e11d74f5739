"""Leave to other nodes what they publish: whole topics such as /clock and odom, and transforms by their child frame."""

from __future__ import annotations

import random
import time
from collections import deque
from collections.abc import Callable
from contextlib import suppress
from typing import Protocol

from ullage.ports import schema as ros
from ullage.ports.intake import Once
from ullage.ports.publisher import Message
from ullage.ports.schema import Quality

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


class Publishing(Protocol):
    """Interface that `Sharing` needs of a node."""

    def others(self, topic: str) -> bool:
        """Return whether another program publishes a topic."""

    def withdraw(self, topic: str) -> None:
        """Stop publishing a topic."""

    def leads(self, topic: str) -> bool:
        """Return whether this node publishes a topic already, or is the first of those that have entered for it."""

    def listen(
        self, topic: str, kind: str, quality: Quality, take: Callable[[bytes], None], *, depth: int | None = None
    ) -> None:
        """Call `take` with each message of a topic."""


class Sharing:
    """Decide what a node sends when other nodes publish the same. It checks continuously, as nodes come and go.

    Args:
        node: that publishes.
    """

    def __init__(self, node: Publishing) -> None:
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
