"""A robot that knows nothing of ullage: publishes transforms, odometry and the clock until its input ends.

Arguments: the transforms as parent>child, joined to odom by /tf_static; odom and clock for those topics.
"""

from __future__ import annotations

import sys
import time

from geometry_msgs.msg import TransformStamped
from nav_msgs.msg import Odometry
from rclpy.qos import DurabilityPolicy, QoSProfile
from rosgraph_msgs.msg import Clock
from stranger import input_ended, node_of
from tf2_msgs.msg import TFMessage


def placed(pair: str) -> TransformStamped:
    out = TransformStamped()
    out.header.frame_id, _, out.child_frame_id = pair.partition(">")
    out.transform.translation.x = 7.0
    out.transform.rotation.w = 1.0
    return out


def main() -> None:
    node = node_of("robot_state_publisher")
    pairs = [placed(word) for word in sys.argv[1:] if ">" in word]
    moving = [pair for pair in pairs if pair.child_frame_id.endswith("base_link")]
    fixed = [pair for pair in pairs if pair not in moving]
    over = input_ended()
    publish = []
    if fixed:
        kept = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)
        node.create_publisher(TFMessage, "/tf_static", kept).publish(TFMessage(transforms=fixed))
    if moving:
        tf = node.create_publisher(TFMessage, "/tf", 100)
        publish.append(lambda: tf.publish(TFMessage(transforms=moving)))
    if "odom" in sys.argv:
        odom = node.create_publisher(Odometry, "/odom", 10)
        publish.append(lambda: odom.publish(Odometry(child_frame_id="robot")))
    if "clock" in sys.argv:
        clock = node.create_publisher(Clock, "/clock", 10)
        publish.append(lambda: clock.publish(Clock()))
    print("ready", flush=True)
    while not over.is_set():
        for each in publish:
            each()
        time.sleep(0.05)


main()
