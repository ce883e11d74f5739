"""The topics of either Gazebo: poses and scans of a model come in, radar frames go out.

`RadarTopics` publishes whole frames, profiles, the nearest range, and points. `Feed` reads what a Gazebo tells of one
model; `transport_source` and `classic_source` read its messages. `GazeboSink` takes frames from any source.
`GazeboDrone` commands a model that its own controller flies: Odometry in, Twist out.
"""

from __future__ import annotations

import math
import time
from abc import abstractmethod
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import replace
from typing import Any, Literal

import numpy as np
from pydantic import Field

from ullage.arrays import Floats
from ullage.data import Frames
from ullage.errors import InputError
from ullage.flight.pilot import Velocity
from ullage.flow import Sink
from ullage.ports.cosimulation import CosimulationOptions
from ullage.ports.drone import Drone, DroneOptions, state_of
from ullage.ports.gazebo.classic import ClassicPeer, master_of
from ullage.ports.gazebo.messages import classic, gz
from ullage.ports.gazebo.peer import Peer, Received, TopicOffered
from ullage.ports.gazebo.transport import TransportPeer
from ullage.ports.live import options_of
from ullage.ports.pose_events import BodyState, EventFeed, ModelPose, Notice, pose_of, stamp_ns
from ullage.ports.protocol import Item
from ullage.ports.publisher import RateLimiter
from ullage.processing.detect import detect
from ullage.specs import Spec

FLOAT32, R_FLOAT32 = 6, 13
"""A field's type in a packed cloud of Transport, and the pixel format of one float32 a pixel in Classic."""
FIELDS = ("x", "y", "z", "intensity")
WIDEST_DEG = 150.0
"""Of the cone that gzclient draws."""
KINDS = {
    "frame": ("Float_V", "ImageStamped"), "profile": ("Float_V", "ImageStamped"), "range": ("Double", "SonarStamped"),
    "points": ("PointCloudPacked", "PointCloud"),
}  # fmt: skip
"""Types of the topics in Transport and in Classic."""
CLASSIC = "gazebo.msgs"


class RadarTopics:
    """Publishes frames under `ROOT/radar/SENSOR/`.

    | topic | Transport | Classic |
    |---|---|---|
    | `frame` | Float_V: every sample, re and im by turns at baseband | ImageStamped: the same as one row of float32 |
    | `profile` | Float_V: magnitudes | ImageStamped: the same |
    | `range` | Double: the nearest echo [m], infinite where none | SonarStamped: the same, range_max where none |
    | `points` | PointCloudPacked along the boresight | PointCloud: the nearest echo on the boresight |

    Args:
        peer: the connection to Gazebo.
        root: `/model/MODEL`, or in Classic `/gazebo/WORLD/MODEL`.
        package: `gz.msgs`, `ignition.msgs` up to Fortress, or `gazebo.msgs` in Classic.
    """

    def __init__(self, peer: Peer, root: str, package: str) -> None:
        self.peer, self.package, self._root = peer, package, root
        self._known: set[str] = set()

    def write(self, frames: Frames, offset_ns: int = 0) -> None:
        """Publish every frame; their time minus the offset is Gazebo's time."""
        root = f"{self._root}/radar/{frames.sensor}"
        if frames.sensor not in self._known:
            self._known.add(frames.sensor)
            for name, kinds in KINDS.items():
                self.peer.advertise(f"{root}/{name}", f"{self.package}.{kinds[self.package == CLASSIC]}")
        encode = _classic if self.package == CLASSIC else _transport
        for i, range_m in enumerate(nearest(frames).tolist()):
            sec, nsec = divmod(int(frames.t_ns[i]) - offset_ns, 10**9)
            for name, message in zip(KINDS, encode(frames, i, (sec, nsec), range_m), strict=True):
                self.peer.publish(f"{root}/{name}", message)


def _values(frames: Frames, i: int) -> tuple[Any, Any]:
    """Return the samples and their magnitudes as float32."""
    return frames.samples[i].view(np.float32), np.abs(frames.samples[i]).astype(np.float32)


def _transport(frames: Frames, i: int, stamp: tuple[int, int], range_m: float) -> tuple[Any, ...]:
    samples, magnitude = _values(frames, i)
    about = {
        "frame_id": frames.sensor, "range_start_m": f"{frames.range_m[0]:.9g}",
        "bin_m": f"{(frames.range_m[-1] - frames.range_m[0]) / (len(frames.range_m) - 1):.12g}",
        "unit": frames.unit, "samples": "baseband" if np.iscomplexobj(frames.samples) else "real",
    }  # fmt: skip
    data = [gz().Map(key=key, value=[value]) for key, value in about.items()]
    head = gz().Header(stamp=gz().Time(sec=stamp[0], nsec=stamp[1]), data=data)
    points = np.zeros((len(frames.range_m), len(FIELDS)), "<f4")
    points[:, 0], points[:, 3] = frames.range_m, magnitude
    fields = [gz().Field(name=name, offset=4 * k, datatype=FLOAT32, count=1) for k, name in enumerate(FIELDS)]
    step = 4 * len(FIELDS)
    cloud = gz().PointCloudPacked(
        header=head, field=fields, height=1, width=len(points), point_step=step, row_step=step * len(points),
        data=points.tobytes(), is_dense=True,
    )  # fmt: skip
    rows = (gz().Float_V(header=head, data=values) for values in (samples, magnitude))
    return *rows, gz().Double(header=head, data=range_m), cloud


def _classic(frames: Frames, i: int, stamp: tuple[int, int], range_m: float) -> tuple[Any, ...]:
    message = classic()
    time = message.Time(sec=stamp[0], nsec=stamp[1])

    def row(values: Any) -> Any:
        data = np.ascontiguousarray(values, "<f4").tobytes()
        image = message.Image(width=len(values), height=1, pixel_format=R_FLOAT32, step=len(data), data=data)
        return message.ImageStamped(time=time, image=image)

    low, high = float(frames.range_m[0]), float(frames.range_m[-1])
    half = math.radians(min(frames.spec.thesis.fov_deg, WIDEST_DEG) / 2)
    at, turn = (0.0, 0.0, 0.0), (0.0, 0.0, 0.0, 1.0)
    if frames.poses is not None:
        at, turn = tuple(frames.poses.position[i]), tuple(frames.poses.quat_xyzw[i])
    pose = message.Pose(
        position=message.Vector3d(**dict(zip("xyz", at, strict=True))),
        orientation=message.Quaternion(**dict(zip("xyzw", turn, strict=True))),
    )
    sonar = message.Sonar(
        frame=frames.sensor, world_pose=pose, range_min=max(low, 0.0), range_max=high, radius=high * math.tan(half),
        range=min(range_m, high), geometry="cone",
    )  # fmt: skip
    hit = [message.Vector3d(x=range_m, y=0.0, z=0.0)] if math.isfinite(range_m) else []
    rows = map(row, _values(frames, i))
    return *rows, message.SonarStamped(time=time, sonar=sonar), message.PointCloud(points=hit)


def nearest(frames: Frames) -> Floats:
    """Return the range of the first detection of each frame (n) [m]; infinite if there is none."""
    out = np.full(len(frames), np.inf)
    found = detect(replace(frames, poses=None, truth=None))
    np.minimum.at(out, found.frame, found.range_m)
    return out


class Feed(EventFeed):
    """Poses of one model and of other models from a Gazebo, or scans of its rays, and notices about the server.

    Args:
        peer: the connection to Gazebo.
        options: name the model and its sensors.
        world: Gazebo's name of the world; empty: the first that is found.
        others: names of the world's other models.
        patience_s: after how long a silence that is reported [s].
    """

    server: str
    """What the user calls it."""

    def __init__(
        self, peer: Peer, options: CosimulationOptions, world: str, others: frozenset[str], *, patience_s: float
    ) -> None:
        super().__init__(peer, patience_s=patience_s)
        self._peer, self.world, self.newest_ns = peer, world, 0
        self._model, self._rays = options.model, options.rays
        self._others = frozenset() if options.rays else others - {options.model}  # rays meet them without our help
        self._known = self._paused = False  # the model was there; the server is paused
        self._scans: dict[str, str] = {}  # name of the ray sensor by its topic
        self._topics: RadarTopics | None = None

    def give(self, chunk: dict[str, Frames], offset_ns: int) -> None:
        """Publish frames."""
        if self._topics is None:
            self._topics = self._radar_topics()
        for frames in chunk.values():
            self._topics.write(frames, offset_ns)

    @abstractmethod
    def _radar_topics(self) -> RadarTopics:
        """Return the topics of the model's radars."""

    def _seen(self, t_ns: int, pose: Any) -> ModelPose:
        self.newest_ns, self._known = t_ns, True
        return ModelPose(t_ns, *pose_of(pose))

    def _new_models(self, names: Iterable[str]) -> frozenset[str]:
        return frozenset(names) - self._others - {self._model}

    def _pause(self, stats: Any) -> Notice | None:
        """Report that the server is paused or goes on."""
        if stats.paused == self._paused:
            return None
        self._paused = bool(stats.paused)
        return Notice(f"{self.server} {'is paused' if self._paused else 'goes on'}")

    def _model_gone(self) -> Notice:
        return Notice(f"the model {self._model!r} has gone from {self.server}; waiting for it to come back")

    def _server_gone(self) -> Notice:
        return Notice(f"{self.server} has gone; waiting for it to come back (Ctrl-C ends)")


class SimulatorSinkOptions(Spec):
    """Options of a sink that gives frames to a simulator."""

    model: str = Field("ullage", min_length=1, description="the model that is said to carry the radars")
    pace: float = Field(1.0, ge=0, le=1000, description="times real time; 0: as fast as can be")
    host: str = Field("127.0.0.1", description="address of the interface to use")


class TransportSinkOptions(SimulatorSinkOptions):
    """Options of `--to gazebo:`."""

    messages: Literal["gz", "ignition"] = Field("gz", description="ignition for Fortress and before")
    clock: str = Field("/clock", description="topic of the frames' clock; empty: none")
    partition: str | None = Field(None, description="none: GZ_PARTITION, or this host and user")


class ClassicSinkOptions(SimulatorSinkOptions):
    """Options of `--to gazebo-classic:`."""

    gazebo_world: str = Field("default", min_length=1, description="topics are /gazebo/WORLD/MODEL/radar/SENSOR/...")


class GazeboSink(Sink):
    """Publish frames at the rate of their own clock, in order of time; ignore everything else.

    Args:
        topics: take the frames; their peer is closed with the sink.
        pace: times real time; 0: as fast as can be.
        clock: topic of the frames' clock, which Transport alone takes; empty: none.
    """

    def __init__(self, topics: RadarTopics, pace: float, *, clock: str = "") -> None:
        self._limiter = RateLimiter(pace)
        self._topics, self._peer, self._clock = topics, topics.peer, clock
        if clock:
            self._peer.advertise(clock, f"{topics.package}.Clock")

    def write(self, item: Item) -> None:
        """Take frames."""
        parts = [item] if isinstance(item, Frames) else list(item.values()) if isinstance(item, Mapping) else []
        moments = [(int(part.t_ns[k]), n, k) for n, part in enumerate(parts) for k in range(len(part))]
        for t_ns, n, k in sorted(moments):
            self._limiter.wait(t_ns)
            if self._clock:
                self._peer.publish(self._clock, gz().Clock(sim=gz().Time(sec=t_ns // 10**9, nsec=t_ns % 10**9)))
            self._topics.write(parts[n][k : k + 1])

    def close(self) -> None:
        """Leave the network."""
        self._peer.close()


def open_transport_sink(address: str, options: dict[str, Any]) -> GazeboSink:
    """Open Gazebo's topics for frames from any source: `gazebo:?model=NAME&key=value`.

    Raises:
        InputError: an option is not valid.
        MissingExtra: pyzmq or protobuf is not installed.
    """
    chosen = options_of(TransportSinkOptions, options, f"gazebo:{address}")
    peer = TransportPeer(chosen.host, chosen.partition)
    topics = RadarTopics(peer, f"/model/{chosen.model}", f"{chosen.messages}.msgs")
    return GazeboSink(topics, chosen.pace, clock=chosen.clock)


def open_classic_sink(address: str, options: dict[str, Any]) -> GazeboSink:
    """Open gzserver's topics for frames from any source: `gazebo-classic:HOST:PORT?model=NAME&key=value`.

    Raises:
        InputError: an option or the address is not valid.
        MissingExtra: protobuf is not installed.
    """
    chosen = options_of(ClassicSinkOptions, options, f"gazebo-classic:{address}")
    peer = ClassicPeer(master_of(address), chosen.host)
    return GazeboSink(RadarTopics(peer, f"/gazebo/{chosen.gazebo_world}/{chosen.model}", CLASSIC), chosen.pace)


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
