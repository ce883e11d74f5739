"""Obstacles around the body: range tracks of every radar, the directions each may lie in, and sectors of both.

Detections come from CFAR [Rohling1983] after the radar's own echo is removed. A Kalman filter follows each echo in
range (`processing.range_tracks`). Levels, lever arms and motion give the directions of each track as a credible set on
a grid (`processing.bearings`). A track counts in every sector that its set touches, and in no other.
Distances hold for the requested time: between the frames of a sensor, its tracks move on at their closing speeds.
A sensor that is silent, or repeats one frame, has an unknown distance: the pilot has to stop.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, field
from typing import Any, NamedTuple

import numpy as np

from ullage.antenna import boresight_pattern
from ullage.arrays import Bools, Complexes, Floats, Longs
from ullage.data import Detections, Frames
from ullage.errors import InputError
from ullage.flow import Stage
from ullage.geometry import C0, quat_matrix, transform
from ullage.processing import bearings
from ullage.processing.baseband import envelope, has_phase, noise_correlation
from ullage.processing.bearings import CELLS, LEVEL, LEVEL_DB, Echoes, RadarView
from ullage.processing.detect import detect
from ullage.processing.echoes import blind_m, profile_noise
from ullage.processing.fold_levels import errors_of
from ullage.processing.health import HealthMonitor
from ullage.processing.inverse_sensor import mirror_m
from ullage.processing.own_echo import OwnEchoFilter
from ullage.processing.range_tracks import Motion, RangeTracker, Track, TrackerSpec
from ullage.specs import RadarSpec

_TRAIN, _QUANTILE = 24, 0.25  # in a room most bins hold echoes of walls: a quarter of them without any is enough
STALE_S = 0.5
"""Without a new frame for so long, a distance is unknown; autopilots use the same limit [PX4Collision]."""


@dataclass(frozen=True, slots=True, eq=False)
class ObstacleTracks:
    """All confirmed tracks of all sensors at one time, nearest first for each sensor."""

    sensor: Longs  # (m) index into ObstacleSectors.sensors
    number: Longs  # (m) a track keeps its number; unique for each sensor
    distance_m: Floats  # (m) least distance from the body's origin [m]
    sigma_m: Floats  # (m) [m]
    closing_speed_m_s: Floats  # (m) above zero: approaches [m/s]
    closing_sigma_m_s: Floats  # (m) [m/s]
    snr_db: Floats  # (m) at its last detection [dB]
    outside: Bools  # (m) it lies outside the main lobe of its sensor, such as the floor
    cells: Bools | None = None  # (m, n) directions of `bearings.CELLS` in which it may lie; None: all of its lobe
    azimuth_rad: Floats | None = None  # (m) mean, counter-clockwise from forward [rad]
    azimuth_sigma_rad: Floats | None = None  # (m) [rad]
    ambiguous: Bools | None = None  # (m) by its level it may lie farther by the unambiguous range, and be folded

    def __len__(self) -> int:
        return len(self.sensor)


@dataclass(frozen=True, slots=True, eq=False)
class ObstacleSectors:
    """The nearest obstacle in the sector of each of k radars, in the body's frame (forward, left, up).

    A sector is the main lobe of one radar: it holds all directions within half of `width_rad` of its boresight.
    Sectors may overlap or leave gaps.
    """

    t_ns: int  # time of the newest frame in it [ns]
    sensors: tuple[str, ...]  # (k) names
    boresight: Floats  # (k, 3) unit vectors in the body's frame
    centre_rad: Floats  # (k) yaw of the boresight, counter-clockwise from forward [rad]
    width_rad: Floats  # (k) opening of the main lobe [rad]
    least_m: Floats  # (k) nearer than this to the body's origin nothing is detected [m]
    reach_m: Floats  # (k) farther than this nothing is detected [m]
    distance_m: Floats  # (k) from the body's origin; +inf: nothing detected; NaN: unknown [m]
    sigma_m: Floats  # (k) one sigma of the distance; NaN without an obstacle [m]
    closing_speed_m_s: Floats  # (k) above zero: approaches; NaN without an obstacle [m/s]
    closing_sigma_m_s: Floats  # (k) one sigma [m/s]
    valid: Bools  # (k) the sensor works and its distance is current
    stale: Bools  # (k) no new frame for longer than the limit, or none yet
    fault: tuple[str, ...]  # (k) why a sensor is not valid, in words; "" where it is
    tracks: ObstacleTracks

    def __len__(self) -> int:
        return len(self.sensors)

    def directions(self) -> Bools:
        """Return the cells (m, n) of `bearings.CELLS` in which each track may lie."""
        if self.tracks.cells is not None:
            return self.tracks.cells
        lobe = _lobes(self.boresight, self.width_rad)[self.tracks.sensor]
        return np.asarray(lobe ^ self.tracks.outside[:, None])

    def nearest_m(self) -> Floats:
        """Return the nearest obstacle (72) in level directions, 5 degrees apart, counter-clockwise [m]; +inf: none."""
        level = self.directions()[:, LEVEL].reshape(len(self.tracks), 3, bearings.AZIMUTHS).any(1)
        return np.asarray(np.where(level, self.tracks.distance_m[:, None], np.inf).min(0, initial=np.inf))

    @property
    def time_to_collision_s(self) -> Floats:
        """Distance over closing speed (k) [s]; +inf where nothing approaches, NaN where unknown."""
        closing = np.where(self.closing_speed_m_s > 0, self.closing_speed_m_s, np.nan)
        return np.where(self.valid, np.nan_to_num(self.distance_m / closing, nan=np.inf, posinf=np.inf), np.nan)

    @property
    def time_to_collision_sigma_s(self) -> Floats:
        """One sigma of the time to collision (k), of first order in both errors [s]; NaN where it is not finite."""
        closing = np.where(self.closing_speed_m_s > 0, self.closing_speed_m_s, np.nan)
        return np.asarray(np.hypot(self.sigma_m, self.distance_m * self.closing_sigma_m_s / closing) / closing)

    def covers(self, yaw_rad: float) -> Bools:
        """Which sectors (k) hold a level direction, counter-clockwise from forward [rad]."""
        ahead = self.boresight @ np.array([math.cos(yaw_rad), math.sin(yaw_rad), 0.0])
        return np.asarray(np.arccos(np.clip(ahead, -1, 1)) <= self.width_rad / 2)


class _Profile(NamedTuple):
    """What a radar received in one frame, without its own echo."""

    range_m: Floats  # (b) [m]
    level_db: Floats  # (b)
    peak_m: Floats  # (q) [m]
    peak_db: Floats  # (q)
    noise_db: float
    mirror_db: float


@dataclass(slots=True)
class _Sensor:
    """State of one radar."""

    spec: RadarSpec
    tracker: RangeTracker
    boresight: Floats  # (3) in the body
    half_lobe_rad: float
    arm_m: float  # least distance by which the mount adds to a range in the main lobe: of its blind range and reach
    range_m: tuple[float, float]  # first and last bin
    correlation: Complexes  # of the noise between bins
    body_from_sensor: Floats  # (4, 4)
    place: Floats = field(default_factory=lambda: np.zeros(3))  # in the world at the last frame [m]
    profile: _Profile | None = None  # of the last frame
    number: int = 0  # of frames
    fresh_ns: int | None = None
    confirmed: list[Track] = field(default_factory=list)
    right_way: int = 0  # frames that agree with the mount
    wrong_way: int = 0  # frames in which the strongest echo moves as if the sensor pointed the other way
    fault: str = ""

    def tracks_at(self, t_ns: int) -> list[Track]:
        """The confirmed tracks at a time after the last frame, moved on at their closing speeds, nearest first."""
        age_s = 0.0 if self.fresh_ns is None else max(t_ns - self.fresh_ns, 0) * 1e-9
        if not age_s:
            return self.confirmed
        noise = self.tracker.spec.acceleration_m_s2**2 * age_s**2
        return sorted((track.after(age_s, noise) for track in self.confirmed), key=lambda track: track.range_m)


_Found = tuple[Detections, Longs, list[_Profile]]


@dataclass(slots=True)
class ObstacleStage(Stage):
    """Obstacle distances, one `ObstacleSectors` for each time at which a frame came.

    Args:
        expected: radars that must report, by name; one that never does is stale. None: those that have reported.
        pfa: false alarm probability of a range bin. Four radars make 10,000 bins a second, and a false alarm among the
            echoes of a hall can lead a track astray.
        stale_s: without a new frame for so long, a distance is unknown [s].
        tracker: settings of the tracks.
        own_echo: removes the radar's own echo; None: it stays.
        floor_z_m: height of the floor in the world, if it is known [m].
    """

    expected: Mapping[str, RadarSpec] | None = None
    pfa: float = 1e-6
    stale_s: float = STALE_S
    tracker: TrackerSpec = field(default_factory=TrackerSpec)
    own_echo: OwnEchoFilter | None = field(default_factory=lambda: OwnEchoFilter(most=48, growth=1.5))
    floor_z_m: float | None = None
    _attitude: Floats = field(default_factory=lambda: np.eye(3))  # world_from_body at the last frame
    _height_m: float = math.nan  # over the known floor
    _sensors: dict[str, _Sensor] = field(default_factory=dict)
    _health: HealthMonitor = field(default_factory=HealthMonitor)
    _due: list[str] = field(default_factory=list)  # sensors whose own echo is to be estimated anew

    def __post_init__(self) -> None:
        for name, value in (("pfa", self.pfa), ("stale_s", self.stale_s)):
            if not value > 0:
                raise InputError(f"{name} is {value}", where="ObstacleStage", allowed="> 0")
        self._health.limit_s = self.stale_s
        for name, spec in (self.expected or {}).items():
            self._sensors[name] = _sensor(spec, self.tracker)

    def update(self, chunk: Mapping[str, Frames]) -> Iterable[ObstacleSectors]:
        """Take frames of one or more radars; the obstacles at each of their times, in order.

        Raises:
            InputError: a frame has no number in a bin, or comes from a radar that is not expected.
        """
        clean = self._without_own_echo(chunk)
        events: list[tuple[int, str, int]] = []
        found: dict[str, _Found] = {}
        for name, part in clean.items():
            self._check_known(name, part)
            hits = _detections(part, self.pfa, self._sensors[name].correlation)
            found[name] = hits, np.searchsorted(hits.frame, np.arange(len(part) + 1)), _profiles(part)
            events += [(int(t_ns), name, row) for row, t_ns in enumerate(part.t_ns)]
        events.sort()
        return self._steps(events, chunk, found)

    def sectors(self, t_ns: int) -> ObstacleSectors:
        """Return the obstacles at a time, also when no frame has come [ns]."""
        parts = list(self._sensors.values())
        stale = np.array([s.fresh_ns is None or t_ns - s.fresh_ns > self.stale_s * 1e9 for s in parts], bool)
        causes = [self._health.fault(name, t_ns) or "no new frame" for name in self._sensors]
        fault = tuple(s.fault or (why if late else "") for s, late, why in zip(parts, stale, causes, strict=True))
        valid = np.array([not text for text in fault], bool)
        bore = np.array([s.boresight for s in parts]).reshape(-1, 3)
        width = np.array([2 * s.half_lobe_rad for s in parts])
        arm = np.array([s.arm_m for s in parts])
        tracks = self._tracks(t_ns, parts, valid, _lobes(bore, width))
        near = _nearest(tracks, _lobes(bore, width))

        def column(values: Floats, missing: float) -> Floats:
            return np.where(valid, np.append(values, missing)[near], np.nan)

        return ObstacleSectors(
            t_ns=t_ns, sensors=tuple(self._sensors), boresight=bore, centre_rad=np.arctan2(bore[:, 1], bore[:, 0]),
            width_rad=width,
            least_m=np.array([s.tracker.blind_m for s in parts]) + arm,
            reach_m=np.array([s.range_m[1] for s in parts]) + arm,
            distance_m=column(tracks.distance_m, math.inf),
            sigma_m=column(tracks.sigma_m, math.nan),
            closing_speed_m_s=column(tracks.closing_speed_m_s, math.nan),
            closing_sigma_m_s=column(tracks.closing_sigma_m_s, math.nan),
            valid=valid, stale=stale, fault=fault, tracks=tracks,
        )  # fmt: skip

    def _tracks(self, t_ns: int, parts: list[_Sensor], valid: Bools, lobes: Bools) -> ObstacleTracks:
        rows = [(k, track) for k, s in enumerate(parts) if valid[k] for track in s.tracks_at(t_ns)]
        radar = np.array([k for k, _ in rows], np.int64)

        def column(get: Any) -> Floats:
            return np.array([get(track) for _, track in rows], float)

        range_m = column(lambda track: track.range_m)
        at_frame = [{track.number: track.range_m for track in s.confirmed} for s in parts]
        echoes = Echoes(radar.tolist(), np.array([at_frame[k][track.number] for k, track in rows]),
                        column(lambda track: track.rate_m_s), [track.sums for _, track in rows],
                        np.array([parts[k].place for k in radar]).reshape(-1, 3))  # fmt: skip
        yaw = math.atan2(self._attitude[1, 0], self._attitude[0, 0])
        turn = transform(rpy_rad=(0.0, 0.0, -yaw))[:3, :3] @ self._attitude
        views = [self._view(s, turn) if valid[k] else None for k, s in enumerate(parts)]
        chance = bearings.posterior(echoes, views, yaw)
        cells = bearings.credible(chance)
        arms = np.array([turn @ s.body_from_sensor[:3, 3] for s in parts]).reshape(-1, 3)[radar]
        mean, spread = bearings.azimuth(chance)
        return ObstacleTracks(
            radar,
            np.array([track.number for _, track in rows], np.int64),
            range_m + np.where(cells, arms @ CELLS.T, np.inf).min(1, initial=np.inf),
            column(lambda track: math.sqrt(track.var_r)),
            column(lambda track: track.closing_m_s),
            column(lambda track: math.sqrt(track.var_v)),
            column(lambda track: track.snr_db),
            np.asarray(~(cells & lobes[radar]).any(1)), cells, mean, spread,
            np.array([_may_be_folded(parts[k], views[k], track) for k, track in rows], bool),
        )  # fmt: skip

    def _view(self, sensor: _Sensor, turn: Floats) -> RadarView | None:
        """Return what a radar last received, in the level frame that the body is turned from (3, 3)."""
        if sensor.profile is None:
            return None
        pose = turn @ sensor.body_from_sensor[:3]
        pattern = boresight_pattern(sensor.spec.antenna)
        off = np.arccos(np.clip(CELLS @ pose[:, 0], -1, 1))
        height_m = self._height_m + float(pose[2, 3])
        return RadarView(2 * pattern.gain_dbi(off), pose[:, 3], *sensor.profile, sensor.tracker.blind_m,
                         (sensor.fresh_ns or 0) * 1e-9, height_m)  # fmt: skip

    def _steps(
        self, events: list[tuple[int, str, int]], chunk: Mapping[str, Frames],
        found: Mapping[str, _Found],
    ) -> Iterator[ObstacleSectors]:  # fmt: skip
        sound = self._health.judge(chunk)
        for index, (t_ns, name, row) in enumerate(events):
            hits, edges, profiles = found[name]
            if sound[name][row]:
                which = slice(edges[row], edges[row + 1])
                self._step(self._sensors[name], chunk[name], row, hits, which, profiles[row])
            if index + 1 == len(events) or events[index + 1][0] != t_ns:
                yield self.sectors(t_ns)
        self._learn(chunk)  # the pilot has its distances by now

    def _without_own_echo(self, chunk: Mapping[str, Frames]) -> Mapping[str, Frames]:
        if self.own_echo is None:
            return chunk
        for name, part in chunk.items():
            if name not in self.own_echo.found:
                self.own_echo.learn({name: part})
                self.own_echo.renew(name)
        return self.own_echo.known_removed_from(chunk)

    def _learn(self, chunk: Mapping[str, Frames]) -> None:
        """Take the frames into the estimates of the own echo; renew one of them at most, the one that waits longest."""
        if self.own_echo is None:
            return
        self.own_echo.learn(chunk)
        self._due += [name for name in chunk if name not in self._due and self.own_echo.is_due(name)]
        if self._due:
            self.own_echo.renew(self._due.pop(0))

    def _step(
        self, sensor: _Sensor, frames: Frames, row: int, hits: Detections, which: slice, profile: _Profile
    ) -> None:
        t_ns = int(frames.t_ns[row])
        motion = _motion(frames, row, sensor)
        snr = np.nan_to_num(hits.snr_db[which], nan=60.0, posinf=60.0)
        sensor.confirmed = sensor.tracker.step(t_ns, hits.range_m[which], _sigma_m(frames, snr), snr, motion)
        before, sensor.number = sensor.profile, sensor.number + 1
        passed_s = (t_ns - (sensor.fresh_ns or t_ns)) * 1e-9
        sensor.fresh_ns, sensor.profile = t_ns, profile
        place = sensor.place = self._placed(sensor, frames, row)
        for track in sensor.tracker.tracks:
            if track.seen_ns == t_ns:
                nearest = int(np.argmin(np.abs(profile.peak_m - track.measured_m)))
                track.sums.add(place, t_ns * 1e-9, track.measured_m, float(profile.peak_db[nearest]))
                here_m = (track.measured_m, track.measured_m - track.rate_m_s * passed_s)
                wrong = before and errors_of(sensor.spec, sensor.number, here_m, (profile.level_db, before.level_db),
                                             profile.range_m, sensor.tracker.blind_m)  # fmt: skip
                if wrong:
                    track.folds.add(*wrong)
        _check_mount(sensor, motion)

    def _placed(self, sensor: _Sensor, frames: Frames, row: int) -> Floats:
        """Take the body's attitude and height from a frame; return the place of the sensor (3) in the world [m]."""
        if frames.poses is None:
            return np.zeros(3)
        place, turn = frames.poses.position[row], quat_matrix(frames.poses.quat_xyzw[row])
        self._attitude = turn @ sensor.body_from_sensor[:3, :3].T
        if self.floor_z_m is not None:
            self._height_m = float((place - self._attitude @ sensor.body_from_sensor[:3, 3])[2]) - self.floor_z_m
        return np.asarray(place)

    def _check_known(self, name: str, part: Frames) -> None:
        if name not in self._sensors:
            if self.expected is not None:
                raise InputError(f"frames of an unknown radar {name!r}", where="ObstacleStage",
                                 allowed=", ".join(self.expected))  # fmt: skip
            self._sensors[name] = _sensor(part.spec, self.tracker)
        sensor = self._sensors[name]
        sensor.tracker.blind_m = blind_m(part)
        sensor.range_m = (float(part.range_m[0]), float(part.range_m[-1]))
        sensor.tracker.span_m = sensor.range_m[1] - sensor.range_m[0]


def _sensor(spec: RadarSpec, tracker: TrackerSpec) -> _Sensor:
    body_from_sensor = spec.mount.body_from_sensor()
    half = min(boresight_pattern(spec.antenna).main_lobe_rad, math.pi)
    bore, arm = body_from_sensor[:3, 0], body_from_sensor[:3, 3]
    away = math.acos(float(np.clip(bore @ arm / max(float(np.linalg.norm(arm)), 1e-12), -1, 1)))
    least_m = float(np.linalg.norm(arm)) * math.cos(min(away + half, math.pi))
    follow = RangeTracker(tracker, staggered=spec.stagger_div is not None)
    return _Sensor(spec, follow, bore.copy(), half, least_m, (0.0, math.inf), noise_correlation(spec), body_from_sensor)


def _may_be_folded(sensor: _Sensor, view: RadarView | None, track: Track) -> bool:
    """Whether a track of one pulse interval is no louder than a mirror farther by the unambiguous range would be."""
    if sensor.tracker.staggered or view is None:
        return False
    far_m = track.range_m + sensor.spec.unambiguous_range_m
    mirror_db = view.mirror_db + view.gain_db.max() - 20 * math.log10(far_m)
    return bool(track.sums.level_db <= mirror_db + 2 * LEVEL_DB)


def _lobes(boresight: Floats, width_rad: Floats) -> Bools:
    """Return which cells (k, n) the main lobes of radars hold."""
    return np.asarray(np.arccos(np.clip(boresight @ CELLS.T, -1, 1)) <= width_rad[:, None] / 2)


def _nearest(tracks: ObstacleTracks, lobes: Bools) -> Longs:
    """Return the nearest track (k) in each of some lobes (k, n); the number of tracks where there is none."""
    cells = tracks.cells if tracks.cells is not None else np.zeros((len(tracks), len(CELLS)), bool)
    touch = (lobes.astype(np.float32) @ cells.T.astype(np.float32)) > 0
    far = np.append(np.where(touch, tracks.distance_m, np.inf), np.full((len(lobes), 1), np.inf), axis=1)
    far[:, -1] = np.finfo(float).max
    return np.asarray(far.argmin(axis=1))


def _profiles(part: Frames) -> list[_Profile]:
    """Return the profile of every frame."""
    level = 20 * np.log10(np.maximum(envelope(part).astype(np.float64), 1e-30))
    noise = 20 * np.log10(profile_noise(part) * math.sqrt(2))
    mirror = 20 * math.log10(mirror_m(part))
    return [
        _Profile(part.range_m, row, *bearings.peaks_of(part.range_m, row), float(one), mirror)
        for row, one in zip(level, noise, strict=True)
    ]


def _detections(part: Frames, pfa: float, correlation: Complexes) -> Detections:
    method: Any = "os-cfar" if has_phase(part) else "peaks"
    return detect(part, method=method, pfa=pfa, train=_TRAIN, quantile=_QUANTILE, correlation=correlation,
                  remove_own_echo=False)  # fmt: skip


def _sigma_m(frames: Frames, snr_db: Floats) -> Floats:
    """Standard deviation of a peak's range (d) [m]: noise on the Gaussian pulse, and a tenth of a bin of the fit."""
    pulse_m = frames.spec.pulse_sigma_s * C0 / 2
    bin_m = float(frames.range_m[1] - frames.range_m[0])
    return np.asarray(np.hypot(pulse_m / np.sqrt(2 * 10 ** (snr_db / 10)), max(0.1 * bin_m, 0.01)))


def _motion(frames: Frames, row: int, sensor: _Sensor) -> Motion:
    if frames.poses is None:
        return Motion(np.zeros(3), sensor.boresight, sensor.half_lobe_rad)
    velocity, _ = frames.poses.rates
    boresight = quat_matrix(frames.poses.quat_xyzw[row])[:, 0]
    return Motion(velocity[row], boresight, sensor.half_lobe_rad)


def _check_mount(sensor: _Sensor, motion: Motion) -> None:
    """Compare the strongest echo of a sensor that points up or down with its mount: the floor or ceiling shows it."""
    vertical = float(motion.velocity[2] * motion.boresight[2])
    if abs(motion.boresight[2]) < 0.8 or abs(vertical) < 0.2 or not sensor.confirmed:
        return
    strongest = max(sensor.confirmed, key=lambda track: track.snr_db)
    ratio = strongest.closing_m_s / vertical
    spread = 2 * math.sqrt(strongest.var_v) / abs(vertical)
    sensor.right_way += ratio - spread > 0.3
    sensor.wrong_way += ratio + spread < -0.3
    if sensor.wrong_way >= 10 and sensor.wrong_way > 4 * sensor.right_way:
        sensor.fault = "its strongest echo recedes where the mount says that it approaches: mounted upside down?"
