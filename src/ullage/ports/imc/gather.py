"""Radar frames out of the messages of a bus or a log: exact ones, else the profiles of echo sounders."""

from __future__ import annotations

import warnings
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from ullage.data import Floats, Frames, Trajectory
from ullage.errors import UllageWarning
from ullage.geometry import C0
from ullage.ports import conversions
from ullage.ports import messages as ros
from ullage.ports.imc.codec import Packet
from ullage.ports.imc.places import Geodetic, Pose, path_along, pose_of
from ullage.ports.imc.radars import carried, mount_of, profile_of
from ullage.specs import MountSpec, RadarSpec

HELD = 4096  # messages of one sensor that wait for a pose or for their settings
Part = tuple[int, int]
"""A system and a part of it."""


@dataclass(slots=True)
class Track:
    """The poses of one vehicle, in order of time.

    Args:
        state: which message tells them.
        origin: of the world; None: where the first one has its reference.
        vehicle: name or number of the vehicle; empty: the first that tells one.
        say: told of clocks that jump.
        keep: how many are kept.
    """

    state: str = "EstimatedState"
    origin: Geodetic | None = None
    vehicle: str = ""
    say: Callable[[str], None] = lambda text: warnings.warn(text, UllageWarning, stacklevel=2)
    keep: int | None = 4096
    poses: deque[Pose] = field(default_factory=deque)
    followed: int | None = None
    jumps: int = 0

    def take(self, packet: Packet) -> Pose | None:
        """The pose of this message, if it is one of the vehicle's and later than the last."""
        if packet.name == "Announce" and self.vehicle and packet["sys_name"] == self.vehicle:
            self.followed = packet.src
        if packet.name != self.state:
            return None
        if self.followed is None and (not self.vehicle or self.vehicle in (str(packet.src), f"{packet.src:#06x}")):
            self.followed = packet.src
        if packet.src != self.followed:
            return None
        numbers = list(packet.message.values.values())
        if not np.isfinite(numbers).all() or not 0 <= packet.t_s < 9e9:
            return None
        if self.origin is None:
            self.origin = Geodetic(packet["lat"], packet["lon"], packet["height"])
        pose = pose_of(packet.message.values, round(packet.t_s * 1e9), self.origin)
        if self.poses and pose.t_ns <= self.poses[-1].t_ns:
            behind = (self.poses[-1].t_ns - pose.t_ns) * 1e-9
            if behind < 1.0:  # overtaken on the way
                return None
            self.say(f"time of system {packet.src:#06x} jumped back {behind:.1f} s: starting anew")
            self.poses.clear()
            self.jumps += 1
        self.poses.append(pose)
        if self.keep is not None and len(self.poses) > self.keep:
            self.poses.popleft()
        return pose

    def path(self) -> Trajectory | None:
        """All that is kept."""
        return path_along(list(self.poses)) if self.poses else None


@dataclass(slots=True)
class _Sensor:
    """What has come of one part of a system and is not yet given on."""

    settings: dict[str, Any] = field(default_factory=dict)
    notes: list[bytes] = field(default_factory=list)
    profiles: list[tuple[int, Floats, Floats]] = field(default_factory=list)
    exact: bool = False
    name: str = ""
    mount: MountSpec = field(default_factory=MountSpec)
    last_ns: int = -1


class Gatherer:
    """Takes messages and gives the frames they make.

    Args:
        track: of the vehicle, for the poses of profiles.
        labels: names of parts of systems; learned from EntityInfo and EntityList as well.
    """

    def __init__(self, track: Track, *, labels: dict[Part, str] | None = None) -> None:
        self._track, self._labels = track, labels or {}
        self._sensors: dict[Part, _Sensor] = {}
        self._told: set[Part] = set()
        self.damaged = 0

    def take(self, packet: Packet) -> bool:
        """Keep what this message tells of a radar; true where it is a frame."""
        part = (packet.src, packet.src_ent)
        if packet.name == "EntityInfo":
            self._labels[packet.src, packet["id"]] = packet["label"]
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
        """The frames that are ready, by sensor; with `final` those whose poses will not come are left out."""
        out: dict[str, Frames] = {}
        for part, sensor in self._sensors.items():
            try:
                found = self._whole(sensor) if sensor.exact else self._placed(part, sensor, final)
            except Exception:  # bytes of a stranger: whatever they do to those who read them, the rest goes on
                self.damaged += 1
                sensor.notes.clear()
                continue
            if found is not None and len(found):
                sensor.last_ns = int(found.t_ns[-1])
                out[found.sensor] = found
        return out

    def _of(self, part: Part) -> _Sensor:
        return self._sensors.setdefault(part, _Sensor())

    def _learn(self, packet: Packet) -> None:
        for pair in packet["list"].split(";"):
            label, sign, number = pair.partition("=")
            if sign and number.isdecimal() and int(number) < 256:
                self._labels[packet.src, int(number)] = label

    def _exact(self, part: Part, value: bytes) -> None:
        found = carried(value)
        if found is None:
            return
        sensor = self._of(part)
        kind, data = found
        try:
            if kind == ros.SETTINGS:
                fresh = conversions.settings_of(data)
                sensor.settings, sensor.name = fresh, conversions.text_in(data, 1)
            elif conversions.text_in(data, 1) == sensor.name:
                sensor.notes.append(data)
        except Exception:  # as in `give`
            self.damaged += 1
            return
        sensor.exact = True
        del sensor.notes[:-HELD]

    def _whole(self, sensor: _Sensor) -> Frames | None:
        notes, sensor.notes = sensor.notes, []
        notes = [note for note in notes if len(note) == len(notes[0])]
        if not notes or "spec" not in sensor.settings:
            return None
        t_ns = conversions.times_in(notes)
        before = np.maximum.accumulate(np.concatenate([[sensor.last_ns], t_ns[:-1]]))
        rows = np.flatnonzero(t_ns > before)
        if not len(rows):
            return None
        return conversions.frames_of([notes[k] for k in rows], sensor.name, sensor.settings, t_ns[rows])

    def _mount(self, part: Part, packet: Packet) -> None:
        state = packet["location"][0]
        if state is None or state.name != "DeviceState" or not np.isfinite(list(state.values.values())).all():
            self.damaged += 1
            return
        self._of(part).mount = mount_of(state.values)

    def _profile(self, part: Part, packet: Packet) -> None:
        sensor, found = self._of(part), profile_of(packet.message.values)
        if found is None or sensor.exact or not 0 <= packet.t_s < 9e9:
            return
        axis, values = found
        waiting = sensor.profiles
        if waiting and not np.array_equal(waiting[-1][1], axis):
            waiting.clear()  # the range was changed
        waiting.append((round(packet.t_s * 1e9), axis, values))
        del waiting[:-HELD]
        if part not in self._told:
            self._told.add(part)
            self._track.say(
                f"{self.label(part)}: only profiles come of it, without phase: detections and maps, no images"
            )

    def label(self, part: Part) -> str:
        """The name of a part of a system, as far as it is known."""
        return self._labels.get(part) or f"entity{part[1]}"

    def _placed(self, part: Part, sensor: _Sensor, final: bool) -> Frames | None:
        """Profiles whose time lies between two poses; later ones wait."""
        poses = self._track.poses
        if not poses or not sensor.profiles:
            return None
        first, last = poses[0].t_ns, poses[-1].t_ns
        ready = [p for p in sensor.profiles if first <= p[0] <= last]
        sensor.profiles = [] if final else [p for p in sensor.profiles if p[0] > last]
        times = np.array([p[0] for p in ready], np.int64)
        rows = np.flatnonzero(times > np.maximum.accumulate(np.concatenate([[sensor.last_ns], times[:-1]])))
        if not len(rows):
            return None
        axis = ready[rows[0]][1]
        samples = np.array([ready[k][2] for k in rows], np.complex64)  # as if all had phase zero
        path = path_along(list(poses)).at(times[rows]).mounted(sensor.mount.body_from_sensor())
        spec = profile_spec(axis, sensor.mount)
        return Frames(samples, axis, times[rows], spec, poses=path, sensor=self.label(part), unit="normalised")


def profile_spec(axis: Floats, mount: MountSpec) -> RadarSpec:
    """A radar for a profile that came without one: an X4M05's antenna, and as much band as the bins can hold."""
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
