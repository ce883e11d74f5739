"""A real rclpy node with a joystick, then a stamped velocity: how fast the vehicle flew, as JSON."""

from __future__ import annotations

import json
from collections.abc import Callable

from geometry_msgs.msg import TwistStamped
from nav_msgs.msg import Odometry
from rclpy.qos import qos_profile_sensor_data
from sensor_msgs.msg import Joy
from stranger import node_of, spin


def main() -> None:
    node = node_of("stick")
    speed: list[tuple[float, float]] = []
    node.create_subscription(
        Odometry, "odom", lambda m: speed.append((m.twist.twist.linear.x, m.twist.twist.linear.y)),
        qos_profile_sensor_data,
    )  # fmt: skip
    sticks = node.create_publisher(Joy, "joy", 10)

    def push(held: int) -> Callable[[], None]:
        axes = [0.0] * 6
        axes[5] = 1.0  # as teleop_twist_joy: forward
        return lambda: sticks.publish(Joy(axes=axes, buttons=[held]))

    spin(node, lambda: bool(speed))
    print("ready", flush=True)
    heard = len(speed)
    spin(node, lambda: len(speed) > heard + 40, push(0))
    seen = {"rests while no button is held": abs(speed[-1][0]) < 0.02}
    seen["held"] = spin(node, lambda: speed[-1][0] > 0.4, push(1))
    seen["let go"] = spin(node, lambda: abs(speed[-1][0]) < 0.02, push(0))
    stamped = node.create_publisher(TwistStamped, "cmd_vel", 10)
    twist = TwistStamped()
    twist.twist.linear.y = 0.3
    seen["stamped"] = spin(node, lambda: speed[-1][1] > 0.2, lambda: stamped.publish(twist))
    print(json.dumps(seen))


main()
