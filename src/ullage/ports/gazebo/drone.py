"""A drone in Gazebo that its own controller flies: Odometry in, Twist out."""

from __future__ import annotations

import time
from typing import Any

from ullage.errors import InputError
from ullage.flight.pilot import Velocity
from ullage.ports.drone import DroneOptions, DroneState, state_of
from ullage.ports.gazebo.peer import Peer, Received, TopicOffered
from ullage.ports.gazebo.wire import gz
from ullage.ports.publisher import is_present


class GazeboDrone:
    """Commands a model by its velocity, as gz-sim's MulticopterVelocityControl takes it.

    Args:
        model: its name.
        options: topics; usual are `/model/NAME/odometry` and `/model/NAME/cmd_vel`.

    Raises:
        InputError: there is no model's name, or a topic is none.
        MissingExtra: pyzmq or protobuf is not installed.
    """

    def __init__(self, model: str, options: DroneOptions) -> None:
        if not model:
            raise InputError("no model", where="gazebo:", allowed="gazebo:NAME of the model to fly")
        self._odom = options.odom or f"/model/{model}/odometry"
        self._cmd_vel = options.cmd_vel or f"/model/{model}/cmd_vel"
        self._peer = Peer()
        self.counters = self._peer.counters
        self._last_ns = 0
        self._offered = False
        try:
            self._peer.subscribe(self._odom)
        except BaseException:
            self._peer.close()
            raise

    def states(self) -> list[DroneState]:
        """The states since the last call, in order of time."""
        out = []
        while (event := self._peer.wait(0.0)) is not None:
            if isinstance(event, TopicOffered | Received) and event.topic == self._odom:
                self._offer(event.kind)
            if not isinstance(event, Received) or event.topic != self._odom:
                continue
            self.counters.receive(self._odom)
            found = self._state(event.data)
            if isinstance(found, str):
                self.counters.drop(self._odom, "bad", found)
            elif found.t_ns <= self._last_ns:
                self.counters.drop(self._odom, "late")
            else:
                self._last_ns = found.t_ns
                out.append(found)
        return out

    def _offer(self, kind: str) -> None:
        """Offer the commands in the package of the odometry: gz.msgs, or ignition.msgs up to Fortress."""
        if not self._offered:
            self._offered = True
            self._peer.advertise(self._cmd_vel, f"{kind.rpartition('.')[0]}.Twist")

    def _state(self, data: bytes) -> DroneState | str:
        message: Any = gz().Odometry()
        try:
            message.ParseFromString(data)
        except Exception as error:  # protobuf raises kinds of its own, by implementation
            return f"cannot be read: {type(error).__name__}"
        stamp, at, turn = message.header.stamp, message.pose.position, message.pose.orientation
        linear, angular = message.twist.linear, message.twist.angular
        t_ns = stamp.sec * 10**9 + stamp.nsec
        return state_of(
            t_ns if is_present(t_ns) else time.time_ns(),  # Gazebo's clock is none of IMC's
            (at.x, at.y, at.z), (turn.x, turn.y, turn.z, turn.w),
            (linear.x, linear.y, linear.z), (angular.x, angular.y, angular.z),
        )  # fmt: skip

    def steer(self, velocity: Velocity) -> None:
        """Command a velocity in the level frame of the heading."""
        if not self._offered:
            return
        forward, left, up, turn = velocity
        twist = gz().Twist(linear=gz().Vector3d(x=forward, y=left, z=up), angular=gz().Vector3d(z=turn))
        self._peer.publish(self._cmd_vel, twist)

    def go_to(self, position: tuple[float, float, float], heading_rad: float) -> None:
        """Refuse: Gazebo's multicopters take no set-points.

        Raises:
            InputError: always.
        """
        raise InputError("Gazebo's multicopters take no poses", where=self._cmd_vel, allowed="takes=velocity")

    def close(self) -> None:
        """Leave the network."""
        time.sleep(0.05)  # the last command leaves first
        self._peer.close()
