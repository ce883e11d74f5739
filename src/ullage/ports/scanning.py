"""Radar frames from a simulator's own rays, by the thesis' processing."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np

from ullage.arrays import Floats
from ullage.data import Frames, Trajectory
from ullage.errors import InputError
from ullage.fan import FULL_DEG, reaching_max_range
from ullage.ports.cosimulation import Endless, FollowOptions, Say, radar_of
from ullage.ports.intake import Counters, Stamped, Stream, checked_pose
from ullage.ports.pose_events import Note, Pose, stamp_ns
from ullage.radar.receiver import receive_thesis
from ullage.radar.receiving import sensor_seed
from ullage.radar.scan import echoes_of_scans
from ullage.specs import RadarSpec, Rig, ThesisSpec
from ullage.world.scene import Scene


@dataclass(frozen=True, slots=True)
class Scan:
    """What a fan of rays met, and where it was cast."""

    t_ns: int
    range_m: Floats  # (up, across), infinite where it met nothing
    intensity: Floats  # (up, across)
    fov_deg: float
    min_range_m: float
    max_range_m: float
    position: tuple[float, float, float]  # of the sensor in the world
    quat_xyzw: tuple[float, float, float, float]
    elevation_deg: float | None = None  # opening upright; None: fov_deg
    sensor: str = ""  # that cast it


def scan_of(told: Any, time: Any, pose: Pose, *, sensor: str = "") -> Scan:
    """The scan in a message of either Gazebo.

    Args:
        told: its `LaserScan`.
        time: when.
        pose: of the sensor in the world.
        sensor: its name.

    Raises:
        InputError: its numbers make no scan.
    """
    shape = (max(int(told.vertical_count), 1), int(told.count))
    counts = {"ranges": len(told.ranges), "intensities": len(told.intensities)}
    for name, count in counts.items():
        if count != shape[0] * shape[1]:
            raise InputError(f"{count} {name} in {shape[0]} by {shape[1]} rays", where="scan")
    ranges, strength = np.array(told.ranges).reshape(shape), np.array(told.intensities).reshape(shape)
    limits = (told.angle_max - told.angle_min, told.range_min, told.range_max)
    up_deg = math.degrees(told.vertical_angle_max - told.vertical_angle_min)
    if np.isnan(ranges).any() or not np.isfinite(strength).all() or not np.isfinite([*limits, up_deg]).all():
        raise InputError("not a number", where="scan")
    if isinstance(wrong := checked_pose(*pose), str):
        raise InputError(wrong, where="scan")
    fov_deg = math.degrees(limits[0])
    if fov_deg > FULL_DEG - 1e-2:  # the last ray of a full circle is the first one again
        fov_deg, ranges, strength = FULL_DEG, ranges[:, :-1], strength[:, :-1]
    return Scan(stamp_ns(time), ranges, strength, fov_deg, *limits[1:], *pose, up_deg if up_deg > 0 else None, sensor)


class ScanFeed(Protocol):
    """Tells what the rays met."""

    def next(self, timeout_s: float) -> Scan | Note | None:
        """The next thing that came, None if nothing did for so long."""

    def give(self, chunk: dict[str, Frames], offset_ns: int) -> None:
        """Hand frames back; their time less the offset is the simulator's."""

    def close(self) -> None:
        """Let go of the sockets."""


def spec_of(scan: Scan, radar: RadarSpec) -> RadarSpec:
    """The radar with the scan's fan.

    Raises:
        InputError: no radar model can be made of the fan.
    """
    up, across = scan.range_m.shape
    if min(up, across) < 2:
        raise InputError(f"{across} rays across and {up} up", where="rays", allowed="two or more across and up")
    fan = ThesisSpec(
        rays_per_side=across, fov_deg=scan.fov_deg, rays_up=up, elevation_deg=scan.elevation_deg,
        min_range_m=scan.min_range_m, max_range_m=scan.max_range_m,
        noise_sigma=radar.thesis.noise_sigma, smoothing_bins=radar.thesis.smoothing_bins,
        threshold=radar.thesis.threshold,
    )  # fmt: skip
    return reaching_max_range(radar.but(thesis=fan))


class ScanSource(Endless):
    """Frames made of a simulator's own rays, one of each scan; each ray sensor is a radar.

    Args:
        join: begins to listen and gives what tells of scans.
        rig: range axis and noise of the radars by name, else of its first; the fans are those of the scans.
        options: how; `rays` names the sensors.
        scene: the world, where it is known.
        say: told what a person should know; None: it becomes a warning.
    """

    def __init__(
        self,
        join: Callable[[], ScanFeed],
        rig: Rig,
        options: FollowOptions,
        *,
        scene: Scene | None = None,
        say: Say | None = None,
    ) -> None:
        self.scene = scene
        super().__init__(options.duration_s, say, topic=options.rays)
        self._rig, self._options = rig, options
        self._cast: dict[str, Stream[Scan]] = {}  # by sensor
        self._count: dict[str, int] = {}
        self._feed = join()
        self._hear(getattr(self._feed, "counters", None) or Counters(), options.rays)

    @property
    def sensors(self) -> tuple[str, ...]:
        """Names of the ray sensors that have cast so far."""
        return tuple(self._cast)

    def stream(self, chunk: int = 64) -> Iterator[dict[str, Frames]]:
        """A frame of each scan as it comes."""
        try:
            while not self._over():
                found = self._feed.next(0.5)
                self.counters.report()
                if isinstance(found, Note):
                    self._tell(found.text)
                elif found is not None:
                    yield from self._pieces(found)
        finally:
            self._report()
            self.close()

    def close(self) -> None:
        """Let go of the sockets."""
        self._feed.close()

    def _pieces(self, found: Scan) -> Iterator[dict[str, Frames]]:
        """The frame of a scan, once its time can be trusted."""
        cast = self._cast.get(found.sensor) or self._new_stream(found.sensor)
        self._cast[found.sensor] = cast
        if found.t_ns == cast.last_ns:
            return
        for scan in cast.take(found.t_ns, found):
            piece = {found.sensor: self._frame(scan)}
            if self._options.publish:
                self._feed.give(piece, scan.t_ns - scan.stamp_ns)
            yield piece

    def _frame(self, stamped: Stamped[Scan]) -> Frames:
        scan, name = stamped.item, stamped.item.sensor
        first = 0 if stamped.starts else self._count[name]
        self._count[name] = first + 1
        spec = spec_of(scan, radar_of(self._rig, name))
        strength = scan.intensity
        if not strength.any():
            self._tell("every intensity is zero: no laser_retro in this world, so each object reflects as 1")
            strength = np.ones_like(strength)
        clean = echoes_of_scans(scan.range_m[None], strength[None], spec)
        seed = sensor_seed(self._options.seed, name)
        samples = receive_thesis(clean, spec, seed=seed, first_frame=first)
        pose = Trajectory(np.array([stamped.t_ns]), np.array([scan.position]), np.array([scan.quat_xyzw]))
        return Frames(samples, spec.range_m, pose.t_ns, spec, pose, pose, name, "thesis")
