"""Entry points of `gazebo:WORLD?model=NAME&key=value`."""

from ullage.ports.gazebo.drone import open_drone
from ullage.ports.gazebo.sink import open_transport_sink as open_sink
from ullage.ports.gazebo.transport_source import open_source

__all__ = ["open_drone", "open_sink", "open_source"]
