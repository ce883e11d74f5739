"""Commands on ROS 2 topics: taken for the simulated multirotor, or given to a drone of others.

The multirotor takes velocities, set-points or a joystick. The drone gives Odometry, and takes Twist or PoseStamped.
"""

from __future__ import annotations

import time
from collections.abc import Iterator
from typing import Any

from pydantic import Field

from ullage.errors import InputError
from ullage.flight.pilot import HOVER, Pilot, Velocity
from ullage.geometry import quat_rpy, rpy_quat
from ullage.ports import schema as ros
from ullage.ports.by_hand import FlyOptions, HandFlownSource
from ullage.ports.conversions import stamp_ns
from ullage.ports.cosimulation import world_and_rig
from ullage.ports.drone import Drone, DroneOptions, state_of
from ullage.ports.intake import Log, checked_pose, warn
from ullage.ports.live import options_of
from ullage.ports.pose_events import BodyState
from ullage.ports.publisher import Message
from ullage.ports.ros2.middleware import Peer
from ullage.ports.ros2.options import NodeOptions
from ullage.world.library import WORLDS


class ControlOptions(NodeOptions):
    """Topics of the commands."""

    cmd_vel: str = Field("cmd_vel", description="topic of velocities: Twist or TwistStamped")
    pose: str = Field("command/pose", description="topic of set-points: PoseStamped in map or odom")
    joy: str = Field("joy", description="topic of a joystick: Joy; none: not listened to")
    # axes, button and scales are the defaults of teleop_twist_joy, https://docs.ros.org/en/jazzy/p/teleop_twist_joy
    joy_axes: str = Field("5,-1,-1,2", description="axes of forward, left, climb, turn; -1: none")
    joy_button: int = Field(0, ge=-1, le=63, description="button to hold while flying; -1: none")
    joy_speed_m_s: float = Field(0.5, gt=0, le=10, description="speed and climb of a joystick at its stop")
    joy_turn_rad_s: float = Field(0.5, gt=0, le=10, description="turn rate of a joystick at its stop")

    def axes(self) -> tuple[int, ...]:
        """Return the axes of the joystick.

        Raises:
            InputError: they are not four whole numbers.
        """
        words = [word.strip() for word in self.joy_axes.split(",")]
        if len(words) != 4 or not all(word.removeprefix("-").isdecimal() for word in words):
            raise InputError(f"joy_axes is {self.joy_axes!r}", where="ros2:", allowed="four axes, as 5,-1,-1,2")
        return tuple(int(word) for word in words)


class TopicFlyOptions(FlyOptions, ControlOptions):
    """Settings of `ullage run 'ros2:?fly=WORLD'`."""


class TopicControls:
    """Read commands from topics as soon as they have a publisher.

    Args:
        peer: the node.
        options: which topics.
        log: takes lines for the user; None: they become warnings.

    Raises:
        InputError: an option cannot be used.
    """

    def __init__(self, peer: Peer, options: ControlOptions, *, log: Log | None = None) -> None:
        self.counters = peer.counters
        self._peer, self._options, self._axes, self._log = peer, options, options.axes(), log or warn
        self._topics = {
            peer.resolved(name): kinds
            for name, kinds in (
                (options.cmd_vel, (ros.TWIST, ros.TWIST_STAMPED)),
                (options.pose, (ros.POSE,)),
                (options.joy, (ros.JOY,)),
            )
            if name
        }
        self._button_held = False
        self._peer.spin()

    def update(self, pilot: Pilot, now_s: float) -> None:
        """Pass the commands since the last call to the pilot."""
        self._find_topics()
        while (found := self._peer.wait(0.0)) is not None:
            topic, kind, data = found
            with self.counters.reading(topic):
                if wrong := self._take(kind, ros.from_bytes(kind, data), pilot, now_s):
                    self.counters.drop(topic, "bad", wrong)

    def close(self) -> None:
        """Leave the network."""
        self._peer.close()

    def _find_topics(self) -> None:
        """Subscribe to the topics that have a publisher now."""
        for topic, kind in self._peer.appeared(self._topics).items():
            if kind not in (kinds := self._topics[topic]):
                self._log(f"{topic} carries {kind}, which is no command (allowed: {', '.join(kinds)})")
                continue
            self._peer.receive(topic, kind, "sensor", depth=10)
            self._log(f"commands come on {topic}")

    def _take(self, kind: str, message: Any, pilot: Pilot, now_s: float) -> str:
        """Pass one message to the pilot; return the error in it, or None."""
        if kind == ros.POSE:
            return self._go_to(message, pilot)
        if kind == ros.JOY:
            velocity = self._of_joystick(message)
        else:
            twist = message.twist if kind == ros.TWIST_STAMPED else message
            velocity = Velocity(twist.linear.x, twist.linear.y, twist.linear.z, twist.angular.z)
        return "" if velocity is None or pilot.command(velocity, now_s) else "not finite"

    def _go_to(self, message: Any, pilot: Pilot) -> str:
        prefix = self._options.frame_prefix
        frame = message.header.frame_id
        if frame not in ("", "map", prefix + "odom"):
            return f"in frame {frame!r}, not map or {prefix}odom"
        at, turn = message.pose.position, message.pose.orientation
        pose = checked_pose((at.x, at.y, at.z), (turn.x, turn.y, turn.z, turn.w))
        if isinstance(pose, str):
            return pose
        pilot.go_to((at.x, at.y, at.z), float(quat_rpy(pose[1])[2]))
        return ""

    def _of_joystick(self, message: Any) -> Velocity | None:
        """Return the velocity that the sticks command; zero when the button is released, and None after that."""
        button, before = self._options.joy_button, self._button_held
        self._button_held = button < 0 or (button < len(message.buttons) and bool(message.buttons[button]))
        if not self._button_held:
            return HOVER if before else None
        values = [float(message.axes[k]) if 0 <= k < len(message.axes) else 0.0 for k in self._axes]
        v = self._options.joy_speed_m_s
        return Velocity(values[0] * v, values[1] * v, values[2] * v, values[3] * self._options.joy_turn_rad_s)


def open_controls(namespace: str, options: dict[str, Any]) -> TopicControls:
    """Open commands from topics: `ros2:NAMESPACE?key=value`.

    Raises:
        InputError: an option is unknown or of no use.
        MissingExtra: there is no rclpy.
    """
    chosen = options_of(ControlOptions, options, f"ros2:{namespace}")
    return TopicControls(Peer(namespace, chosen), chosen)


def open_flight(namespace: str, options: TopicFlyOptions, *, log: Log | None = None) -> HandFlownSource:
    """Open the simulated multirotor in a world, flown by topics: `ros2:NAMESPACE?fly=WORLD`.

    Raises:
        InputError: there is no such world, rig or start, or an option is of no use.
        MissingExtra: there is no rclpy.
    """
    where = f"ros2:{namespace}"
    scene, rig = world_and_rig(options.fly, options, where=where)
    start = options.place() or (tuple(WORLDS[options.fly].start) if options.fly in WORLDS else None)
    if start is None:
        raise InputError("no start", where=where, allowed="start=X,Y,Z or start=X,Y,Z,YAW in metres and degrees")
    controls = TopicControls(Peer(namespace, options), options, log=log)
    try:
        return HandFlownSource(scene, rig, options, controls, start=start, log=log, frame_prefix=options.frame_prefix)
    except BaseException:
        controls.close()
        raise


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
