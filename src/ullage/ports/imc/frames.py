"""Frames as IMC messages, and back; and the sink that sends them on the bus.

What others can read is `SonarData` (the profile as an echo sounder's) and `Distance` (the nearest echo, with where the
radar sits and how wide it looks). Both lose much, so `DevDataBinary` carries the same frame to the last bit: the name
of a ROS 2 message, a zero, and that message in CDR, as recordings have it.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Mapping
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np

from ullage.arrays import Floats
from ullage.data import Frames, Trajectory
from ullage.flow import Sink
from ullage.geometry import invert, matrix_quat, quat_matrix, quat_rpy, transform
from ullage.ports import conversions
from ullage.ports import schema as ros
from ullage.ports.imc.broker import Outgoing, RosToImc
from ullage.ports.imc.codec import MOST, Message, make, readable
from ullage.ports.imc.link import Link, leave, open_link
from ullage.ports.imc.options import MessageOptions, SinkOptions
from ullage.ports.imc.wires import Entity, own_identity
from ullage.ports.intake import Log, Once, warn
from ullage.ports.ned import FLIP, SWAP, Geodetic
from ullage.ports.pose_events import BodyState
from ullage.ports.protocol import Item, Passed
from ullage.ports.publisher import RateLimiter
from ullage.processing.detect import detect
from ullage.specs import MountSpec, RadarSpec

ECHO_SOUNDER = 1
FREQUENCY_MOST = 2**32 - 1
LEVELS = 2**16 - 1
CARRIED = (ros.FRAME, ros.SETTINGS)
BODY = 1
FIRST_RADAR = 10
SETTINGS_EVERY_NS = 5_000_000_000
NOT_SIMULATED = ("vx", "vy", "vz", "depth", "alt")


def device_state(mount: MountSpec) -> Message:
    """Return the mount of a sensor on the body, forward-right-down."""
    body_from_sensor = mount.body_from_sensor()
    x, y, z = FLIP @ body_from_sensor[:3, 3]
    phi, theta, psi = quat_rpy(matrix_quat(FLIP @ body_from_sensor[:3, :3] @ FLIP))
    return make("DeviceState", x=float(x), y=float(y), z=float(z), phi=float(phi), theta=float(theta), psi=float(psi))


def mount_of(state: Mapping[str, Any]) -> MountSpec:
    """Return the mount of a DeviceState."""
    rot = FLIP @ transform((0, 0, 0), (state["phi"], state["theta"], state["psi"]))[:3, :3] @ FLIP
    roll, pitch, yaw = (math.degrees(a) for a in quat_rpy(matrix_quat(rot)))
    x, y, z = (float(v) for v in FLIP @ np.array([state["x"], state["y"], state["z"]], float))
    return MountSpec(position_m=(x, y, z), roll_deg=roll, pitch_deg=pitch, yaw_deg=yaw)


def beam_config(spec: RadarSpec) -> Message:
    """Return the one-way half-power beam width of a radar."""
    wide = 180.0 if spec.antenna.kind == "isotropic" else min(spec.antenna.azimuth_deg, 180.0)
    high = 180.0 if spec.antenna.kind == "isotropic" else min(spec.antenna.elevation_deg, 180.0)
    return make("BeamConfig", beam_width=math.radians(wide), beam_height=math.radians(high))


def distances(frames: Frames) -> list[Message]:
    """Distance of the nearest echo of each frame; invalid where there is none."""
    hits = detect(frames)
    near = dict(zip(hits.frame[::-1].tolist(), hits.range_m[::-1].tolist(), strict=True))
    where, beam = (device_state(frames.spec.mount),), (beam_config(frames.spec),)
    return [
        make("Distance", validity=int(k in near), location=where, beam_config=beam, value=near.get(k, 0.0))
        for k in range(len(frames))
    ]


def profiles(frames: Frames) -> list[Message]:
    """Return SonarData of each frame: amplitudes between whole metres, as its range fields require.

    Point i of n lies at min_range + i (max_range - min_range) / n; beyond the frame's own bins there is nothing.
    """
    axis = frames.range_m
    low, high = max(math.floor(axis[0]), 0), math.ceil(axis[-1])
    step = (axis[-1] - axis[0]) / max(len(axis) - 1, 1) or 1.0
    count = min(max(math.ceil((high - low) / step), 1), 30_000)
    at = low + np.arange(count) * ((high - low) / count)
    frequency = round(frames.spec.center_hz)
    beam = (beam_config(frames.spec),)
    out = []
    for row in np.asarray(frames.amplitude, float):
        values = np.interp(at, axis, row, left=0.0, right=0.0)
        scale = float(np.float32(max(values.max(), 1e-30) / LEVELS))
        data = np.clip(np.rint(values / scale), 0, LEVELS).astype("<u2").tobytes()
        out.append(
            make(
                "SonarData", type=ECHO_SOUNDER, frequency=frequency if frequency <= FREQUENCY_MOST else 0,
                min_range=low, max_range=high, bits_per_point=16, scale_factor=scale, beam_config=beam, data=data,
            )
        )  # fmt: skip
    return out


def profile_of(message: Mapping[str, Any]) -> tuple[Floats, Floats] | None:
    """Ranges [m] and amplitudes of a SonarData; None where it is of a kind that has no plain profile."""
    size = message["bits_per_point"] // 8
    if message["type"] not in (0, 1, 3) or size not in (1, 2, 4) or message["bits_per_point"] % 8:
        return None
    data = message["data"]
    count = len(data) // size
    low, high = message["min_range"], message["max_range"]
    if count < 8 or high <= low or len(data) % size:
        return None
    values = np.frombuffer(data, f"<u{size}").astype(float) * (message["scale_factor"] or 1.0)
    return low + np.arange(count) * ((high - low) / count), values


def exact(frames: Frames, start: int, *, truth: bool) -> list[Message]:
    """Return DevDataBinary of each frame, numbered from `start`; none if a frame is too long for a packet."""
    messages = conversions.frame_messages(frames if truth else replace(frames, truth=None), start)
    if not messages or len(messages[0]) + 64 > MOST:
        return []
    return [make("DevDataBinary", value=ros.FRAME.encode() + b"\0" + data) for data in messages]


def settings(frames: Frames) -> Message:
    """DevDataBinary of what holds for every frame: unit, range axis, radar."""
    return make("DevDataBinary", value=ros.SETTINGS.encode() + b"\0" + conversions.settings_message(frames))


def carried(value: bytes) -> tuple[str, bytes] | None:
    """Name and bytes of the ROS 2 message that a DevDataBinary of ours carries."""
    name, zero, rest = value[:64].partition(b"\0")
    kind = name.decode("ascii", "replace")
    return (kind, value[len(name) + 1 :]) if zero and kind in CARRIED and rest else None


def state_of(pose: BodyState, origin: Geodetic) -> dict[str, float]:
    """Return the fields of an EstimatedState for a pose; altitude is the height over the world's z = 0."""
    ned_from_frd = SWAP @ quat_matrix(pose.quat_xyzw) @ FLIP
    phi, theta, psi = (float(a) for a in quat_rpy(matrix_quat(ned_from_frd)))
    x, y, z = (float(v) for v in SWAP @ pose.position)
    vx, vy, vz = (float(v) for v in SWAP @ pose.velocity)
    u, v, w = (float(k) for k in ned_from_frd.T @ (SWAP @ pose.velocity))
    p, q, r = (float(k) for k in FLIP @ pose.spin)
    return {
        "lat": origin.lat_rad, "lon": origin.lon_rad, "height": origin.height_m, "x": x, "y": y, "z": z,
        "phi": phi, "theta": theta, "psi": psi, "u": u, "v": v, "w": w, "vx": vx, "vy": vy, "vz": vz,
        "p": p, "q": q, "r": r, "depth": -1.0, "alt": float(pose.position[2]),
    }  # fmt: skip


def poses_along(path: Trajectory) -> list[BodyState]:
    """Return each sample of a trajectory as a pose."""
    velocity, spin = path.rates
    columns = zip(path.t_ns, path.position, path.quat_xyzw, velocity, spin, strict=True)
    return [BodyState(int(t), *rest) for t, *rest in columns]


class TimedMessage(NamedTuple):
    """A message with its time and entity."""

    t_ns: int
    entity: int
    message: Message


class MessageEncoder:
    """Encode frames and paths as messages.

    Args:
        options: select the messages.
        origin: geodetic place of the world's origin.
        enter: called with each radar that becomes an entity.
    """

    def __init__(self, options: MessageOptions, origin: Geodetic, enter: Callable[[Entity], None]) -> None:
        self._options, self._origin, self._enter = options, origin, enter
        self._labels = options.entity_labels()
        self._entity: dict[str, int] = {}
        self._count: dict[str, int] = {}
        self._settled: dict[str, int] = {}
        self._once = Once()

    def messages(self, item: Item) -> list[TimedMessage]:
        """Return the messages of frames, of a chunk of frames, or of the body's path; other items give none."""
        if isinstance(item, Frames):
            item = {item.sensor: item}
        if isinstance(item, Mapping):
            found = [one for name, frames in item.items() for one in self._of(name, frames)]
            return sorted(found, key=lambda one: one.t_ns)
        if isinstance(item, Trajectory) and self._options.state and not self._entity:
            return self._states(item, "EstimatedState")
        return []  # the frames have already given the poses

    def _of(self, name: str, frames: Frames) -> list[TimedMessage]:
        entity = self._entity.get(name)
        if entity is None:
            entity = self._entity[name] = FIRST_RADAR + len(self._entity)
            self._enter(Entity(entity, self._labels.get(name, name), "ullage.radar"))
        o, out = self._options, []
        if o.state and entity == FIRST_RADAR:
            out += self._of_body(frames)
        if o.exact:
            out += self._exact(name, entity, frames)
        if o.profile:
            out += self._each(entity, frames, profiles(frames))
        if o.distance != "off":
            out += self._each(entity, frames, distances(frames))
        return out

    def _each(self, entity: int, frames: Frames, messages: list[Message]) -> list[TimedMessage]:
        return [TimedMessage(t, entity, m) for t, m in zip(frames.t_ns.tolist(), messages, strict=True)]

    def _exact(self, name: str, entity: int, frames: Frames) -> list[TimedMessage]:
        start = self._count.get(name, 0)
        self._count[name] = start + len(frames)
        messages = exact(frames, start, truth=self._options.truth)
        if not messages:
            self._once(f"{name}: a frame is too long for a packet of IMC; only profiles go")
            return []
        out = self._each(entity, frames, messages)
        first = int(frames.t_ns[0])
        if first - self._settled.get(name, -(2**62)) >= SETTINGS_EVERY_NS:  # for peers that join later
            self._settled[name] = first
            out.insert(0, TimedMessage(first, entity, settings(frames)))
        return out

    def _of_body(self, frames: Frames) -> list[TimedMessage]:
        sensor_from_body = invert(frames.spec.mount.body_from_sensor())
        out = []
        if frames.poses is not None:
            out += self._states(frames.poses.mounted(sensor_from_body), "EstimatedState")
        if frames.truth is not None and self._options.truth:
            out += self._states(frames.truth.mounted(sensor_from_body), "SimulatedState")
        return out

    def _states(self, path: Trajectory, kind: str) -> list[TimedMessage]:
        out = []
        for pose in poses_along(path):
            fields: dict[str, Any] = state_of(pose, self._origin)
            if kind == "SimulatedState":
                fields = {key: value for key, value in fields.items() if key not in NOT_SIMULATED}
            out.append(TimedMessage(pose.t_ns, BODY, make(kind, **fields)))
        return out


FIRST_RELAYED, LAST_RELAYED = 100, 254
"""Entity numbers of relayed systems; radars have numbers from 10."""
EPOCH_S = 1e9
"""Times earlier than 2001 count from the start of a flight, not from 1970."""


class ImcSink(Sink):
    """Send frames, paths and passed-on messages on an IMC bus.

    Args:
        place: `tcp://host:port`, `udp://host:port`, or nothing.
        options: select what is sent.
        log: takes lines for the user.

    Raises:
        InputError: the place is not valid.
    """

    settings = SinkOptions
    sends = True
    """Its messages leave this machine's process at once."""

    def __init__(self, place: str, options: SinkOptions, *, log: Log = warn) -> None:
        home = options.home()
        me = replace(own_identity(options), lat_rad=home.lat_rad, lon_rad=home.lon_rad, height_m=home.height_m)
        self._limiter = RateLimiter(options.pace)
        self._link: Link = open_link(place, options, me, role="sink", log=log)
        self._encoder = MessageEncoder(options, home, self._link.enter)
        self._from_ros, self._relayed = RosToImc(options.system_id, log), dict[str, int]()
        self._shares = False  # the last entity stands for several parts
        self._epoch_s: float | None = None  # Unix time at 0 of the stream's clock [s]

    def write(self, item: Item) -> None:
        """Send frames, chunks of frames, the body's path, or ROS messages; ignore everything else."""
        if isinstance(item, Passed) and not self._link.listens:  # else it came from this bus
            for one in self._from_ros.take(item):
                self._relay(one)
        for timed in self._encoder.messages(item):
            self._send(timed)

    def _send(self, timed: TimedMessage) -> None:
        """Send a message when it is due: stream time runs `pace` times as fast as wall time."""
        t_s = timed.t_ns * 1e-9
        if self._epoch_s is None:
            self._epoch_s = 0.0 if t_s > EPOCH_S else time.time() - t_s
        self._limiter.wait(timed.t_ns)
        self._link.send(timed.message, entity=timed.entity, t_s=self._epoch_s + t_s)

    def _relay(self, one: Outgoing) -> None:
        """Send at once; each relayed part of another system is an entity of ours."""
        entity = self._relayed.get(one.part)
        if entity is None:
            entity = BODY if not one.part else min(FIRST_RELAYED + len(self._relayed), LAST_RELAYED)
            if entity < LAST_RELAYED:  # further ones share the last entity
                self._relayed[one.part] = entity
            if one.part and (entity < LAST_RELAYED or not self._shares):
                self._shares = entity == LAST_RELAYED
                self._link.enter(Entity(entity, readable(one.part), "ullage.relay"))
        self._link.send(one.message, entity=entity, t_s=one.t_s, dst=one.dst, dst_ent=one.dst_ent)

    def close(self) -> None:
        """Send the queued messages, if the peer takes them, and close the sockets."""
        leave(self._link, "sink")
