"""Passes ROS 2 topics on as (topic, type, bytes) through its output, for a program that knows another ROS.

Arguments: topic=package/msg/Name:quality ...
"""

from __future__ import annotations

import pickle
import sys
from functools import partial

from ullage.ports.ros2.middleware import Peer
from ullage.ports.ros2.options import NodeOptions


def passed(topic: str, kind: str, data: bytes) -> None:
    pickle.dump((topic, kind, data), sys.stdout.buffer)
    sys.stdout.buffer.flush()


def main() -> None:
    peer = Peer("", NodeOptions(node="tap"))
    for word in sys.argv[1:]:
        topic, _, rest = word.partition("=")
        kind, _, quality = rest.partition(":")
        peer.listen(topic, kind, quality, partial(passed, topic, kind), depth=100)  # type: ignore[arg-type]
    peer.spin()
    sys.stdin.read()
    peer.close()


main()
