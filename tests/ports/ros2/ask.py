"""Asks a node for its parameters by its service, as `ros2 param list` does. Arguments: node."""

from __future__ import annotations

import json
import sys

import rclpy
from rcl_interfaces.srv import ListParameters
from stranger import node_of


def main() -> None:
    node = node_of("ask")
    client = node.create_client(ListParameters, f"{sys.argv[1]}/list_parameters")
    assert client.wait_for_service(timeout_sec=60.0)
    future = client.call_async(ListParameters.Request())
    rclpy.spin_until_future_complete(node, future, timeout_sec=10.0)
    answer = future.result()
    print(json.dumps(None if answer is None else list(answer.result.names)))


main()
