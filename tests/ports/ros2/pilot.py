"""A real rclpy pilot that knows only Hector's topics: velocities, silence, a set-point; what it saw as JSON."""

from __future__ import annotations

import json
import math
import time
from typing import Any

import rclpy
from geometry_msgs.msg import PoseStamped, Twist
from nav_msgs.msg import Odometry
from rclpy.qos import qos_profile_sensor_data
from sensor_msgs.msg import Imu, Range
from stranger import node_of, spin


def main() -> None:
    node = node_of("pilot")
    last: dict[str, Any] = {}
    counts = dict.fromkeys(("odom", "raw_imu", "sonar_height"), 0)

    def take(topic: str, message: Any) -> None:
        counts[topic] += 1
        last[topic] = message

    for topic, kind in (("odom", Odometry), ("raw_imu", Imu), ("sonar_height", Range)):
        node.create_subscription(kind, topic, lambda m, t=topic: take(t, m), qos_profile_sensor_data)
    speeds, goals = node.create_publisher(Twist, "cmd_vel", 10), node.create_publisher(PoseStamped, "command/pose", 10)

    def place() -> list[float]:
        at = last["odom"].pose.pose.position
        return [at.x, at.y, at.z]

    began = time.monotonic()
    while "odom" not in last and time.monotonic() - began < 60:
        rclpy.spin_once(node, timeout_sec=0.1)
    print("ready", flush=True)
    seen = {"start": place()}
    twist = Twist()
    twist.linear.x = 0.4
    spin(node, lambda: place()[0] > seen["start"][0] + 0.8, lambda: speeds.publish(twist))
    seen["moved"] = place()
    spin(node, lambda: abs(last["odom"].twist.twist.linear.x) < 0.002)
    seen["stopped"] = place()
    counts["odom"] = 0
    spin(node, lambda: counts["odom"] > 20)
    seen["still"] = place()
    goal = PoseStamped()
    goal.header.frame_id = "map"
    goal.pose.position.x, goal.pose.position.y, goal.pose.position.z = -2.0, -1.2, 1.5
    goal.pose.orientation.w = 1.0
    spin(node, lambda: math.dist(place(), (-2.0, -1.2, 1.5)) < 0.02, lambda: goals.publish(goal))
    seen["arrived"] = place()
    counts["sonar_height"] = 0
    spin(node, lambda: counts["sonar_height"] > 10)
    seen["imu"] = [last["raw_imu"].linear_acceleration.z]
    seen["sonar"] = [last["sonar_height"].range]
    print(json.dumps({"seen": seen, "counts": counts}))


main()
