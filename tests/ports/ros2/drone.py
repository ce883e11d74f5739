"""A drone that knows nothing of ullage: takes cmd_vel, or set-points on command/pose, and publishes odom at 50 Hz.

It follows with a lag of 0.2 s and keeps its last command. Ends with its input; prints what came, as JSON.
Arguments: namespace.
"""

from __future__ import annotations

import json
import math
import sys
import time

import rclpy
from geometry_msgs.msg import PoseStamped, Twist
from nav_msgs.msg import Odometry
from stranger import input_ended, node_of

STEP_S, LAG_S = 0.02, 0.2


def main() -> None:
    node = node_of("foreign_drone", namespace=sys.argv[1])
    at, v, yaw, turn = [0.0, 0.0, 0.5], [0.0, 0.0, 0.0], 0.3, 0.0
    twist, goal, counts = Twist(), None, {"twist": 0, "pose": 0}

    def take_twist(message: Twist) -> None:
        nonlocal twist
        twist = message
        counts["twist"] += 1

    def take_pose(message: PoseStamped) -> None:
        nonlocal goal
        goal = message.pose
        counts["pose"] += 1
        counts["frame"] = message.header.frame_id

    node.create_subscription(Twist, "cmd_vel", take_twist, 10)
    node.create_subscription(PoseStamped, "command/pose", take_pose, 10)
    odom = node.create_publisher(Odometry, "odom", 10)
    over = input_ended()
    print("ready", flush=True)
    due = time.monotonic()
    while not over.is_set():
        rclpy.spin_once(node, timeout_sec=max(due - time.monotonic(), 0.0))
        if time.monotonic() < due:
            continue
        due += STEP_S
        if goal is not None:
            place = (goal.position.x, goal.position.y, goal.position.z)
            wanted = [(place[k] - at[k]) / 0.5 for k in range(3)]
        else:
            ahead, left, up = twist.linear.x, twist.linear.y, twist.linear.z
            wanted = [ahead * math.cos(yaw) - left * math.sin(yaw), ahead * math.sin(yaw) + left * math.cos(yaw), up]
        v = [v[k] + (wanted[k] - v[k]) * STEP_S / LAG_S for k in range(3)]
        at = [at[k] + v[k] * STEP_S for k in range(3)]
        turn = twist.angular.z
        yaw += turn * STEP_S
        out = Odometry(child_frame_id="base_link")
        out.header.frame_id = "odom"
        out.header.stamp = node.get_clock().now().to_msg()
        p, q, lin = out.pose.pose.position, out.pose.pose.orientation, out.twist.twist.linear
        p.x, p.y, p.z = at
        q.z, q.w = math.sin(yaw / 2), math.cos(yaw / 2)
        lin.x, lin.y = v[0] * math.cos(yaw) + v[1] * math.sin(yaw), v[1] * math.cos(yaw) - v[0] * math.sin(yaw)
        lin.z, out.twist.twist.angular.z = v[2], turn
        odom.publish(out)
    last = [twist.linear.x, twist.linear.y, twist.linear.z, twist.angular.z]
    print(json.dumps({"counts": counts, "last": last, "place": at}), flush=True)


main()
