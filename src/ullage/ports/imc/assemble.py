"""Assemble radar frames from the messages of a bus or a log: exact frames, else echo-sounder profiles."""

from __future__ import annotations

import math
import time
from collections import deque
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from ullage.arrays import Floats
from ullage.data import Frames, Trajectory, joined
from ullage.geometry import C0, matrix_quat, quat_matrix, rpy_quat
from ullage.ports import conversions
from ullage.ports import schema as ros
from ullage.ports.imc.codec import Packet, readable
from ullage.ports.imc.frames import carried, mount_of, profile_of
from ullage.ports.intake import Clock, Counters, Log, Once, Place, PoseQueue, Stamped, Stream
from ullage.ports.ned import FLIP, SWAP, Geodetic
from ullage.ports.pose_events import BodyState, path_along
from ullage.ports.replay import sound_frames
from ullage.specs import MountSpec, RadarSpec

MOST_WAITING = 4096  # messages of one sensor that wait for a pose or for their settings
MOST_PARTS = 256  # radars, and names of parts of systems; further ones are counted as bad
FARTHEST_M = 1e6  # from the reference of a state
LATEST_S = 9e9
Part = tuple[int, int]
"""A system and a part of it."""


def wrong_state(values: Mapping[str, float]) -> str:
    """Return why an EstimatedState or SimulatedState is not valid; empty if it is valid."""
    if not all(map(math.isfinite, values.values())):
        return next(f"{name} is not finite" for name, value in values.items() if not math.isfinite(value))
    if abs(values["lat"]) > math.pi / 2 or abs(values["lon"]) > 2 * math.pi:
        return "latitude or longitude is out of range"
    if max(abs(values[name]) for name in ("height", "x", "y", "z")) > FARTHEST_M:
        return f"more than {FARTHEST_M / 1000:g} km from its reference"
    return ""


def pose_of(state: Mapping[str, Any], t_ns: int, origin: Geodetic) -> BodyState:
    """Return the pose of an EstimatedState or SimulatedState in the world with this origin.

    IMC gives a place as a reference on the ellipsoid and an offset in the plane that touches it there. References
    differ between systems and change in flight, so offsets are carried over exactly, through earth-centred coordinates.
    """
    here = Geodetic(state["lat"], state["lon"], state["height"])
    offset = np.array([state["x"], state["y"], state["z"]], float)
    if here == origin:
        turn, place = np.eye(3), offset
    else:
        turn = origin.earth_from_ned.T @ here.earth_from_ned
        place = origin.earth_from_ned.T @ (here.earth_centred - origin.earth_centred) + turn @ offset
    ned_from_frd = quat_matrix(rpy_quat(state["phi"], state["theta"], state["psi"]))
    if "vx" in state:
        velocity = turn @ np.array([state["vx"], state["vy"], state["vz"]], float)
    else:
        velocity = turn @ ned_from_frd @ np.array([state["u"], state["v"], state["w"]], float)
    return BodyState(
        t_ns,
        SWAP @ place,
        matrix_quat(SWAP @ turn @ ned_from_frd @ FLIP),
        SWAP @ velocity,
        FLIP @ np.array([state["p"], state["q"], state["r"]], float),
    )


@dataclass(slots=True)
class Track:
    """The poses of one vehicle, in order of time, across steps of its clock.

    Args:
        counters: count invalid states and report steps of the clock.
        state: name of the message with the poses.
        origin: origin of the world; None: the reference of the first state.
        vehicle: name or number of the vehicle; empty: the first that sends a pose.
        keep: greatest number of poses; None: all.
    """

    counters: Counters = field(default_factory=Counters)
    state: str = "EstimatedState"
    origin: Geodetic | None = None
    vehicle: str = ""
    keep: int | None = 4096
    poses: deque[BodyState] = field(default_factory=deque)
    followed: int | None = None
    started_ns: int = 0  # begin of the present track
    offset_ns: int = 0  # time of the poses minus the vehicle's clock
    _stream: Stream[Packet] | None = None

    def take(self, packet: Packet) -> list[Stamped[BodyState]]:
        """Return the poses that a message completes: none, its own, or a waiting one and its own."""
        if packet.name == "Announce" and self.vehicle and packet["sys_name"] == self.vehicle:
            self.followed = packet.src
        if packet.name != self.state:
            return []
        named = not self.vehicle or self.vehicle in (str(packet.src), f"{packet.src:#06x}")
        if packet.src != self.followed and not (self.followed is None and named):
            return []
        topic = f"{self.state} of {packet.src:#06x}"
        self.counters.receive(topic)
        wrong = wrong_state(packet.message.values)
        if not 0 <= packet.t_s < LATEST_S:
            wrong = wrong or f"its time is {packet.t_s:g} s"
        if wrong:
            self.counters.drop(topic, "bad", wrong)
            return []
        if self._stream is None or self.followed != packet.src:
            self.followed, self._stream = packet.src, Clock(self.counters).stream(topic)
        return [self._keep(one) for one in self._stream.take(round(packet.t_s * 1e9), packet)]

    def _keep(self, found: Stamped[Packet]) -> Stamped[BodyState]:
        values = found.item.message.values
        if self.origin is None:
            self.origin = Geodetic(values["lat"], values["lon"], values["height"])
        pose = pose_of(values, found.t_ns, self.origin)
        if found.starts:
            self.started_ns, self.offset_ns = found.t_ns, found.t_ns - found.stamp_ns
        self.poses.append(pose)
        if self.keep is not None and len(self.poses) > self.keep:
            self.poses.popleft()
        return Stamped(pose, *found[1:])

    def place(self, stamp_ns: int) -> Place[int]:
        """Convert a time of the vehicle's clock to the clock of the poses, once poses before and after it are known."""
        if not self.poses:
            return Place("wait", missing=f"no {self.state} yet")
        t_ns = stamp_ns + self.offset_ns
        if t_ns > self.poses[-1].t_ns:
            return Place("wait", missing=f"no {self.state} later than it")
        if t_ns < max(self.started_ns, self.poses[0].t_ns):
            return Place("never", missing=f"no {self.state} before it")
        return Place("known", t_ns)

    def finish(self) -> None:
        """End the stream of states."""
        if self._stream is not None:
            self._stream.finish()

    def path(self) -> Trajectory | None:
        """Return the path of the kept poses."""
        return path_along(self.poses) if self.poses else None


@dataclass(slots=True)
class _Sensor:
    """Waiting data of one part of a system."""

    stream: Stream[bytes]  # exact frames, on their own clock
    profiles: PoseQueue[tuple[int, Floats, Floats]]  # stamp, ranges, amplitudes
    settings: dict[str, Any] = field(default_factory=dict)
    exact_frames: list[Stamped[bytes]] = field(default_factory=list)
    axis: Floats | None = None
    exact: bool = False
    name: str = ""
    mount: MountSpec = field(default_factory=MountSpec)
    last_ns: int = -1


class FrameAssembler:
    """Collect messages and return the frames that they make up.

    Args:
        track: the vehicle's poses, for profiles.
        log: takes one line for each radar with profiles only; None: the log of the track's counters.
    """

    def __init__(self, track: Track, log: Log | None = None) -> None:
        self._track, self._counters = track, track.counters
        self._once = Once(log or track.counters.log)
        self._labels: dict[Part, str] = {}  # by EntityInfo and EntityList
        self._sensors: dict[Part, _Sensor] = {}
        self._clocks: dict[int, Clock] = {}  # clocks of exact frames, by system

    def take(self, packet: Packet) -> bool:
        """Store the radar data of a message; return whether it is a frame."""
        part = (packet.src, packet.src_ent)
        if packet.name == "EntityInfo":
            self._name((packet.src, packet["id"]), packet["label"])
        elif packet.name == "EntityList":
            self._learn(packet)
        elif packet.name == "DevDataBinary":
            self._exact(part, packet["value"])
        elif packet.name == "Distance" and packet["location"]:
            self._mount(part, packet)
        elif packet.name == "SonarData":
            self._profile(part, packet)
        return packet.name in ("DevDataBinary", "SonarData")

    def give(self, *, final: bool = False) -> dict[str, Frames]:
        """Return the complete frames by sensor; `final` drops frames whose poses will not come."""
        out: dict[str, Frames] = {}
        for part, sensor in self._sensors.items():
            found = self._exact_frames(sensor) if sensor.exact else self._profiles_with_poses(part, sensor)
            if final:
                sensor.profiles.clear()
                sensor.stream.finish()
            if found is not None and len(found):
                sensor.last_ns = int(found.t_ns[-1])
                out[found.sensor] = found
        return out

    def _of(self, part: Part) -> _Sensor | None:
        """Return the data of a part, or None if there are too many parts."""
        if part not in self._sensors:
            if len(self._sensors) >= MOST_PARTS:
                self._counters.drop("radars", "bad", f"more than {MOST_PARTS} of them")
                return None
            clock = self._clocks.setdefault(part[0], Clock(self._counters))
            topic = f"{self.label(part)} of {part[0]:#06x}"
            self._sensors[part] = _Sensor(clock.stream(topic), PoseQueue(self._counters, topic, most=MOST_WAITING))
        return self._sensors[part]

    def _name(self, part: Part, label: str) -> None:
        if part in self._labels or len(self._labels) < MOST_PARTS:
            self._labels[part] = readable(label)

    def _learn(self, packet: Packet) -> None:
        for pair in packet["list"].split(";", 256)[:256]:
            label, sign, number = pair.partition("=")
            if sign and number.isdecimal() and len(number) <= 3 and int(number) < 256:
                self._name((packet.src, int(number)), label)

    def _exact(self, part: Part, value: bytes) -> None:
        found = carried(value)
        if found is None:
            return
        sensor = self._of(part)
        if sensor is None:
            return
        kind, data = found
        self._counters.receive(sensor.stream.topic)
        with self._counters.reading(sensor.stream.topic):
            if kind == ros.SETTINGS:
                sensor.settings, sensor.name = conversions.settings_of(data), conversions.text_in(data, 1)
            elif conversions.text_in(data, 1) != sensor.name:
                self._counters.drop(sensor.stream.topic, "lost", "frames came before their settings")
            else:
                sensor.exact_frames += sensor.stream.take(conversions.time_in(data), data)
            sensor.exact = True
        over = len(sensor.exact_frames) - MOST_WAITING
        self._counters.drop(sensor.stream.topic, "lost", f"more than {MOST_WAITING} frames wait", count=over)
        del sensor.exact_frames[:-MOST_WAITING]

    def _exact_frames(self, sensor: _Sensor) -> Frames | None:
        if "spec" not in sensor.settings or not sensor.exact_frames:
            return None
        waiting, sensor.exact_frames = sensor.exact_frames, []
        parts = sound_frames(sensor.name, sensor.settings, waiting, self._counters, topic=sensor.stream.topic)
        posed = [made for made in parts if made.poses is not None]
        if posed:
            lacking = sum(len(made) for made in parts if made.poses is None)
            self._counters.drop(sensor.stream.topic, "no pose", "frames without one", count=lacking)
        return joined(posed or parts) if parts else None

    def _mount(self, part: Part, packet: Packet) -> None:
        state, sensor = packet["location"][0], self._of(part)
        if sensor is None:
            return
        if state is None or state.name != "DeviceState" or not np.isfinite(list(state.values.values())).all():
            self._counters.drop(sensor.stream.topic, "bad", "no finite DeviceState in a Distance")
            return
        sensor.mount = mount_of(state.values)

    def _profile(self, part: Part, packet: Packet) -> None:
        found = profile_of(packet.message.values)
        sensor = None if found is None else self._of(part)
        if found is None or sensor is None or sensor.exact:
            return
        axis, values = found
        topic = sensor.stream.topic
        self._counters.receive(topic)
        if not (0 <= packet.t_s < LATEST_S and np.isfinite(values).all()):
            self._counters.drop(topic, "bad", "a SonarData without finite numbers")
            return
        if sensor.axis is not None and not np.array_equal(sensor.axis, axis):
            sensor.profiles.clear("the range was changed")
        sensor.axis = axis
        sensor.profiles.put((round(packet.t_s * 1e9), axis, values), time.monotonic())
        text = f"{self.label(part)}: only profiles come of it, without phase: detections and maps, no images"
        self._once(text, kind=f"{part}")

    def label(self, part: Part) -> str:
        """Return the name of a part of a system, or `entityN`."""
        return self._labels.get(part) or f"entity{part[1]}"

    def _profiles_with_poses(self, part: Part, sensor: _Sensor) -> Frames | None:
        """Return the profiles whose time lies between two poses; later ones wait."""
        times: list[int] = []
        rows: list[Floats] = []
        for (_, _, values), t_ns in sensor.profiles.ready(lambda one: self._track.place(one[0]), time.monotonic()):
            if t_ns <= (times[-1] if times else sensor.last_ns):
                self._counters.drop(sensor.stream.topic, "late")
                continue
            times.append(t_ns)
            rows.append(values)
        if not times or sensor.axis is None:
            return None
        samples = np.array(rows, np.complex64)  # with phase zero
        poses = [pose for pose in self._track.poses if pose.t_ns >= self._track.started_ns]
        path = path_along(poses).at(np.array(times, np.int64)).mounted(sensor.mount.body_from_sensor())
        spec = profile_spec(sensor.axis, sensor.mount)
        return Frames(samples, sensor.axis, path.t_ns, spec, poses=path, sensor=self.label(part), unit="normalised")


def profile_spec(axis: Floats, mount: MountSpec) -> RadarSpec:
    """Return a radar for a profile: the antenna of an X4M05, and the greatest bandwidth that the bins hold."""
    rate_hz = float(np.clip(C0 / (2 * (axis[1] - axis[0])), 1.3e7, 1e11))
    return RadarSpec.preset(
        "x4m05",
        bins=len(axis),
        range_start_m=float(axis[0]),
        sampling_hz=8 * rate_hz,
        bandwidth_hz=min(1.4e9, 0.8 * rate_hz),
        noise=None,
        mount=mount,
    )
