"""A real rclpy node that asks for something ten times a second for ten seconds. Arguments: topic=number ..."""

from __future__ import annotations

import json
import sys

from std_msgs.msg import Float32, Float64
from stranger import node_of, repeat


def main() -> None:
    node = node_of("wish")
    wishes = []
    for word in sys.argv[1:]:
        topic, _, value = word.partition("=")
        kind = Float32 if topic.endswith(("height", "power")) else Float64
        wishes.append((node.create_publisher(kind, topic, 10), kind(data=float(value))))
    repeat(wishes, 100)
    print(json.dumps(len(wishes)))


main()
