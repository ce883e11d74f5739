"""Read bags of other programs: ROS 1's `.bag` and rosbag2's sqlite3 by `rosbags`, and MCAP without RadarFrame."""

from __future__ import annotations

import warnings
from collections.abc import Callable, Iterator
from functools import partial
from pathlib import Path
from typing import Any

from ullage.data import Frames, Trajectory, gathered
from ullage.errors import DamageWarning, InputError, UllageWarning
from ullage.grids import OccupancyMap
from ullage.ports import conversions, encode
from ullage.ports import messages as ros
from ullage.ports.protocol import one_or_all
from ullage.ports.replay import McapSource
from ullage.ports.ros2.incoming import Incoming
from ullage.ports.ros2.options import SourceOptions

BATCH = 256
"""Messages between two looks at which frames have their poses."""
POSES = (ros.TRANSFORMS, ros.ODOMETRY)
OLD_NAMES = {"tf/msg/tfMessage": ros.TRANSFORMS}


class RosbagSource:
    """Source of frames, profiles or ranges in a bag, with poses from its transforms or odometry.

    Args:
        path: `.bag`, `.db3`, or rosbag2's folder.
        topics: of frames, profiles or ranges, with commas; none: RadarFrame, else */profile, else Range.
        odom: topic of Odometry to take the body's pose from; none: the first, where there is no /tf.
        radar: preset of radars whose topics do not say what they are.
        world: frame of reference that the map stands in.
        body: frame of reference of the vehicle.

    Raises:
        InputError: the file is not a bag or is damaged, or there is no such preset.
    """

    def __init__(
        self, path: Path, *, topics: str = "", odom: str = "", radar: str = "x4m05", world: str = "map",
        body: str = "base_link",
    ) -> None:  # fmt: skip
        self.path = path.parent if path.suffix == ".db3" and (path.parent / "metadata.yaml").exists() else path
        self._kinds = self._listed_kinds()
        self._radars = self._wanted(topics)
        odometry = [name for name, kind in self._kinds.items() if kind == ros.ODOMETRY]
        placed = ros.TRANSFORMS in self._kinds.values()
        self._odom = odom or ("" if placed or not odometry else odometry[0])
        if odom and odom not in odometry:
            raise InputError(f"no Odometry on {odom}", where=path, allowed=", ".join(odometry) or "none is in the bag")
        poses: Any = "auto" if placed or self._odom else "message"
        self._options = SourceOptions(radar=radar, map=world, body=body, poses=poses, patience_s=60)
        self._sensors: tuple[str, ...] | None = None

    def _listed_kinds(self) -> dict[str, str]:
        """Return the topics of the bag with their types."""
        with self._opened() as reader:
            return {c.topic: OLD_NAMES.get(c.msgtype, c.msgtype) for c in reader.connections}

    def _wanted(self, topics: str) -> list[str]:
        """Return the topics of radars, by the option or by type."""
        kinds = (ros.FRAME, ros.CLOUD, encode.RANGE)
        if named := [name for name in topics.split(",") if name]:
            for name in named:
                if self._kinds.get(name) not in kinds:
                    raise InputError(f"no frames on {name}", where=self.path, allowed=self._listed())
            return named
        for kind in kinds:
            found = [name for name, of in self._kinds.items() if of == kind]
            found = [name for name in found if kind != ros.CLOUD or name.endswith("/profile")]
            if found:
                return found
        raise InputError("no radar frames, profiles or ranges in it", where=self.path, allowed=self._listed())

    def _listed(self) -> str:
        return ", ".join(f"{name} ({kind})" for name, kind in self._kinds.items()) or "the bag is empty"

    def _opened(self) -> Any:
        from rosbags.highlevel import AnyReader, AnyReaderError

        try:
            reader = AnyReader([self.path], default_typestore=ros.typestore())
            reader.open()
        except (AnyReaderError, OSError, ValueError) as error:
            raise InputError(f"not a bag: {error}", where=self.path) from None
        return _Closing(reader)

    @property
    def sensors(self) -> tuple[str, ...]:
        """Names of the radars."""
        if self._sensors is None:
            self._sensors = tuple(dict.fromkeys(name for chunk in self.stream() for name in chunk))
        return self._sensors

    def frames(self, sensor: str | None = None) -> Frames | dict[str, Frames]:
        """Return all frames of one sensor, or of several as a dict by name.

        Raises:
            InputError: the bag gives no frames, or there is no such sensor.
        """
        whole = gathered(self.stream(4096))
        if not whole:
            raise InputError("no frames could be made of it", where=self.path)
        return one_or_all(whole, sensor)

    def stream(self, chunk: int = 64) -> Iterator[dict[str, Frames]]:
        """Give the frames in order of time, at most `chunk` of each sensor at once."""
        into = Incoming(self._options, partial(warnings.warn, category=UllageWarning, stacklevel=4))
        takers = self._takers(into)
        for number, (topic, data) in enumerate(self._messages(takers)):
            into.take(topic, takers[topic], data)
            if number % BATCH == BATCH - 1 and (found := into.ready(chunk)):
                yield found
        while found := into.ready(chunk):
            yield found
        into.finish()
        damaged = into.counters.dropped("bad") > 0
        for line in into.counters.lines():
            warnings.warn(f"{self.path}: {line}", DamageWarning if damaged else UllageWarning, stacklevel=2)

    def _takers(self, into: Incoming) -> dict[str, Callable[[bytes], None]]:
        """Return the handler of each topic's messages."""
        takes = {ros.FRAME: into.take_frame, ros.CLOUD: into.take_profile, encode.RANGE: into.take_range}
        out: dict[str, Callable[[bytes], None]] = {}
        for topic, kind in self._kinds.items():
            if topic in self._radars:
                out[topic] = partial(takes[kind], topic)
            elif kind == ros.SETTINGS:
                out[topic] = partial(into.take_settings, topic)
            elif kind == ros.TRANSFORMS:
                out[topic] = partial(into.take_transforms, fixed=topic.endswith("static"))
            elif topic == self._odom:
                out[topic] = into.take_odometry
        return out

    def _messages(self, topics: Any) -> Iterator[tuple[str, bytes]]:
        """Give the messages of these topics as CDR, in order of their arrival."""
        with self._opened() as reader:
            chosen = [c for c in reader.connections if c.topic in topics]
            for connection, _, raw in reader.messages(connections=chosen):
                if reader.is2:
                    yield connection.topic, bytes(raw)
                    continue
                kind = OLD_NAMES.get(connection.msgtype, connection.msgtype)
                message = renewed(reader.deserialize(raw, connection.msgtype), kind)
                yield connection.topic, ros.to_bytes(kind, message)

    def trajectory(self) -> Trajectory | None:
        """Return the body's path if the bag has odometry."""
        messages = [data for topic, data in self._messages([self._odom]) if topic] if self._odom else []
        return conversions.odometry_path(messages) if messages else None

    def map(self) -> OccupancyMap | None:
        """Return the last map of the bag, if any."""
        grids = [topic for topic, kind in self._kinds.items() if kind == ros.GRID]
        last = None
        for _, data in self._messages(grids):
            last = data
        return None if last is None else conversions.grid_of(last)


class McapBagSource(RosbagSource):
    """The same source from an MCAP file, complete or truncated."""

    def _listed_kinds(self) -> dict[str, str]:
        return McapSource(self.path).topics()

    def _messages(self, topics: Any) -> Iterator[tuple[str, bytes]]:
        chosen = set(topics)
        return ((topic, data) for topic, _, data in McapSource(self.path).messages() if topic in chosen)


def open_mcap(
    path: Path, *, topics: str = "", odom: str = "", radar: str = "x4m05", world: str = "map", body: str = "base_link"
) -> McapSource | RosbagSource:
    """Open a recording of ullage, or a bag of profiles or ranges with poses from its transforms or odometry.

    Args:
        path: of the MCAP file.
        topics: of frames, profiles or ranges, with commas; none: RadarFrame, else */profile, else Range.
        odom: topic of Odometry to take the body's pose from; none: the first, where there is no /tf.
        radar: preset of radars whose topics do not say what they are.
        world: frame of reference that the map stands in.
        body: frame of reference of the vehicle.

    Raises:
        InputError: the file is not a recording, or there is no such topic or preset.
    """
    source = McapSource(path)
    kinds = {} if topics or odom or source.has_frames() else source.topics()
    if (topics or odom) or any(kind == encode.RANGE or name.endswith("/profile") for name, kind in kinds.items()):
        return McapBagSource(path, topics=topics, odom=odom, radar=radar, world=world, body=body)
    return source


def renewed(message: Any, kind: str) -> Any:
    """Convert a ROS 1 message to the ROS 2 message of this type; fields that ROS 1 lacks are zero."""
    from rosbags.interfaces import Nodetype

    fields: Any = ros.typestore().fielddefs[kind][1]
    values = []
    for name, (form, about) in fields:
        value: Any = getattr(message, name, 0)
        if form == Nodetype.NAME:
            value = renewed(value, about)
        elif form != Nodetype.BASE and about[0][0] == Nodetype.NAME:
            value = [renewed(item, about[0][1]) for item in value]
        values.append(value)
    return ros.make(kind, *values)


class _Closing:
    """Context that closes an open reader at its end."""

    def __init__(self, reader: Any) -> None:
        self._reader = reader

    def __enter__(self) -> Any:
        return self._reader

    def __exit__(self, *error: object) -> None:
        self._reader.close()
