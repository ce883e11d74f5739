"""A robot that knows nothing of ullage: tells its odometry at 50 Hz until its input ends; along x, from 2 m on."""

from __future__ import annotations

import time

from nav_msgs.msg import Odometry
from stranger import input_ended, node_of


def main() -> None:
    node = node_of("robot")
    out = node.create_publisher(Odometry, "/robot/odom", 10)
    over = input_ended()
    print("ready", flush=True)
    start = time.time()
    while not over.is_set():
        now = time.time()
        message = Odometry()
        message.header.stamp.sec, message.header.stamp.nanosec = int(now), int(now % 1 * 1e9)
        message.header.frame_id, message.child_frame_id = "map", "base_link"
        message.pose.pose.position.x = 2.0 + 0.02 * (now - start)
        message.pose.pose.position.z = 1.1
        message.pose.pose.orientation.w = 1.0
        out.publish(message)
        time.sleep(0.02)


main()
