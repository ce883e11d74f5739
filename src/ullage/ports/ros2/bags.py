"""Read bags of other programs: ROS 1's `.bag` and rosbag2's sqlite3 by `rosbags`, and MCAP without RadarFrame.

A bag may hold radars (`RosbagSource`), or the track of a radar that recorded elsewhere (`read_track`).
"""

from __future__ import annotations

import warnings
from collections.abc import Callable, Iterable, Iterator
from contextlib import closing
from functools import partial, reduce
from pathlib import Path
from typing import Any

import numpy as np
from pydantic import Field

from ullage.data import Frames, Imu, Trajectory
from ullage.errors import DamageWarning, InputError, NotRecorded, UllageWarning
from ullage.geometry import matrix_quat
from ullage.grids import OccupancyMap
from ullage.ports import conversions
from ullage.ports import schema as ros
from ullage.ports.conversions import Placement, stamp_ns
from ullage.ports.live import options_of
from ullage.ports.protocol import Recording
from ullage.ports.replay import McapSource
from ullage.ports.ros2.incoming import Incoming
from ullage.ports.ros2.options import SourceOptions
from ullage.ports.vehicle_logs import Pose, imu_of_rows, track_of_fixes, track_of_poses
from ullage.specs import Spec

BATCH = 256
"""Messages between two looks at which frames have their poses."""
TRACKS = (*conversions.PLACING, ros.FIX)
OLD_NAMES = {"tf/msg/tfMessage": ros.TRANSFORMS}


class Bag:
    """Topics and messages of a bag.

    Args:
        path: `.bag`, `.db3`, or rosbag2's folder.

    Raises:
        InputError: the file is not a bag or is damaged.
    """

    def __init__(self, path: Path) -> None:
        self.path = path.parent if path.suffix == ".db3" and (path.parent / "metadata.yaml").exists() else path
        self.kinds = self._listed_kinds()

    @staticmethod
    def of(path: Path) -> Bag:
        """Return the bag of a file, by its suffix."""
        return McapBag(path) if path.suffix.lower() == ".mcap" else Bag(path)

    def listed(self) -> str:
        """Return every topic with its type, for messages to the user."""
        return ", ".join(f"{name} ({kind})" for name, kind in self.kinds.items()) or "the bag is empty"

    def messages(self, topics: Any) -> Iterator[tuple[str, bytes]]:
        """Give the messages of these topics as CDR, in order of their arrival."""
        with self._opened() as reader:
            chosen = [c for c in reader.connections if c.topic in topics]
            if not chosen:
                return  # the library takes no connections for all of them
            for connection, _, raw in reader.messages(connections=chosen):
                if reader.is2:
                    yield connection.topic, bytes(raw)
                    continue
                kind = OLD_NAMES.get(connection.msgtype, connection.msgtype)
                message = renewed(reader.deserialize(raw, connection.msgtype), kind)
                yield connection.topic, ros.to_bytes(kind, message)

    def _listed_kinds(self) -> dict[str, str]:
        with self._opened() as reader:
            return {c.topic: OLD_NAMES.get(c.msgtype, c.msgtype) for c in reader.connections}

    def _opened(self) -> Any:
        from rosbags.highlevel import AnyReader, AnyReaderError

        try:
            reader = AnyReader([self.path], default_typestore=ros.typestore())
            reader.open()
        except (AnyReaderError, OSError, ValueError) as error:
            raise InputError(f"not a bag: {error}", where=self.path) from None
        return closing(reader)


class McapBag(Bag):
    """The same of an MCAP file, complete or truncated."""

    def _listed_kinds(self) -> dict[str, str]:
        return McapSource(self.path).topics()

    def messages(self, topics: Any) -> Iterator[tuple[str, bytes]]:
        """Give the messages of these topics, in order of their arrival."""
        chosen = set(topics)
        return ((topic, data) for topic, _, data in McapSource(self.path).messages() if topic in chosen)


class BagOptions(Spec):
    """Options of a bag of other programs."""

    topics: str = Field("", description="frames, profiles or ranges, with commas; none: found by type")
    odom: str = Field("", description="Odometry to take the body's pose from; none: the first, where there is no /tf")
    radar: str = Field("x4m05", description="preset of radars whose topics do not say what they are")
    world: str = Field("map", description="frame of reference that the map stands in")
    body: str = Field("base_link", description="frame of reference of the vehicle")


class RosbagSource(Recording):
    """Source of frames, profiles or ranges in a bag, with poses from its transforms or odometry.

    Without `topics` it takes RadarFrame, else */profile, else Range.

    Args:
        path: `.bag`, `.db3`, or rosbag2's folder.
        **options: as `BagOptions` lists them.

    Raises:
        InputError: the file is not a bag or is damaged, or there is no such option or preset.
    """

    def __init__(self, path: Path, **options: Any) -> None:
        super().__init__(path)
        self.imu_files = (self.path,)
        chosen = options_of(BagOptions, options, str(path))
        self._bag = Bag.of(path)
        self._kinds = self._bag.kinds
        self._radars = self._wanted(chosen.topics)
        odometry = [name for name, kind in self._kinds.items() if kind == ros.ODOMETRY]
        placed, odom = ros.TRANSFORMS in self._kinds.values(), chosen.odom
        self._odom = odom or ("" if placed or not odometry else odometry[0])
        if odom and odom not in odometry:
            raise InputError(f"no Odometry on {odom}", where=path, allowed=", ".join(odometry) or "none is in the bag")
        poses: Any = "auto" if placed or self._odom else "message"
        self._options = SourceOptions(
            radar=chosen.radar, map=chosen.world, body=chosen.body, poses=poses, patience_s=60
        )

    def _wanted(self, topics: str) -> list[str]:
        """Return the topics of radars, by the option or by type."""
        kinds = (ros.FRAME, ros.CLOUD, ros.RANGE)
        if named := [name for name in topics.split(",") if name]:
            for name in named:
                if self._kinds.get(name) not in kinds:
                    raise InputError(f"no frames on {name}", where=self.path, allowed=self._bag.listed())
            return named
        for kind in kinds:
            found = [name for name, of in self._kinds.items() if of == kind]
            found = [name for name in found if kind != ros.CLOUD or name.endswith("/profile")]
            if found:
                return found
        raise InputError("no radar frames, profiles or ranges in it", where=self.path, allowed=self._bag.listed())

    def stream(self, chunk: int = 64) -> Iterator[dict[str, Frames]]:
        """Give the frames in order of time, at most `chunk` of each sensor at once."""
        into = Incoming(self._options, partial(warnings.warn, category=UllageWarning, stacklevel=4))
        takers = self._takers(into)
        for number, (topic, data) in enumerate(self._bag.messages(takers)):
            into.take(topic, takers[topic], data)
            if number % BATCH == BATCH - 1 and (found := into.ready(chunk)):
                yield found
        while found := into.ready(chunk):
            yield found
        into.finish()
        self._warn_of_dropped(into.counters)

    def _takers(self, into: Incoming) -> dict[str, Callable[[bytes], None]]:
        """Return the handler of each topic's messages."""
        kinds = {topic: self._kinds[topic] for topic in self._radars}
        kinds |= {topic: kind for topic, kind in self._kinds.items() if kind in (ros.SETTINGS, ros.TRANSFORMS)}
        if self._odom:
            kinds[self._odom] = ros.ODOMETRY
        return {topic: into.taker(topic, kind, fixed=topic.endswith("static")) for topic, kind in kinds.items()}

    def trajectory(self) -> Trajectory | None:
        """Return the body's path if the bag has odometry."""
        messages = [data for topic, data in self._bag.messages([self._odom]) if topic] if self._odom else []
        return conversions.odometry_path(messages) if messages else None

    def map(self) -> OccupancyMap | None:
        """Return the last map of the bag, if any."""
        grids = {topic for topic, kind in self._kinds.items() if kind == ros.GRID}
        last = None
        for _, data in self._bag.messages(grids):
            last = data
        return None if last is None else conversions.grid_of(last)


def open_mcap(path: Path, **options: Any) -> McapSource | RosbagSource:
    """Open a recording of ullage, or a bag of profiles or ranges with poses from its transforms or odometry.

    Args:
        path: of the MCAP file.
        **options: as `BagOptions` lists them.

    Raises:
        InputError: the file is not a recording, or there is no such topic, option or preset.
    """
    source, chosen = McapSource(path), options_of(BagOptions, options, str(path))
    named = bool(chosen.topics or chosen.odom)
    kinds = {} if named or source.has_frames() else source.topics()
    if named or any(kind == ros.RANGE or name.endswith("/profile") for name, kind in kinds.items()):
        return RosbagSource(path, **options)
    return source


def read_track(path: Path, *, topic: str = "", body: str = "base_link", datum: str = "") -> Trajectory:
    """Read the track of a body from one topic of a bag.

    Args:
        path: of the bag.
        topic: of Odometry, PoseStamped, PoseWithCovarianceStamped, NavSatFix, or transforms; none: the only one there.
        body: frame of reference of the vehicle, for transforms.
        datum: origin of fixes, `latitude,longitude[,height]`; none: the first fix, with a warning.

    Raises:
        InputError: it is no bag, there is no such topic or there are several, or its poses cannot be used.
    """
    bag = Bag.of(path)
    placed = [name for name, kind in bag.kinds.items() if kind in TRACKS]
    moving = [name for name in placed if not (bag.kinds[name] == ros.TRANSFORMS and name.endswith("static"))]
    if (topic and topic not in placed) or (not topic and len(moving) != 1):
        what = f"no track on {topic}" if topic else f"{len(moving)} topics hold a track: say topic="
        raise InputError(what, where=path, allowed=", ".join(moving) or bag.listed())
    topic = topic or moving[0]
    kind = bag.kinds[topic]
    wanted = [name for name in placed if bag.kinds[name] == ros.TRANSFORMS] if kind == ros.TRANSFORMS else [topic]
    sound = partial(_sound, kind, messages=(data for _, data in bag.messages(wanted)), path=path)
    if kind == ros.FIX:
        messages = sound(decode=ros.from_bytes)
        rows = [(stamp_ns(m.header), m.latitude, m.longitude, m.altitude) for m in messages if m.status.status >= 0]
        return track_of_fixes(rows, datum, path)
    placed_at = (found for several in sound(decode=conversions.placements_in) for found in several)
    if kind == ros.TRANSFORMS:
        return along_transforms(placed_at, body, path)
    return track_of_poses([(one.t_ns, one.position, one.quat_xyzw) for one in placed_at], path)


def imu_of_bag(path: Path, *, topic: str = "") -> Imu:
    """Read an inertial unit from one topic of a bag.

    Args:
        path: of the bag.
        topic: of sensor_msgs/Imu; none: the only one there.

    Raises:
        InputError: it is no bag, there is no such topic or there are several, or its readings cannot be used.
    """
    bag = Bag.of(path)
    there = [name for name, kind in bag.kinds.items() if kind == ros.IMU]
    if (topic and topic not in there) or (not topic and len(there) != 1):
        what = f"no Imu on {topic}" if topic else f"{len(there)} topics hold an inertial unit: say topic="
        raise (InputError if there else NotRecorded)(what, where=path, allowed=", ".join(there) or bag.listed())
    messages = (data for _, data in bag.messages([topic or there[0]]))
    found = list(_sound(ros.IMU, messages=messages, decode=ros.from_bytes, path=path))
    parts = [(one.angular_velocity, one.linear_acceleration) for one in found]
    readings = np.array([[v.x, v.y, v.z, f.x, f.y, f.z] for v, f in parts], float).reshape(-1, 6)
    return imu_of_rows([stamp_ns(one.header) for one in found], readings, path)


def _sound(kind: str, *, messages: Iterable[bytes], decode: Callable[[str, bytes], Any], path: Path) -> Iterator[Any]:
    """Decode messages; those that cannot be read are left out, with a warning."""
    bad = 0
    for data in messages:
        try:
            yield decode(kind, data)
        except Exception:  # a stranger's bytes: the library's complaints are of every kind
            bad += 1
    if bad:
        warnings.warn(f"{path}: {bad} messages of {kind} cannot be read; left out", DamageWarning, stacklevel=3)


def along_transforms(placed: Iterable[Placement], body: str, path: Path) -> Trajectory:
    """Return the track of a frame of reference in the root of its tree.

    Raises:
        InputError: nothing places it, or nothing moves.
    """
    edges: dict[str, tuple[str, list[Pose]]] = {}
    for one in placed:
        parent, rows = edges.setdefault(one.child.lstrip("/"), (one.parent.lstrip("/"), []))
        if parent == one.parent.lstrip("/"):
            rows.append((one.t_ns, one.position, one.quat_xyzw))
    chain: list[Trajectory] = []
    name, seen = body, set[str]()
    while name in edges and name not in seen:
        seen.add(name)
        name, rows = edges[name]
        stands = all(row[1:] == rows[0][1:] for row in rows)
        chain.append(track_of_poses(rows[:1] if stands else rows, path))
    if not chain:
        raise InputError(f"no transform places {body}", where=path, allowed=", ".join(edges) or "none is in the bag")
    moving = [one for one in chain if len(one) > 1]
    if not moving:
        raise InputError(f"no transform above {body} moves", where=path, allowed="a track")
    low, high = max(one.t_ns[0] for one in moving), min(one.t_ns[-1] for one in moving)
    t_ns = max(moving, key=len).t_ns
    t_ns = t_ns[(t_ns >= low) & (t_ns <= high)]
    if not len(t_ns):
        raise InputError(f"the transforms above {body} are of different times", where=path)
    out = reduce(lambda inner, outer: outer @ inner, (one.at(t_ns).world_from_body for one in chain))
    return Trajectory(t_ns, out[:, :3, 3], matrix_quat(out[:, :3, :3]))


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
