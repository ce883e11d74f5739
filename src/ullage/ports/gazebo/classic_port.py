"""Entry points of `gazebo-classic:HOST:PORT?model=NAME&key=value`."""

from ullage.ports.gazebo.classic_source import open_source
from ullage.ports.gazebo.sink import open_classic_sink as open_sink

__all__ = ["open_sink", "open_source"]
