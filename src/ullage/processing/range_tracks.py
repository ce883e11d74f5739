"""Tracks of echoes in range: Kalman filters of range and closing speed, with gates, birth and death.

Each track is a constant-velocity filter [BarShalomEtAl2001, ch. 6]. A change of the sensor's own velocity is known
from odometry and moves the predicted closing speed. A radar without bearing does not know by how much, so the part of
that change across the boresight counts as process noise. A track is confirmed by M hits in N frames, and by a score:
the logarithm of how much likelier its detections are from one obstacle than from unrelated echoes [Blackman1986].
Among many echoes this keeps out tracks that jump from one echo to the next. A confirmed track ends when it has no more
than M hits in 2 N frames.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field, replace

import numpy as np
from pydantic import Field

from ullage.arrays import Floats
from ullage.processing.bearings import PathSums
from ullage.processing.fold_levels import FoldErrors
from ullage.specs import Spec

_EVERY_SECOND = int("01" * 32, 2)


class TrackerSpec(Spec):
    """Settings of the range tracker."""

    acceleration_m_s2: float = Field(1.0, gt=0, le=50, description="of obstacles along the range, sigma")
    obstacle_speed_m_s: float = Field(
        1.0, ge=0, le=50, description="of obstacles themselves, sigma before the first fit"
    )
    gate_sigma: float = Field(3.5, gt=0, le=10, description="how far a detection may lie from its track")
    odds: float = Field(300.0, ge=1, le=1e9, description="how much likelier one obstacle is than unrelated echoes")
    hits: int = Field(3, ge=1, le=20, description="M: detections that confirm a track")
    window: int = Field(5, ge=1, le=30, description="N: among so many frames")
    coast_s: float = Field(0.4, gt=0, le=10, description="a track without detections lives so long")
    blind_s: float = Field(5.0, gt=0, le=60, description="the same inside the blind range, where nothing is detected")
    most: int = Field(24, ge=1, le=200, description="tracks a sensor")


@dataclass(slots=True)
class Track:
    """Track of one echo in range."""

    number: int
    range_m: float
    rate_m_s: float  # of the range: below zero it approaches
    var_r: float  # covariance of range and rate
    cov: float
    var_v: float
    snr_db: float
    seen_ns: int
    history: int = 1  # one bit a frame, the newest lowest, of 2 N frames
    frames: int = 1  # since it began
    score: float = 0.0  # log likelihood ratio of one obstacle to unrelated echoes
    confirmed: bool = False
    measured_m: float = math.nan  # its last detection
    sums: PathSums = field(default_factory=PathSums)  # shared with what `after` returns
    folds: FoldErrors = field(default_factory=FoldErrors)  # the same

    @property
    def closing_m_s(self) -> float:
        """Closing speed [m/s], above zero where the obstacle approaches."""
        return -self.rate_m_s

    def after(self, time_s: float, noise: float) -> Track:
        """Predict the track at a later time, without a new frame.

        Args:
            time_s: since its last frame [s].
            noise: variance that accelerations add to the rate in that time [m^2/s^2].
        """
        later = replace(self)
        later.move(time_s, noise)
        later.range_m = max(later.range_m, 0.0)
        return later

    def move(self, time_s: float, noise: float) -> None:
        """Predict range, rate and their covariance; arguments as for `after`."""
        self.range_m += self.rate_m_s * time_s
        self.var_r += 2 * time_s * self.cov + time_s**2 * self.var_v + noise * time_s**2 / 4
        self.cov += time_s * self.var_v + noise * time_s / 2
        self.var_v += noise


@dataclass(frozen=True, slots=True)
class Motion:
    """Odometry of a sensor at one time."""

    velocity: Floats  # (3) in the world [m/s]
    boresight: Floats  # (3) unit vector in the world
    half_lobe_rad: float  # half the opening of the main lobe


class RangeTracker:
    """Follow the echoes of one sensor.

    Args:
        spec: settings.
        blind_m: range below which the sensor detects nothing [m].
        span_m: length of the range axis [m].
        staggered: the pulse interval alternates from frame to frame, so a folded echo is there in every second frame.
    """

    def __init__(
        self, spec: TrackerSpec | None = None, *, blind_m: float = 0.0, span_m: float = 10.0, staggered: bool = False
    ) -> None:
        self.spec = spec or TrackerSpec()
        self.blind_m, self.span_m, self.staggered = blind_m, span_m, staggered
        self.tracks: list[Track] = []
        self._last_ns: int | None = None
        self._velocity = np.zeros(3)
        self._count = 0

    def step(self, t_ns: int, range_m: Floats, sigma_m: Floats, snr_db: Floats, motion: Motion) -> list[Track]:
        """Predict all tracks to a frame and update them with its detections.

        Args:
            t_ns: time of the frame [ns]; at or before the last one, the tracker restarts.
            range_m: ranges of the detections (d) [m].
            sigma_m: their standard deviations (d) [m].
            snr_db: their levels over noise (d) [dB].
            motion: of the sensor.

        Returns:
            The confirmed tracks, nearest first.
        """
        if self._last_ns is not None and t_ns <= self._last_ns:
            self.tracks, self._last_ns = [], None
        if self._last_ns is not None:
            self._predict((t_ns - self._last_ns) * 1e-9, motion)
        self._last_ns, self._velocity = t_ns, motion.velocity
        free = self._associate(t_ns, range_m, sigma_m, snr_db)
        self._end_tracks(t_ns)
        for k in free[: max(0, self.spec.most - len(self.tracks))]:
            self._begin(t_ns, float(range_m[k]), float(sigma_m[k]), float(snr_db[k]), motion)
        self.tracks.sort(key=lambda track: track.range_m)
        return [track for track in self.tracks if track.confirmed and track.folds.log_odds <= math.log(self.spec.odds)]

    def _predict(self, dt: float, motion: Motion) -> None:
        change = motion.velocity - self._velocity
        along = float(change @ motion.boresight)
        across = max(float(change @ change) - along**2, 0.0)
        spread = across + (along * math.sin(min(motion.half_lobe_rad, math.pi / 2))) ** 2
        noise = self.spec.acceleration_m_s2**2 * dt**2
        missed = math.log(max(1 - self.spec.hits / self.spec.window, 0.05))  # hits in so many frames are expected
        for track in self.tracks:
            track.rate_m_s -= along
            track.move(dt, noise)
            track.var_v += spread
            track.score += 0.0 if track.history & 1 else missed
            track.history = (track.history << 1) & ((1 << 2 * self.spec.window) - 1)
            track.frames += 1

    def _associate(self, t_ns: int, range_m: Floats, sigma_m: Floats, snr_db: Floats) -> list[int]:
        """Update each track with the detection nearest to it; the detections that no track took, nearest first."""
        free = list(range(len(range_m)))
        if self.tracks and free:
            place = np.array([track.range_m for track in self.tracks])
            var = np.array([track.var_r for track in self.tracks])
            apart = (range_m[None, :] - place[:, None]) ** 2 / (var[:, None] + sigma_m[None, :] ** 2)
            confirmed = np.array([track.confirmed for track in self.tracks])
            inside = apart <= self.spec.gate_sigma**2
            unexplained = int((~inside[confirmed].any(0)).sum())
            clutter_m = max(unexplained, 1) / self.span_m  # echoes a metre
            # a confirmed track chooses before one that may be a false alarm
            rank = np.where(inside, apart + np.where(confirmed, 0.0, 1e6)[:, None], np.inf)
            while np.isfinite(rank).any():
                i, k = divmod(int(np.argmin(rank)), rank.shape[1])
                track, sigma = self.tracks[i], float(sigma_m[k])
                density = math.exp(-apart[i, k] / 2) / math.sqrt(2 * math.pi * (track.var_r + sigma**2))
                track.score += math.log(max(density / clutter_m, 1e-9))
                self._update(track, t_ns, float(range_m[k]), sigma, float(snr_db[k]))
                rank[i, :] = rank[:, k] = np.inf
                free.remove(k)
        return free

    def _update(self, track: Track, t_ns: int, range_m: float, sigma_m: float, snr_db: float) -> None:
        total = track.var_r + sigma_m**2
        gain_r, gain_v, error = track.var_r / total, track.cov / total, range_m - track.range_m
        track.range_m += gain_r * error
        track.rate_m_s += gain_v * error
        track.var_v -= gain_v * track.cov
        track.cov *= 1 - gain_r
        track.var_r *= 1 - gain_r
        track.snr_db, track.seen_ns, track.measured_m = snr_db, t_ns, range_m
        track.history |= 1
        often = self._recent_hits(track) >= self.spec.hits and track.score >= math.log(self.spec.odds)
        track.confirmed = track.confirmed or often or self.spec.hits == 1

    def _end_tracks(self, t_ns: int) -> None:
        kept = []
        for track in self.tracks:
            missed_s = (t_ns - track.seen_ns) * 1e-9
            if track.confirmed:
                # an obstacle may touch the hull unseen: its range stays at zero, not below
                track.range_m = max(track.range_m, 0.0)
                hidden = track.range_m < self.blind_m
                seldom = track.frames >= 2 * self.spec.window and self._hits(track.history) <= self.spec.hits
                alive = missed_s <= (self.spec.blind_s if hidden else 0.0 if seldom else self.spec.coast_s)
            else:
                alive = (
                    track.range_m > 0
                    and self._recent_hits(track) + max(self.spec.window - track.frames, 0) >= self.spec.hits
                )
            if alive:
                kept.append(track)
        self.tracks = kept

    def _recent_hits(self, track: Track) -> int:
        """Hits in the last N frames."""
        return self._hits(track.history & ((1 << self.spec.window) - 1))

    def _hits(self, history: int) -> int:
        """Hits in a history; of a staggered radar no more than what the rarer of its two intervals allows."""
        if not self.staggered:
            return history.bit_count()
        odd = (history & _EVERY_SECOND).bit_count()
        return min(history.bit_count(), 2 * min(odd, history.bit_count() - odd) + 1)

    def _begin(self, t_ns: int, range_m: float, sigma_m: float, snr_db: float, motion: Motion) -> None:
        rate = -float(motion.velocity @ motion.boresight)
        var_v = float(motion.velocity @ motion.velocity) + max(self.spec.obstacle_speed_m_s, 0.1) ** 2
        self._count += 1
        self.tracks.append(
            Track(
                self._count,
                range_m,
                rate,
                sigma_m**2,
                0.0,
                var_v,
                snr_db,
                t_ns,
                measured_m=range_m,
                confirmed=self.spec.hits == 1,
            )
        )
