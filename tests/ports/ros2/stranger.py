"""What the programs of this folder share: a real rclpy node that knows nothing of ullage, and runs until it is told."""

from __future__ import annotations

import atexit
import importlib
import sys
import threading
import time
from collections.abc import Callable
from typing import Any

import rclpy


def node_of(name: str, **options: Any) -> Any:
    """A node that leaves the network as the program ends."""
    rclpy.init()
    node = rclpy.create_node(name, **options)
    atexit.register(rclpy.shutdown)
    atexit.register(node.destroy_node)
    return node


def input_ended() -> threading.Event:
    """Set once the program's input ends."""
    over = threading.Event()
    threading.Thread(target=lambda: (sys.stdin.read(), over.set()), daemon=True).start()
    return over


def type_of(kind: str) -> Any:
    """The class of `package/msg/Name`."""
    package, _, name = kind.split("/")
    return getattr(importlib.import_module(f"{package}.msg"), name)


def spin(node: Any, over: Callable[[], bool], each: Callable[[], None] = lambda: None, most_s: float = 40) -> bool:
    """Spin until something holds, doing `each` twenty times a second; whether it came to hold."""
    end, due = time.monotonic() + most_s, 0.0
    while not over() and time.monotonic() < end:
        if time.monotonic() >= due:
            due = time.monotonic() + 0.05
            each()
        rclpy.spin_once(node, timeout_sec=0.01)
    return over()


def repeat(wishes: list[tuple[Any, Any]], times: int) -> None:
    """Publish each message on its publisher, ten times a second."""
    for _ in range(times):
        for publisher, message in wishes:
            publisher.publish(message)
        time.sleep(0.1)
