"""Measures the time of a stream as a real rclpy node that knows nothing of ullage: /clock and each radar's frames.

Ends when its input does. Prints one JSON object. Arguments: name of each radar.
"""

from __future__ import annotations

import json
import sys
import time
from typing import Any

import numpy as np
import rclpy
from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy
from rosgraph_msgs.msg import Clock
from sensor_msgs.msg import Range
from stranger import input_ended, node_of
from tf2_msgs.msg import TFMessage
from ullage_msgs.msg import RadarFrame


def seconds(stamp: Any) -> float:
    return float(stamp.sec + 1e-9 * stamp.nanosec)


def main() -> None:
    node = node_of("timing")
    deep = QoSProfile(depth=1000)
    loose = QoSProfile(depth=1000, reliability=ReliabilityPolicy.BEST_EFFORT)
    kept = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)
    seen: dict[str, list[tuple[float, float]]] = {"clock": []}

    def take(name: str, stamp: Any) -> None:
        seen.setdefault(name, []).append((time.monotonic(), seconds(stamp)))

    node.create_subscription(Clock, "/clock", lambda m: take("clock", m.clock), deep)
    node.create_subscription(TFMessage, "/tf", lambda m: take("tf", m.transforms[0].header.stamp), deep)
    node.create_subscription(TFMessage, "/tf_static", lambda m: None, kept)
    for name in sys.argv[1:]:
        node.create_subscription(RadarFrame, f"/radar/{name}/frame", lambda m, n=name: take(n, m.header.stamp), loose)
        node.create_subscription(
            Range, f"/radar/{name}/range", lambda m, n=name: take(f"{n} range", m.header.stamp), loose
        )
    over = input_ended()
    print("ready", flush=True)
    while not over.is_set():
        rclpy.spin_once(node, timeout_sec=0.1)
    out: dict[str, Any] = {}
    for name, pairs in seen.items():
        wall, stamp = np.array(pairs).reshape(-1, 2).T
        steps = np.diff(stamp)
        out[name] = {
            "count": len(stamp),
            "falls": int((steps < 0).sum()),
            "deepest_s": float(-steps.min(initial=0.0)),
            "wall_s": float(np.ptp(wall)) if len(wall) else 0.0,
            "stream_s": float(np.ptp(stamp)) if len(wall) else 0.0,
            "slope": float(np.polyfit(wall, stamp, 1)[0]) if len(wall) > 2 else None,
            "hz": float((len(stamp) - 1) / np.ptp(stamp)) if len(wall) > 2 else None,
        }
    print(json.dumps(out))


main()
