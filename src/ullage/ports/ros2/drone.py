"""Command an external drone over ROS 2 topics: Odometry in, Twist or PoseStamped out."""

from __future__ import annotations

import time
from collections.abc import Iterator

from ullage.flight.pilot import Velocity
from ullage.geometry import rpy_quat
from ullage.ports import schema as ros
from ullage.ports.conversions import stamp_ns
from ullage.ports.drone import Drone, DroneOptions, state_of
from ullage.ports.pose_events import BodyState
from ullage.ports.publisher import Message
from ullage.ports.ros2.middleware import Peer
from ullage.ports.ros2.options import NodeOptions


class RosDrone(Drone):
    """External drone that is commanded by topics under its namespace.

    Args:
        namespace: of its topics.
        options: names of the topics; defaults are `odom`, `cmd_vel` and `command/pose`.

    Raises:
        InputError: the namespace is invalid.
        MissingExtra: there is no rclpy.
    """

    def __init__(self, namespace: str, options: DroneOptions) -> None:
        self._peer = Peer(namespace, NodeOptions(node="ullage_interpreter"))
        super().__init__(options.odom or "odom", self._peer.counters)
        self._cmd_vel, self._setpoint = options.cmd_vel or "cmd_vel", options.setpoint or "command/pose"
        self._frame = "odom"
        self._peer.receive(self._odom, ros.ODOMETRY, "sensor", depth=50)
        self._peer.spin()

    def _arrived(self) -> Iterator[bytes]:
        while (found := self._peer.wait(0.0)) is not None:
            yield found.data

    def _state(self, data: bytes) -> BodyState | str:
        message = ros.from_bytes(ros.ODOMETRY, data)
        self._frame = message.header.frame_id or "odom"
        return state_of(stamp_ns(message.header), message.pose.pose, message.twist.twist)

    def steer(self, velocity: Velocity) -> None:
        """Command a velocity in the level frame of the heading."""
        fields = {"linear": velocity[:3], "angular": (0.0, 0.0, velocity.turn_rad_s)}
        self._send(self._cmd_vel, ros.TWIST, ros.encoded(ros.TWIST, fields))

    def go_to(self, position: tuple[float, float, float], heading_rad: float) -> None:
        """Command a set-point in the world of the drone's odometry."""
        pose = (position, tuple(rpy_quat(0.0, 0.0, heading_rad)))
        data = ros.encoded(ros.POSE, {"pose": pose}, t_ns=time.time_ns(), frame_id=self._frame)
        self._send(self._setpoint, ros.POSE, data)

    def _send(self, topic: str, kind: str, data: bytes) -> None:
        self._peer.send(Message(time.time_ns(), topic, kind, "stream", data))

    def close(self) -> None:
        """Leave the network."""
        self._peer.settle(0.5)
        self._peer.close()
