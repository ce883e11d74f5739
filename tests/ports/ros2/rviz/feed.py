"""Publishes what tap.py passes on as ROS 1 topics, for Debian's RViz. Never in one process with ROS 2."""

from __future__ import annotations

import importlib
import pickle
import sys
from typing import Any

import numpy as np
import rospy

from ullage.ports import schema as ros

LATCHED = {"/map", "/world", "/path", "/map/plane", "/map/cubes", "/tf_static", "/image"}
OLD = {"map_msgs/msg/OccupancyGridUpdate": "map_msgs"}


def old(kind: str) -> Any:
    package, _, name = kind.split("/")
    return getattr(importlib.import_module(f"{package}.msg"), name)


def turned(value: Any, made: Any) -> Any:
    """A ROS 2 message as the ROS 1 message of the same name; what ROS 1 does not know is left out."""
    for name, kind in zip(made.__slots__, made._slot_types, strict=True):
        if not hasattr(value, name):
            continue
        here = getattr(value, name)
        if kind in ("time", "duration"):
            setattr(made, name, (rospy.Time if kind == "time" else rospy.Duration)(here.sec, here.nanosec))
        elif isinstance(here, np.ndarray):
            setattr(made, name, here.tobytes() if here.dtype == np.uint8 else here.tolist())
        elif isinstance(here, list):
            kind_of = old(kind[:-2].replace("/", "/msg/"))
            setattr(made, name, [turned(item, kind_of()) for item in here])
        elif hasattr(here, "__msgtype__"):
            setattr(made, name, turned(here, getattr(made, name)))
        else:
            setattr(made, name, here)
    return made


def main() -> None:
    rospy.init_node("feed", disable_signals=True)
    publishers: dict[str, Any] = {}
    while True:
        try:
            topic, kind, data = pickle.load(sys.stdin.buffer)
        except EOFError:
            return
        made = turned(ros.from_bytes(kind, data), old(kind)())
        if topic not in publishers:
            publishers[topic] = rospy.Publisher(topic, type(made), queue_size=100, latch=topic in LATCHED)
        publishers[topic].publish(made)


main()
