"""Radar frames from the rays of a simulator, by the processing of the thesis."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np

from ullage.arrays import Floats
from ullage.data import Frames, Trajectory
from ullage.errors import InputError
from ullage.fan import FULL_DEG, reaching_max_range
from ullage.ports.cosimulation import CosimulationOptions, UnboundedSource
from ullage.ports.intake import Log, Stamped, Stream, checked_pose, echo_range
from ullage.ports.pose_events import Feed, Notice, Pose, stamp_ns
from ullage.radar.receiver import receive_thesis
from ullage.radar.receiving import sensor_seed
from ullage.radar.scan import echoes_of_scans
from ullage.specs import RadarSpec, Rig, ThesisSpec
from ullage.world.scene import Scene


@dataclass(frozen=True, slots=True)
class Scan:
    """Ranges and intensities of a fan of rays, and the pose of the sensor that cast it."""

    t_ns: int
    range_m: Floats  # (up, across), infinite without a hit
    intensity: Floats  # (up, across)
    fov_deg: float
    min_range_m: float
    max_range_m: float
    position: tuple[float, float, float]  # of the sensor in the world
    quat_xyzw: tuple[float, float, float, float]
    elevation_deg: float | None = None  # vertical opening; None: fov_deg
    sensor: str = ""  # name of the ray sensor


def scan_of(message: Any, time: Any, pose: Pose, *, sensor: str = "") -> Scan:
    """Return the scan in a message of either Gazebo.

    Args:
        message: its `LaserScan`.
        time: its time stamp.
        pose: of the sensor in the world.
        sensor: its name.

    Raises:
        InputError: its numbers are not a valid scan.
    """
    shape = (max(int(message.vertical_count), 1), int(message.count))
    counts = {"ranges": len(message.ranges), "intensities": len(message.intensities)}
    for name, count in counts.items():
        if count != shape[0] * shape[1]:
            raise InputError(f"{count} {name} in {shape[0]} by {shape[1]} rays", where="scan")
    ranges, strength = np.array(message.ranges).reshape(shape), np.array(message.intensities).reshape(shape)
    limits = (message.angle_max - message.angle_min, message.range_min, message.range_max)
    up_deg = math.degrees(message.vertical_angle_max - message.vertical_angle_min)
    if np.isnan(ranges).any() or not np.isfinite(strength).all() or not np.isfinite([*limits, up_deg]).all():
        raise InputError("not a number", where="scan")
    if isinstance(wrong := checked_pose(*pose), str):
        raise InputError(wrong, where="scan")
    fov_deg = math.degrees(limits[0])
    if fov_deg > FULL_DEG - 1e-2:  # the last ray of a full circle is the first one again
        fov_deg, ranges, strength = FULL_DEG, ranges[:, :-1], strength[:, :-1]
    ranges = echo_range(ranges, *limits[1:])
    return Scan(stamp_ns(time), ranges, strength, fov_deg, *limits[1:], *pose, up_deg if up_deg > 0 else None, sensor)


def spec_of(scan: Scan, radar: RadarSpec) -> RadarSpec:
    """Return the radar with the fan of a scan.

    Raises:
        InputError: the fan has too few rays for a radar model.
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


class ScanSource(UnboundedSource):
    """Frames from the rays of a simulator, one for each scan; each ray sensor is a radar.

    Args:
        join: connects and returns the feed of scans.
        rig: gives range axis and noise of the radars by name, else of its first radar; the scans give the fans.
        options: options of the radars; `rays` names the sensors.
        scene: the world, if it is known.
        log: takes lines for the user; None: they become warnings.
    """

    def __init__(
        self,
        join: Callable[[], Feed],
        rig: Rig,
        options: CosimulationOptions,
        *,
        scene: Scene | None = None,
        log: Log | None = None,
    ) -> None:
        self.scene = scene
        super().__init__(options.duration_s, log)
        self._rig, self._options = rig, options
        self._cast: dict[str, Stream[Scan]] = {}  # by sensor
        self._count: dict[str, int] = {}
        self._join(join, options.rays)

    @property
    def sensors(self) -> tuple[str, ...]:
        """Names of the ray sensors that gave scans so far."""
        return tuple(self._cast)

    def _step(self, chunk: int, *, stopping: bool) -> Iterator[dict[str, Frames]]:
        found = self._feed.next(0.5)
        self._ended = stopping and found is None
        if isinstance(found, Notice):
            self._log_throttled(found.text)
        elif found is not None:
            yield from self._pieces(found)

    def _release(self) -> None:
        self._feed.close()

    def _pieces(self, found: Scan) -> Iterator[dict[str, Frames]]:
        """Give the frame of a scan once the clock accepts its time."""
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
        radar = self._rig.sensors.get(name) or next(iter(self._rig.sensors.values()))
        spec = spec_of(scan, radar)
        strength = scan.intensity
        if not strength.any():
            self._log_throttled("every intensity is zero: no laser_retro in this world, so each object reflects as 1")
            strength = np.ones_like(strength)
        clean = echoes_of_scans(scan.range_m[None], strength[None], spec)
        seed = sensor_seed(self._options.seed, name)
        samples = receive_thesis(clean, spec, seed=seed, first_frame=first)
        pose = Trajectory(np.array([stamped.t_ns]), np.array([scan.position]), np.array([scan.quat_xyzw]))
        return Frames(samples, spec.range_m, pose.t_ns, spec, pose, pose, name, "thesis")
