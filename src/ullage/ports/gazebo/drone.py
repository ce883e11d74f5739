"""A drone in Gazebo that its own controller flies: Odometry in, Twist out."""

from __future__ import annotations

import time
from collections.abc import Iterator

from ullage.errors import InputError
from ullage.flight.pilot import Velocity
from ullage.ports.drone import Drone, DroneOptions, state_of
from ullage.ports.gazebo.messages import gz
from ullage.ports.gazebo.peer import Received, TopicOffered
from ullage.ports.gazebo.transport import TransportPeer
from ullage.ports.pose_events import BodyState, stamp_ns


class GazeboDrone(Drone):
    """Commands a model by its velocity, as gz-sim's MulticopterVelocityControl takes it.

    Args:
        model: its name.
        options: topics; usual are `/model/NAME/odometry` and `/model/NAME/cmd_vel`.

    Raises:
        InputError: there is no model's name, or a topic is none.
        MissingExtra: pyzmq or protobuf is not installed.
    """

    takes = ("velocity",)
    refusal = "Gazebo's multicopters take no poses"

    def __init__(self, model: str, options: DroneOptions) -> None:
        if not model:
            raise InputError("no model", where="gazebo:", allowed="gazebo:NAME of the model to fly")
        self._peer = TransportPeer()
        super().__init__(options.odom or f"/model/{model}/odometry", self._peer.counters)
        self._cmd_vel = options.cmd_vel or f"/model/{model}/cmd_vel"
        self._offered = False
        try:
            self._peer.subscribe(self._odom)
        except BaseException:
            self._peer.close()
            raise

    def _arrived(self) -> Iterator[bytes]:
        while (event := self._peer.wait(0.0)) is not None:
            if isinstance(event, TopicOffered | Received) and event.topic == self._odom:
                self._offer(event.kind)
                if isinstance(event, Received):
                    yield event.data

    def _offer(self, kind: str) -> None:
        """Offer the commands in the package of the odometry: gz.msgs, or ignition.msgs up to Fortress."""
        if not self._offered:
            self._offered = True
            self._peer.advertise(self._cmd_vel, f"{kind.rpartition('.')[0]}.Twist")

    def _state(self, data: bytes) -> BodyState | str:
        message = gz().Odometry.FromString(data)
        return state_of(stamp_ns(message.header.stamp), message.pose, message.twist)

    def steer(self, velocity: Velocity) -> None:
        """Command a velocity in the level frame of the heading."""
        if not self._offered:
            return
        forward, left, up, turn = velocity
        twist = gz().Twist(linear=gz().Vector3d(x=forward, y=left, z=up), angular=gz().Vector3d(z=turn))
        self._peer.publish(self._cmd_vel, twist)

    def close(self) -> None:
        """Leave the network."""
        time.sleep(0.05)  # the last command leaves first
        self._peer.close()
