"""Entry points of the ROS 2 port: `ros2:NAMESPACE?key=value`."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from ullage.ports.by_hand import Controls
    from ullage.ports.drone import Drone, DroneOptions, Takes
    from ullage.ports.protocol import Sink, Source

__all__ = ["open_controls", "open_drone", "open_sink", "open_source"]


def open_source(address: str, options: dict[str, Any]) -> Source:
    """Open frames from topics: `ros2:NAMESPACE?key=value`; simulated on a robot: `?simulate=WORLD`, `?fly=WORLD`.

    Raises:
        InputError: an option is unknown or of no use.
        MissingExtra: there is no rclpy.
    """
    from ullage.ports.cosimulation import options_of
    from ullage.ports.ros2.options import SimulateOptions, SourceOptions

    where = f"ros2:{address}"
    if "fly" in options:
        from ullage.ports.ros2.hand import TopicFlyOptions, open_flight

        return open_flight(address, options_of(TopicFlyOptions, options, where))
    if "simulate" in options or "world" in options:
        from ullage.ports.ros2.cosimulation import Ros2Radars

        return Ros2Radars(address, options_of(SimulateOptions, options, where))
    from ullage.ports.ros2.source import Ros2Source

    return Ros2Source(address, options_of(SourceOptions, options, where))


def open_controls(address: str, options: dict[str, Any]) -> Controls:
    """Open commands from topics: `ros2:NAMESPACE?key=value`.

    Raises:
        InputError: an option is unknown or of no use.
        MissingExtra: there is no rclpy.
    """
    from ullage.ports.cosimulation import options_of
    from ullage.ports.ros2.hand import ControlOptions, TopicControls
    from ullage.ports.ros2.middleware import Peer

    chosen = options_of(ControlOptions, options, f"ros2:{address}")
    return TopicControls(Peer(address, chosen), chosen)


def open_sink(address: str, options: dict[str, Any]) -> Sink:
    """Open topics to publish all items of a stream: `ros2:NAMESPACE?key=value`.

    Raises:
        InputError: an option is unknown or of no use.
        MissingExtra: there is no rclpy.
    """
    from ullage.ports.cosimulation import options_of
    from ullage.ports.ros2.options import SinkOptions
    from ullage.ports.ros2.sink import Ros2Sink

    return Ros2Sink(address, options_of(SinkOptions, options, f"ros2:{address}"))


def open_drone(address: str, options: DroneOptions, takes: Takes) -> Drone:
    """Open an external drone to command: `ros2:NAMESPACE`.

    Raises:
        InputError: the namespace is invalid.
        MissingExtra: there is no rclpy.
    """
    from ullage.ports.ros2.drone import RosDrone

    return RosDrone(address, options)
