"""Notes who places which frame, and when, until its input ends; a line of JSON each second. No arguments."""

from __future__ import annotations

import json
import time
from collections import Counter

import rclpy
from nav_msgs.msg import Odometry
from rclpy.qos import DurabilityPolicy, QoSProfile
from rosgraph_msgs.msg import Clock
from stranger import input_ended, node_of
from tf2_msgs.msg import TFMessage


def main() -> None:
    node = node_of("tree")
    seen: Counter[str] = Counter()
    kept = QoSProfile(depth=10, durability=DurabilityPolicy.TRANSIENT_LOCAL)

    def take(message: TFMessage) -> None:
        for found in message.transforms:
            seen[f"{found.header.frame_id}>{found.child_frame_id}"] += 1

    def odometry(message: Odometry) -> None:
        seen[f"odom of {message.child_frame_id}"] += 1

    def clock(message: Clock) -> None:
        seen["clock of the flight" if message.clock.sec or message.clock.nanosec else "clock of the robot"] += 1

    node.create_subscription(TFMessage, "/tf", take, 100)
    node.create_subscription(TFMessage, "/tf_static", take, kept)
    node.create_subscription(Odometry, "/odom", odometry, 100)
    node.create_subscription(Clock, "/clock", clock, 1000)
    over = input_ended()
    print("ready", flush=True)
    last = time.monotonic()
    while not over.is_set():
        rclpy.spin_once(node, timeout_sec=0.1)
        if time.monotonic() - last >= 1.0:
            print(json.dumps(seen), flush=True)
            last = time.monotonic()
            seen.clear()


main()
