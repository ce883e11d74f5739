"""A real rclpy node that asks for something ten times a second for ten seconds. Arguments: topic=number ..."""

from __future__ import annotations

import json
import sys
import time

import rclpy
from std_msgs.msg import Float32, Float64


def main() -> None:
    rclpy.init()
    node = rclpy.create_node("wish")
    wishes = []
    for word in sys.argv[1:]:
        topic, _, value = word.partition("=")
        kind = Float32 if topic.endswith(("height", "power")) else Float64
        wishes.append((node.create_publisher(kind, topic, 10), kind(data=float(value))))
    for _ in range(100):
        for publisher, message in wishes:
            publisher.publish(message)
        time.sleep(0.1)
    node.destroy_node()
    rclpy.shutdown()
    print(json.dumps(len(wishes)))


main()
