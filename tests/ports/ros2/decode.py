"""Reads a recording with rclpy's own deserialiser, and writes each message again. Argument: the .mcap file."""

from __future__ import annotations

import json
import sys
from collections import Counter
from typing import Any

from mcap.reader import make_reader
from rclpy.serialization import deserialize_message, serialize_message
from stranger import node_of, type_of


def hash_of(node: Any, kind: Any, number: int) -> str:
    """The hash under which rclpy announces a type."""
    topic = f"/hash{number}"
    out = node.create_publisher(kind, topic, 1)
    info = node.get_publishers_info_by_topic(topic)[0]
    node.destroy_publisher(out)
    found = info.topic_type_hash
    return f"RIHS0{found.version}_{bytes(found.value).hex()}"


def main() -> None:
    count: Counter[str] = Counter()
    differ: set[str] = set()
    kinds: dict[str, Any] = {}
    with open(sys.argv[1], "rb") as file:
        for schema, _, message in make_reader(file).iter_messages():
            kinds[schema.name] = kind = type_of(schema.name)
            made = deserialize_message(message.data, kind)
            count[schema.name] += 1
            if deserialize_message(serialize_message(made), kind) != made:
                differ.add(schema.name)
    node = node_of("decode")
    hashes = {name: hash_of(node, kind, number) for number, (name, kind) in enumerate(kinds.items())}
    print(json.dumps({"count": count, "same": not differ, "differ": sorted(differ), "hashes": hashes}))


main()
