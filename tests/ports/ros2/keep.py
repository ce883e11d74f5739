"""Keeps every message of some topics as a hash, in order, as a real rclpy node that knows nothing of ullage.

The network fills messages with zeros to whole words of four bytes, so they are hashed so filled.

Ends when its input does. Prints one JSON object. Arguments: topic=package/msg/Name[:latched] ...
"""

from __future__ import annotations

import hashlib
import importlib
import json
import sys
import threading

import rclpy
from rclpy.qos import DurabilityPolicy, QoSProfile


def main() -> None:
    rclpy.init()
    node = rclpy.create_node("keep")
    kept: dict[str, list[str]] = {}

    def take(topic: str, data: bytes) -> None:
        kept.setdefault(topic, []).append(hashlib.sha1(data + bytes(-len(data) % 4)).hexdigest())

    for word in sys.argv[1:]:
        topic, _, kind = word.partition("=")
        latched = kind.endswith(":latched")
        package, _, name = kind.removesuffix(":latched").split("/")
        durability = DurabilityPolicy.TRANSIENT_LOCAL if latched else DurabilityPolicy.VOLATILE
        found = getattr(importlib.import_module(f"{package}.msg"), name)
        how = QoSProfile(depth=1000, durability=durability)
        node.create_subscription(found, topic, lambda data, t=topic: take(t, data), how, raw=True)
    over = threading.Event()
    threading.Thread(target=lambda: (sys.stdin.read(), over.set()), daemon=True).start()
    print("ready", flush=True)
    while not over.is_set():
        rclpy.spin_once(node, timeout_sec=0.1)
    print(json.dumps(kept))
    node.destroy_node()
    rclpy.shutdown()


main()
