"""Leave to other nodes what they publish: whole topics such as /clock and odom, and transforms by their child frame."""

from __future__ import annotations

import random
import time
import warnings
from collections import deque
from collections.abc import Callable
from contextlib import suppress
from typing import Protocol

from ullage.errors import UllageWarning
from ullage.ports import messages as ros
from ullage.ports.publisher import Message, Quality

ONE_PUBLISHER = {"/clock", "odom", "truth/odom"}
"""Topics that make sense from one node only."""
TRANSFORMS: dict[str, Quality] = {"/tf": "transforms", "/tf_static": "latched"}
CHECK_S = 0.1
"""How often the graph is asked who publishes [s]."""
RETRY_S = (1.0, 3.0)
"""A topic that others have left is taken up after a random time between these [s]: two nodes may both be waiting."""
SENT: deque[int] = deque(maxlen=2000)
"""Hashes of the transform messages that this program sent, which it receives as well."""


class Publishing(Protocol):
    """What `Sharing` needs of a node."""

    def others(self, topic: str) -> bool:
        """Whether another program publishes a topic."""

    def withdraw(self, topic: str) -> None:
        """Stop publishing a topic."""

    def listen(
        self, topic: str, kind: str, quality: Quality, take: Callable[[bytes], None], *, depth: int | None = None
    ) -> None:
        """Call `take` with each message of a topic."""


class Sharing:
    """Decides what a node sends beside the nodes of others. It checks all the time, since others come and go.

    Args:
        node: that publishes.
    """

    def __init__(self, node: Publishing) -> None:
        self._node = node
        self._others: dict[str, tuple[float, bool]] = {}  # when a topic was last checked [s], and the answer
        self._retry_s: dict[str, float] = {}
        self._reported: set[str] = set()
        self._foreign: dict[str, set[str]] = {}  # by topic: child frames that others publish
        self._fixed: Message | None = None  # the last /tf_static, whole
        self._fixed_without: set[str] = set()  # what was left out of it

    def allows(self, topic: str) -> bool:
        """Whether a topic that one node only should publish is ours now."""
        now = time.monotonic()
        if self._others_on(topic):
            self._node.withdraw(topic)
            self._retry_s[topic] = now + random.uniform(*RETRY_S)
            self._report(topic, f"others publish {topic}; it is left to them")
            return False
        return now >= self._retry_s.get(topic, 0.0)

    def transforms(self, message: Message) -> list[Message]:
        """What to send for a message of /tf or /tf_static: it without the frames that others place.

        Where others have begun to place a fixed frame, the fixed transforms come once more without it, since a late
        subscriber is given the last message.
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
        """Track the frames that other publishers place, while there are other publishers."""
        if not self._others_on(topic):
            if topic in self._foreign:
                self._foreign[topic] = set()
        elif topic not in self._foreign:
            self._foreign[topic] = set()
            self._node.listen(
                topic, ros.TRANSFORMS, TRANSFORMS[topic], lambda data: self._read_transforms(topic, data), depth=100
            )  # fmt: skip

    def _read_transforms(self, topic: str, data: bytes) -> None:
        """Take a message of /tf or /tf_static by whomever."""
        if hash(data) in SENT:
            return
        with suppress(Exception):  # a damaged message says nothing
            self._add(topic, {found.child_frame_id for found in ros.from_bytes(ros.TRANSFORMS, data).transforms})

    def _add(self, topic: str, children: set[str]) -> None:
        for child in sorted(children - self._foreign[topic]):
            self._report(f"frame {child}", f"others publish the transform of {child}; it is left to them")
        self._foreign[topic] = self._foreign[topic] | children

    def _report(self, key: str, text: str) -> None:
        if key not in self._reported and len(self._reported) < 100:
            self._reported.add(key)
            warnings.warn(text, UllageWarning, stacklevel=5)


def without(message: Message, children: set[str]) -> Message:
    """A message of transforms without those of some child frames."""
    if not children:
        return message
    found = ros.from_bytes(ros.TRANSFORMS, message.data).transforms
    kept = [transform for transform in found if transform.child_frame_id not in children]
    if len(kept) == len(found):
        return message
    return message._replace(data=ros.to_bytes(ros.TRANSFORMS, ros.make(ros.TRANSFORMS, kept)))
