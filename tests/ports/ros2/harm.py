"""A faulty robot: frames at 50 Hz, and now and then a damaged one; then a burst, and 50 Hz again.

Its transforms are no numbers at first. Ends when its input does, and prints how many frames it sent.
"""

from __future__ import annotations

import json
import time
from array import array
from itertools import count

from geometry_msgs.msg import TransformStamped
from rclpy.qos import QoSProfile, ReliabilityPolicy
from stranger import input_ended, node_of
from tf2_msgs.msg import TFMessage
from ullage_msgs.msg import RadarFrame

FAULTS = {60: "quaternion", 70: "stamp", 80: "samples", 90: "late"}
STEADY, BURST = 200, 3000


def frame(index: int, now: float) -> RadarFrame:
    out = RadarFrame(sensor="front", index=index, kind=0, has_believed=False, range_start=0.0, range_step=0.05)
    out.header.frame_id = "front"
    out.samples = array("f", [0.1] * 376)
    fault = FAULTS.get(index, "")
    now += {"stamp": 1000.0, "late": -0.05}.get(fault, 0.0)
    out.header.stamp.sec, out.header.stamp.nanosec = int(now), int(now % 1 * 1e9)
    if fault == "quaternion":
        out.has_believed = True
        out.believed.orientation.w = 0.3
    if fault == "samples":
        out.samples = array("f", [0.1] * 375)
    return out


def main() -> None:
    node = node_of("harm")
    frames = node.create_publisher(
        RadarFrame, "/radar/front/frame", QoSProfile(depth=5, reliability=ReliabilityPolicy.BEST_EFFORT)
    )
    tf = node.create_publisher(TFMessage, "/tf", 100)
    while not frames.get_subscription_count():
        time.sleep(0.1)
    time.sleep(1.0)
    over = input_ended()
    now = time.time()
    for index in count():
        if index >= STEADY + BURST and over.is_set():
            break
        steady = not STEADY <= index < STEADY + BURST
        now = time.time() if index < STEADY else now + (0.02 if steady else 0.002)
        moved = TransformStamped(child_frame_id="base_link")
        moved.header.frame_id = "map"
        moved.header.stamp.sec, moved.header.stamp.nanosec = int(now), int(now % 1 * 1e9)
        moved.transform.translation.x = float("nan") if index < 20 else 0.001 * index
        moved.transform.rotation.w = 1.0
        tf.publish(TFMessage(transforms=[moved]))
        frames.publish(frame(index, now))
        if steady:
            time.sleep(0.02)
    print(json.dumps(index))
    time.sleep(1.0)


main()
