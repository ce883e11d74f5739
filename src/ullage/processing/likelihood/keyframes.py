"""Frames that arrive in pieces, as apertures about the keyframes of the track."""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Iterator
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray
from scipy.special import ndtri

from ullage.antenna import boresight_pattern
from ullage.arrays import Floats, Longs
from ullage.data import Frames
from ullage.geometry import C0, quat_matrix
from ullage.kernels.matched_sums import GAIN_CELLS, Aperture
from ullage.processing.echoes import BLIND_M
from ullage.processing.intake import from_ahead
from ullage.processing.likelihood.spec import LikelihoodSpec

UPSAMPLING = 2  # of range bins, so that linear interpolation between them is good to 1 %
LATEST_NS = 10_000_000_000  # a sensor that lags by more is not waited for
NEVER_NS = -(2**62)
GAP_NS = 1_000_000_000  # without frames of the leading sensor, after which another one leads
NORMAL_MAD = 1.4826  # standard deviation of normal noise over its median absolute deviation
BEATS = 16  # frames over which the time from frame to frame is averaged
FOLDED = 2.0  # most rows of half an aperture, over those of a straight track: a hover is no endless aperture
COS_TURN = math.cos(math.radians(3.0))  # a frame counts after such a turn, too


@dataclass(frozen=True, slots=True, eq=False)
class Row:
    """One frame, ready to be summed."""

    t_ns: int
    position: Floats  # (3) [m]
    axis: Floats  # (3) boresight
    turn: Floats  # (3, 3) world from sensor
    samples: NDArray[np.complex64]  # (b) baseband
    noise: float  # amplitude of the noise in one bin
    gap_ns: int  # since the frame before it
    second: bool  # it has the second of two pulse intervals, or the first: which one is not known


@dataclass(slots=True, eq=False)
class Channel:
    """What is known of one sensor."""

    order: tuple[float, str]  # among the sensors, whichever comes first
    start_m: float  # range of bin 0
    bin_m: float  # after upsampling
    gains: Floats  # two-way amplitude gain against 1 - cosine to boresight
    wavelength_m: float
    envelope: bool  # samples are amplitudes without phase
    own_m: float  # range that the own echo may cover: silence there shows nothing
    mount_sigma: tuple[float, float]  # of the position [m] and the boresight [rad]
    pulse_m: float  # standard deviation of the pulse's envelope
    folds_m: tuple[float, ...]  # unambiguous ranges of its pulse intervals, which alternate from frame to frame
    rows: deque[Row] = field(default_factory=deque)
    near: deque[tuple[Floats, Floats]] = field(default_factory=deque)  # place and boresight of the rows near the last
    seen_ns: int = NEVER_NS  # time of its last frame
    waited_ns: int = 0  # longest time without a frame since the last row
    led_ns: int = NEVER_NS  # time of the last row with which it led: it does not lead with that again
    beat_ns: float = 0.0  # time from frame to frame
    second: bool = False  # of its last frame, as of `Row`
    taken: int = 0  # rows so far
    own_sum: complex | NDArray[np.inexact] = 0.0  # sum of the samples of these within `BLIND_M`
    own_power: float = 0.0  # sum of their squares

    def subtract_own(self, samples: NDArray[np.inexact]) -> None:
        """Subtract what all rows so far have in common within `BLIND_M`, in place.

        What frames still hold of the own echo there would ring in the spectrum that upsampling widens. The mean counts
        by the share of the power that is coherent from row to row, so echoes that pass stay as they are.
        """
        blind = samples[: max(math.ceil((BLIND_M - self.start_m) / (UPSAMPLING * self.bin_m)), 0)]
        self.taken, self.own_sum = self.taken + 1, self.own_sum + blind
        self.own_power += float(np.vdot(blind, blind).real)
        if self.taken > 1 and self.own_power > 0:
            # 1 of noise, `taken` of an own echo
            coherent = float(np.vdot(self.own_sum, self.own_sum).real) / self.own_power
            blind[:] = blind - max(coherent - 1, 0.0) / (self.taken - 1) / self.taken * self.own_sum

    def count(self, t_ns: int) -> None:
        """Take the time of another frame; those that were lost count, too."""
        since_ns = t_ns - self.seen_ns
        if self.seen_ns > NEVER_NS and since_ns > 0:
            self.beat_ns = self.beat_ns or since_ns
            frames = max(round(since_ns / self.beat_ns), 1)
            self.beat_ns += (since_ns / frames - self.beat_ns) / BEATS
            self.second ^= len(self.folds_m) == 2 and frames % 2 == 1
        self.seen_ns = t_ns


@dataclass(frozen=True, slots=True, eq=False)
class Keyframe:
    """An aperture and the place it lies about."""

    position: Floats  # (3) [m]
    aperture: Aperture
    start_m: float  # range of bin 0
    bin_m: float
    noise: float
    first_bin: int  # beyond the direct path
    silent_bin: int  # beyond the own echo
    mount_sigma_m: float
    mount_sigma_rad: float
    pulse: float  # standard deviation of the pulse's envelope [bin]
    wavelength_m: float
    turns: Floats  # (s, 3, 3) world from sensor, of each sensor's frame nearest in time
    radar: Longs  # (s) number of the radar: one with two pulse intervals is two sensors
    interval: Longs  # (s) 0 or 1 of these; -1 with one only
    folds: tuple[float, float]  # ranges from which echoes fold, with each of two pulse intervals [bin]
    t_ns: int
    names: tuple[str, ...]  # of the radars: those with a frame in the aperture

    @property
    def first(self) -> Longs:
        """The first sensor (r) of each radar."""
        return np.unique(self.radar, return_index=True)[1]

    def of_radars(self, sums: Floats) -> Floats:
        """Sums (r, k) over the sensors of each radar, of sums (s, k) of sensors."""
        out = np.zeros((self.radar[-1] + 1, sums.shape[1]))
        np.add.at(out, self.radar, sums)
        return out


class KeyframeSelector:
    """Collects frames of all sensors and gives a keyframe each time its aperture is complete.

    The first sensor leads, and another one where its frames end: a keyframe is a frame of it that has moved by
    `keyframe_m`. The aperture holds the frames of
    all sensors in the time for which the leading sensor stays within `window_m`. A keyframe waits until every sensor
    has passed that time, so pieces of any size give the same keyframes.
    """

    def __init__(self, spec: LikelihoodSpec) -> None:
        self._spec = spec
        self._of_sums = float(-ndtri(math.exp(-spec.least_snr))) / math.sqrt(spec.least_snr)
        self._channels: dict[str, Channel] = {}
        self._leading = ""
        self._next = 0  # index of the leading row that may become the next keyframe
        self._last: Row | None = None

    def add(self, part: Frames) -> None:
        """Take frames of one sensor; those near to one of the same pass are left out."""
        channel = self._channels.get(part.sensor)
        if channel is None:
            channel = _channel_of(part)
            known = {**self._channels, part.sensor: channel}
            self._channels = dict(sorted(known.items(), key=lambda one: one[1].order))
        path = part.believed
        turns = quat_matrix(path.quat_xyzw)
        axes = turns[:, :, 0]
        for i in range(len(part)):
            gap_ns = int(part.t_ns[i]) - channel.seen_ns if channel.seen_ns > NEVER_NS else 0
            gap_ns = max(gap_ns, channel.waited_ns)
            channel.count(int(part.t_ns[i]))
            channel.waited_ns = gap_ns
            near, here = channel.near, path.position[i]
            while near and math.dist(near[0][0], here) >= self._spec.window_m:
                near.popleft()
            if any(self._is_near(row, here, axes[i]) for row in reversed(near)):
                continue
            near.append((here, axes[i]))
            samples = np.array(part.samples[i])
            samples, noise = self._above_noise(samples, channel) if channel.envelope else (samples, _noise(samples))
            channel.subtract_own(samples)
            given = path.position[i], axes[i], turns[i], _upsampled(samples), noise, gap_ns, channel.second
            row = Row(channel.seen_ns, *given)
            channel.rows.append(row)
            channel.waited_ns = 0

    def _above_noise(self, samples: NDArray[np.floating], channel: Channel) -> tuple[NDArray[np.floating], float]:
        """Amplitudes (b) less what noise alone gives, and the noise of equal false alarms in sums with phase.

        An envelope of noise has a Rayleigh distribution, whose median is within 6 % of its mean. The own echo cannot be
        subtracted without phase. It is left out, for its end would ring in the spectrum that upsampling widens.
        """
        above = samples - np.median(samples)
        noise = self._of_sums * NORMAL_MAD * float(np.median(np.abs(above)))
        above[: max(math.ceil((channel.own_m - channel.start_m) / (UPSAMPLING * channel.bin_m)), 0)] = 0
        return above, noise

    def _is_near(self, row: tuple[Floats, Floats], position: Floats, axis: Floats) -> bool:
        return math.dist(position, row[0]) < self._spec.spacing_m and float(axis @ row[1]) >= COS_TURN

    def ready(self, *, finish: bool = False) -> Iterator[Keyframe]:
        """The keyframes whose apertures are complete; at the end those that are left."""
        if not self._channels:
            return
        if self._last is None:
            begun = {name: each.rows[0].t_ns for name, each in self._channels.items() if each.rows}
            self._leading = min(begun, key=begun.__getitem__, default=next(iter(self._channels)))
        while self._leads() or self._hand_over(finish=finish):
            rows = self._channels[self._leading].rows
            centre = rows[self._next]
            self._channels[self._leading].led_ns = centre.t_ns
            if self._last is not None and np.linalg.norm(centre.position - self._last.position) < self._spec.keyframe_m:
                self._next += 1
                continue
            first, last, closed = self._span(rows, self._next)
            if not (finish or (closed and self._all_past(rows[last].t_ns))):
                break
            self._last = centre
            key = self._keyframe(centre, rows[first].t_ns, rows[last].t_ns)
            self._drop_before(rows[first].t_ns)
            yield key

    def _leads(self) -> bool:
        """Whether the leading sensor has a next row, without a gap before it."""
        rows = self._channels[self._leading].rows
        return self._next < len(rows) and (self._last is None or rows[self._next].gap_ns <= GAP_NS)

    def _hand_over(self, *, finish: bool) -> bool:
        """Let another sensor lead where the frames of the leading one pause or end."""
        leader, last = self._channels[self._leading], self._last
        waits = self._next >= len(leader.rows)
        newest = max(channel.seen_ns for channel in self._channels.values())
        if last is None or (waits and newest - leader.seen_ns <= (GAP_NS if finish else LATEST_NS)):
            return False
        until_ns = newest if waits else leader.rows[self._next].t_ns
        for name, channel in self._channels.items():
            since_ns = max(last.t_ns, channel.led_ns)
            later = [k for k, row in enumerate(channel.rows) if since_ns < row.t_ns < until_ns]
            if channel is not leader and later and channel.rows[later[0]].gap_ns <= GAP_NS:
                self._leading, self._next = name, later[0]
                self._last = _nearest(channel, last.t_ns)
                return True
        return not waits

    def _span(self, rows: deque[Row], index: int) -> tuple[int, int, bool]:
        """First and last row about `index` within the window, and whether no later row can be."""
        here, reach = rows[index].position, self._spec.window_m
        most = math.ceil(FOLDED * reach / self._spec.spacing_m)
        first = last = index
        while first > max(index - most, 0) and np.linalg.norm(rows[first - 1].position - here) < reach:
            first -= 1
        end = min(index + most, len(rows) - 1)
        while last < end and np.linalg.norm(rows[last + 1].position - here) < reach:
            last += 1
        return first, last, last == index + most or last + 1 < len(rows)

    def _all_past(self, t_ns: int) -> bool:
        newest = max(channel.seen_ns for channel in self._channels.values())
        return all(channel.seen_ns > t_ns or newest - t_ns > LATEST_NS for channel in self._channels.values())

    def _drop_before(self, t_ns: int) -> None:
        for name, channel in self._channels.items():
            while channel.rows and channel.rows[0].t_ns < t_ns:
                channel.rows.popleft()
                self._next -= name == self._leading

    def _keyframe(self, centre: Row, first_ns: int, last_ns: int) -> Keyframe:
        heard = {
            name: each
            for name, each in self._channels.items()
            if any(first_ns <= row.t_ns <= last_ns for row in each.rows)
        }
        channels, leader = list(heard.values()), self._channels[self._leading]
        radar = np.repeat(np.arange(len(channels)), [len(channel.folds_m) for channel in channels])
        two = np.bincount(radar)[radar] == 2
        interval = np.where(two, np.append(False, radar[1:] == radar[:-1]), -1)
        folds_m = max((channel.folds_m for channel in channels), key=len)
        picked = [
            (s, row)
            for s, (of, which) in enumerate(zip(radar.tolist(), interval.tolist(), strict=True))
            for row in channels[of].rows
            if first_ns <= row.t_ns <= last_ns and row.second == (which == 1)
        ]
        samples = np.stack(
            [_on_axis(row.samples, channels[radar[s]], leader, len(centre.samples)) for s, row in picked]
        )
        place = _middle(channels, centre.t_ns)
        offset = np.stack([row.position - place for _, row in picked]) / leader.bin_m
        axes = np.zeros((len(radar), 3))
        for s, row in picked:
            axes[s] += row.axis
        axes /= np.maximum(np.linalg.norm(axes, axis=1, keepdims=True), 1e-12)
        gains = np.stack([channel.gains for channel in channels])[radar]
        phase = 0.0 if leader.envelope else 4 * np.pi / leader.wavelength_m * leader.bin_m
        pairs = np.ascontiguousarray(np.stack([samples.real, samples.imag], axis=-1), np.float32)
        moment = np.unique([row.t_ns for _, row in picked], return_inverse=True)[1]
        sensor = np.array([s for s, _ in picked])
        blind_m = max(channel.own_m if channel.envelope else min(channel.own_m, BLIND_M) for channel in channels)
        return Keyframe(
            place,
            Aperture(
                pairs, offset, sensor, axes, gains, phase, moment, np.zeros((3, 3)), np.ones(1), np.zeros(len(radar))
            ),
            leader.start_m,
            leader.bin_m,
            float(np.median([row.noise for _, row in picked])),
            max(int((blind_m - leader.start_m) / leader.bin_m), 0),
            max(int((max(channel.own_m for channel in channels) - leader.start_m) / leader.bin_m), 0),
            max(channel.mount_sigma[0] for channel in channels),
            max(channel.mount_sigma[1] for channel in channels),
            leader.pulse_m / leader.bin_m,
            leader.wavelength_m,
            np.stack([_nearest(one, centre.t_ns).turn for one in channels])[radar],
            radar,
            interval,
            (folds_m[0] / leader.bin_m, folds_m[-1] / leader.bin_m),
            centre.t_ns,
            tuple(heard),
        )


def _noise(samples: NDArray[np.complex64]) -> float:
    """Root of the mean power of complex noise, from the median amplitude."""
    return float(np.median(np.abs(samples)) / math.sqrt(math.log(2)))


def _middle(channels: list[Channel], t_ns: int) -> Floats:
    """Mean of the sensors' positions (3) at a time [m]."""
    return np.asarray(np.mean([_nearest(one, t_ns).position for one in channels], axis=0))


def _nearest(channel: Channel, t_ns: int) -> Row:
    return min(channel.rows, key=lambda row: abs(row.t_ns - t_ns))


def _channel_of(part: Frames) -> Channel:
    step = float(part.range_m[-1] - part.range_m[0]) / (len(part.range_m) - 1)
    pattern = boresight_pattern(part.spec.antenna)
    cosine = 1 - 2 * np.linspace(0, 1, GAIN_CELLS + 1)
    gains = 10 ** (2 * (pattern.gain_dbi(np.arccos(cosine)) - pattern.peak_dbi) / 20)
    spec = part.spec
    pulse_m = spec.pulse_sigma_s * C0 / 2
    start_m, envelope = float(part.range_m[0]), not np.iscomplexobj(part.samples)
    mount = spec.mount.position_sigma_m, math.radians(spec.mount.angle_sigma_deg)
    given = (
        from_ahead(part),
        start_m,
        step / UPSAMPLING,
        gains,
        spec.wavelength_m,
        envelope,
        spec.own_echo_m,
        mount,
        pulse_m,
    )
    fold_m, other = spec.unambiguous_range_m, (spec.stagger_div or spec.prf_div) / spec.prf_div
    return Channel(*given, (fold_m,) if other == 1 else (fold_m, other * fold_m))


def _upsampled(samples: NDArray[np.inexact]) -> NDArray[np.complex64]:
    """Samples (b) at twice the rate, by zeros in the middle of their spectrum."""
    bins = len(samples)
    half = bins // 2
    spectrum, wide = np.fft.fft(samples), np.zeros(UPSAMPLING * bins, np.complex128)
    wide[:half], wide[half - bins :] = spectrum[:half], spectrum[half:]
    return np.asarray(np.fft.ifft(wide) * UPSAMPLING, np.complex64)


def _on_axis(samples: NDArray[np.complex64], mine: Channel, leader: Channel, bins: int) -> NDArray[np.complex64]:
    """Samples on the leading sensor's range axis."""
    if (mine.start_m, mine.bin_m, len(samples)) == (leader.start_m, leader.bin_m, bins):
        return samples
    wanted = leader.start_m + leader.bin_m * np.arange(bins)
    have = mine.start_m + mine.bin_m * np.arange(len(samples))
    return np.asarray(np.interp(wanted, have, samples, 0, 0), np.complex64)
