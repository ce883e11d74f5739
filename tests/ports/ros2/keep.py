"""Keeps every message of some topics as a hash, in order, as a real rclpy node that knows nothing of ullage.

The network fills messages with zeros to whole words of four bytes, so they are hashed so filled.

Ends when its input does. Prints one JSON object. Arguments: topic=package/msg/Name[:latched] ...
"""

from __future__ import annotations

import hashlib
import json
import sys

import rclpy
from rclpy.qos import DurabilityPolicy, QoSProfile
from stranger import input_ended, node_of, type_of


def main() -> None:
    node = node_of("keep")
    kept: dict[str, list[str]] = {}

    def take(topic: str, data: bytes) -> None:
        kept.setdefault(topic, []).append(hashlib.sha1(data + bytes(-len(data) % 4)).hexdigest())

    for word in sys.argv[1:]:
        topic, _, kind = word.partition("=")
        latched = kind.endswith(":latched")
        durability = DurabilityPolicy.TRANSIENT_LOCAL if latched else DurabilityPolicy.VOLATILE
        found = type_of(kind.removesuffix(":latched"))
        how = QoSProfile(depth=1000, durability=durability)
        node.create_subscription(found, topic, lambda data, t=topic: take(t, data), how, raw=True)
    over = input_ended()
    print("ready", flush=True)
    while not over.is_set():
        rclpy.spin_once(node, timeout_sec=0.1)
    print(json.dumps(kept))


main()
