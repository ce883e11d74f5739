"""A real rclpy subscriber that knows nothing of ullage but its topics: counts, stamps, and what came last, as JSON.

Ends when its input does, or with `--all` as first argument once every topic was heard.
Arguments: topic=package/msg/Name:quality ...
"""

from __future__ import annotations

import json
import sys
from collections import Counter
from typing import Any

import rclpy
from rclpy.qos import DurabilityPolicy, QoSProfile, qos_profile_sensor_data
from stranger import input_ended, node_of, type_of

HOW = {
    "sensor": qos_profile_sensor_data,
    "stream": QoSProfile(depth=100),
    "latched": QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL),
}


def plain(value: Any) -> Any:
    """A message as plain values; long arrays by their length and sum."""
    if hasattr(value, "get_fields_and_field_types"):
        return {name: plain(getattr(value, name)) for name in value.get_fields_and_field_types()}
    if isinstance(value, str | int | float | bool):
        return value
    if isinstance(value, bytes):
        return list(value)
    listed = value.tolist() if hasattr(value, "tolist") else list(value)
    if len(listed) > 50 and isinstance(listed[0], int | float):
        return {"length": len(listed), "sum": float(sum(listed)), "head": listed[:8]}
    return [plain(v) for v in listed]


def main() -> None:
    node = node_of("hear")
    count: Counter[str] = Counter()
    last: dict[str, Any] = {}
    stamps: dict[str, list[int]] = {}

    def take(topic: str, message: Any) -> None:
        count[topic] += 1
        last[topic] = message
        if hasattr(message, "header"):
            stamp = message.header.stamp
            stamps.setdefault(topic, []).append(stamp.sec * 10**9 + stamp.nanosec)

    until_all = sys.argv[1] == "--all"
    words = sys.argv[1 + until_all :]
    for word in words:
        topic, _, rest = word.partition("=")
        kind, _, quality = rest.partition(":")
        found = type_of(kind)
        node.create_subscription(found, topic, lambda m, t=topic: take(t, m), HOW[quality])
    over = input_ended()
    print("ready", flush=True)
    while not (over.is_set() or (until_all and len(count) == len(words))):
        rclpy.spin_once(node, timeout_sec=0.1)
    shown = {topic: plain(message) for topic, message in last.items()}
    print(json.dumps({"count": count, "stamps": stamps, "last": shown}))


main()
