"""Reads a recording with rclpy's own deserialiser, and writes each message again. Argument: the .mcap file."""

from __future__ import annotations

import importlib
import json
import sys
from collections import Counter
from typing import Any

import rclpy
from mcap.reader import make_reader
from rclpy.serialization import deserialize_message, serialize_message


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
            package, _, name = schema.name.split("/")
            kinds[schema.name] = kind = getattr(importlib.import_module(f"{package}.msg"), name)
            made = deserialize_message(message.data, kind)
            count[schema.name] += 1
            if deserialize_message(serialize_message(made), kind) != made:
                differ.add(schema.name)
    rclpy.init()
    node = rclpy.create_node("decode")
    hashes = {name: hash_of(node, kind, number) for number, (name, kind) in enumerate(kinds.items())}
    print(json.dumps({"count": count, "same": not differ, "differ": sorted(differ), "hashes": hashes}))
    node.destroy_node()
    rclpy.shutdown()


main()
