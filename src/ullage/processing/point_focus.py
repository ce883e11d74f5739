"""Clock and range offset from scatterers that stay coherent along a track.

Strong scatterers are found by back-projecting short parts of the aperture. Each is then followed along all of the
track. Its place is fitted anew for every value of the offsets, so that no value gains from where the place was drawn.
With coherence g over n independent samples its log-likelihood is -n log(1 - g): a steady point in white noise of
unknown power, with both amplitudes at their maximum likelihood [Kay1998].
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from ullage.arrays import Complexes, Floats, Longs
from ullage.data import Frames, Trajectory
from ullage.geometry import quat_matrix, rpy_quat
from ullage.kernels.backprojection import Pattern, Profiles, Rows, Track, backproject_rows
from ullage.processing.backprojection import oversampled, oversampling
from ullage.processing.baseband import to_baseband
from ullage.processing.motion_match import whole_frames

if TYPE_CHECKING:
    from scipy.sparse import csr_array

SEGMENT_WAVELENGTHS = 20.0  # part of the track that one seed is drawn from: a range offset hardly defocuses it
CELL_WAVELENGTHS, HEIGHTS = 0.8, 5  # of the search for seeds in such parts: cells, and heights on either side
CELLS = 1.5e8  # cell times frames over all segments, which bounds the time
REACH_M, LEAST_RANGE_M = 6.0, 0.5
SEED_COHERENCE = 0.35
SEEDS_PER_SEGMENT, MOST_SEEDS, MOST_POINTS = 12, 40, 16
SAME_M = 0.06  # two places whose ranges differ by less than this are one echo
VELOCITY_S = 0.01  # half the time over which a velocity is taken
PARAMETERS = 9  # that move a path: see `path_slopes`
CLOCK, RATE, RANGE, ARM, BORESIGHT, SCALE = 0, 1, 2, slice(3, 6), slice(6, 8), 8
VISIBLE_M = 0.35  # length of track over which the amplitude of an echo is taken as steady


@dataclass(frozen=True, slots=True, eq=False)
class Point:
    """A scatterer, and how its amplitude varies along the track."""

    place: Floats  # (3) world [m]
    amplitude: Floats  # (n) relative, 0 where it is not seen
    gain: float  # log-likelihood over noise


@dataclass(frozen=True, slots=True, eq=False)
class Start:
    """Start of the search for a scatterer: as measured by the radar, independent of the offsets."""

    ray: Floats  # (3) direction from the track, world
    bin_m: float  # range on the frames' own axis [m]
    along_m: float  # travelled distance at which it was found [m]


def path_slopes(velocity: Floats, spin: Floats, body: Floats, position: Floats, t_s: Floats) -> tuple[Floats, Floats]:
    """Displacements and rotations (n, 3, 9) of an antenna on its path per unit of the nine quantities.

    They are clock offset [s], clock rate, range offset [m], lever arm in body axes (3) [m], boresight down and
    to the left [rad], scale of the track. Echoes that are planned and those that are fitted have these slopes.

    Args:
        velocity: (n, 3) of the antenna, world [m/s].
        spin: (n, 3) angular velocity in the sensor's axes [rad/s], as are the rotations.
        body: (n, 3, 3) world_from_body.
        position: (n, 3) of the track, world [m].
        t_s: (n) time from the middle [s].
    """
    place, turn = np.zeros((2, len(t_s), 3, PARAMETERS))
    place[..., CLOCK], turn[..., CLOCK] = velocity, spin
    place[..., RATE], turn[..., RATE] = velocity * t_s[:, None], spin * t_s[:, None]
    place[..., ARM], place[..., SCALE] = body, position
    turn[..., BORESIGHT] = np.eye(3)[:, 1:]
    return place, turn


@dataclass(frozen=True, slots=True, eq=False)
class Echoes:
    """Echoes of places along a path, with their propagation phase taken off."""

    value: Complexes  # (k, n)
    slope: Complexes  # (k, n) of the value over range [1/m]
    ray: Floats  # (k, n, 3) directions from the path to the places
    level: Floats  # (k, n) typical amplitude at that range


class PointFocus:
    """Scatterers of one recording, and how well they focus.

    Args:
        frames: of one radar.
        track: world_from_sensor in its own clock.
        offset_s: approximate clock offset, which selects the frames at rest.
        finer: by how much the parts are shorter that seeds are drawn from, and the cells larger.
    """

    def __init__(self, frames: Frames, track: Trajectory, offset_s: float, *, finer: float = 1.0) -> None:
        self.finer = finer
        self.wave_m = frames.spec.wavelength_m
        self.spec, mount = frames.spec, frames.spec.mount.body_from_sensor()[:3, :3]
        self.known_s, self.position = track.t_ns * 1e-9, track.position
        self.sensor = quat_matrix(track.quat_xyzw)
        self.body, self.spin = (self.sensor @ mount.T).reshape(-1, 9), track.rates[1]
        self.t_s = t_s = frames.t_ns * 1e-9
        values, good, place = to_baseband(frames), whole_frames(frames), self.path(offset_s)
        inside = (t_s + offset_s >= self.known_s[0]) & (t_s + offset_s <= self.known_s[-1])
        step = np.r_[0.0, np.linalg.norm(np.diff(place, axis=0), axis=1)]
        along = np.cumsum(step)
        moved = np.minimum(np.gradient(along), self.wave_m / 2) * (good & inside)
        kept = np.flatnonzero(np.r_[True, np.diff(np.floor(along / (self.wave_m / 6))) > 0] & good & inside)
        if moved.sum() > 0:
            values = values - (moved @ values / moved.sum()).astype(np.complex64)
        bin_m = float(np.diff(frames.range_m).mean())
        factor = oversampling(frames.spec, bin_m)
        fine = oversampled(np.ascontiguousarray(values[kept]), factor) if len(kept) else values[:0]
        self.raw = fine
        self.level = np.maximum(np.sqrt((np.abs(fine) ** 2).sum(0) / max(len(fine), 1)), 1e-30)  # (bins)
        self.fine = fine / self.level
        self.per_m, self.first_m, self.last_m = factor / bin_m, float(frames.range_m[0]), float(frames.range_m[-1])
        self.t_s, self.along = t_s[kept], along[kept]
        self.weight = np.minimum(np.gradient(self.along), self.wave_m) if len(kept) > 2 else np.ones(len(kept))
        self.window = _neighbourhood(self.along, self.weight)
        self.per_m_phase = 4 * np.pi / self.wave_m
        change = np.diff(self.fine, axis=1) * self.per_m
        self.envelope_bend = float((np.abs(change) ** 2).sum() / max(float((np.abs(self.fine) ** 2).sum()), 1e-30))
        self.middle_s = float(self.weight @ self.t_s / max(float(self.weight.sum()), 1e-30)) if len(kept) else 0.0

    def path(self, offset_s: float) -> Floats:
        """Positions (n, 3) of the sensor under a clock offset, held beyond the ends of the track."""
        return self._at(np.asarray(self.t_s + offset_s, np.float64))

    def _at(self, when: Floats) -> Floats:
        return _interpolated(when, self.known_s, self.position)

    @property
    def _apart_s(self) -> Floats:
        return np.asarray(self.t_s - self.middle_s, np.float64)

    def _when(self, theta: Floats) -> Floats:
        return np.asarray(self.t_s + theta[CLOCK] + theta[RATE] * self._apart_s, np.float64)

    def bent(self, theta: Floats) -> Floats:
        """Positions (n, 3) of the sensor under the nine quantities; the rate of the clock is about the middle."""
        when = self._when(theta)
        path = self._at(when) * (1 + theta[SCALE])
        return np.asarray(path if not theta[ARM].any() else path + self._bodies(when) @ theta[ARM])

    def _bodies(self, when: Floats) -> Floats:
        return _interpolated(when, self.known_s, self.body).reshape(-1, 3, 3)

    def bend(self, theta: Floats) -> tuple[Floats, Floats]:
        """Displacements and rotations (n, 3, 9) of the sensor per unit of each quantity."""
        step, when = np.eye(PARAMETERS)[CLOCK] * VELOCITY_S, self._when(theta)
        velocity = (self.bent(theta + step) - self.bent(theta - step)) / (2 * VELOCITY_S)
        spin = _interpolated(when, self.known_s, self.spin)
        return path_slopes(velocity, spin, self._bodies(when), self._at(when), self._apart_s)

    def antennas(self, theta: Floats) -> Floats:
        """Rotations (n, 3, 3), world from antenna, under the nine quantities."""
        near = np.searchsorted(self.known_s, self._when(theta)).clip(0, len(self.known_s) - 1)
        return np.asarray(self.sensor[near] @ quat_matrix(rpy_quat(0.0, *theta[BORESIGHT])))

    def echoes(self, places: Floats, path: Floats, range_m: float) -> Echoes:
        """Echoes of places (k, 3) on a path (n, 3)."""
        ray = places[:, None] - path
        distance = np.linalg.norm(ray, axis=2)
        at = (distance - range_m - self.first_m) * self.per_m
        seen = (at >= 1) & (at < self.fine.shape[1] - 2.001)
        at = np.where(seen, at, 1)
        low = at.astype(int)
        share = at - low
        flat, first = self.raw.ravel(), low + self.raw.shape[1] * np.arange(distance.shape[1])
        below, here, after, above = (flat[first + k] for k in (-1, 0, 1, 2))
        turn = np.exp(1j * self.per_m_phase * distance) * seen
        slope = ((after - below) * (1 - share) + (above - here) * share) * (self.per_m / 2)
        return Echoes(
            (here * (1 - share) + after * share) * turn, slope * turn, ray / distance[..., None], self.level[low]
        )

    def seeds(self, offset_s: float, range_m: float) -> list[tuple[float, Floats, float]]:
        """Coherence, place and position along the track of what focuses over parts of the track, best first."""
        path = self.path(offset_s)
        length = float(self.along[-1] - self.along[0]) if len(self.along) else 0.0
        if length < 2 * self.wave_m:
            return []
        part = min(SEGMENT_WAVELENGTHS / self.finer * self.wave_m, length)
        centres = self.along[0] + part / 2 + (length - part) * np.linspace(0, 1, max(1, int(np.ceil(length / part))))
        spread = np.linalg.svd(path - path.mean(0), compute_uv=False) / np.sqrt(len(path))
        flat = spread[1] < self.wave_m  # a straight track sees the same from every height
        out: list[tuple[float, Floats, float]] = []
        for centre in centres:
            use = np.flatnonzero(abs(self.along - centre) < part / 2)
            use = use[:: max(1, len(use) // 45)]
            if len(use) >= 8:
                taper = np.cos(np.pi * (self.along[use] - centre) / part) ** 2 * self.weight[use]
                out += [
                    (g, c, float(centre)) for g, c in self._segment(path[use], use, taper, range_m, flat, len(centres))
                ]
        return sorted(out, key=lambda one: -one[0])[:MOST_SEEDS]

    def _segment(
        self, path: Floats, use: Longs, taper: Floats, range_m: float, flat: bool, segments: int
    ) -> list[tuple[float, Floats]]:
        """Peaks of coherence in a box around a part of the track."""
        cell, middle = CELL_WAVELENGTHS * self.finer * self.wave_m, path.mean(0)
        levels = int(HEIGHTS / self.finer)
        heights = np.zeros(1) if flat else np.arange(-levels, levels + 1) * 5.0 * cell
        reach = min(REACH_M, self.last_m + range_m)
        most = np.sqrt(CELLS / (segments * len(use) * len(heights))) * cell / 2
        half = np.arange(-min(reach, most), min(reach, most) + cell, cell)
        y, z = (a.ravel() for a in np.meshgrid(half + middle[1], heights + middle[2]))
        sums = np.zeros((len(y), 5, len(half)), np.float32)
        profile = self.fine[use]
        profiles = Profiles(
            np.ascontiguousarray(profile.real), np.ascontiguousarray(profile.imag), np.float32(self.per_m),
            np.float32((self.first_m + range_m) * self.per_m), np.float32(2 / self.wave_m),
        )  # fmt: skip
        turn = np.tile(np.eye(3), (len(use), 1, 1))
        track = Track(np.ascontiguousarray(path), turn, (taper / taper.sum()).astype(np.float32))
        rows = Rows(y, z, float(half[0] + middle[0]), float(cell))
        backproject_rows(rows, profiles, track, Pattern(*np.zeros(3, np.float32)), sums)
        coherence = (sums[:, 0] ** 2 + sums[:, 1] ** 2) / np.maximum(sums[:, 2] * sums[:, 3], 1e-12)
        x = half + middle[0]
        near = np.sqrt((x[None] - middle[0]) ** 2 + (y[:, None] - middle[1]) ** 2 + (z[:, None] - middle[2]) ** 2)
        coherence[(sums[:, 3] < 0.9) | (near < LEAST_RANGE_M)] = 0
        out: list[tuple[float, Floats]] = []
        while len(out) < SEEDS_PER_SEGMENT and coherence.max() > SEED_COHERENCE:
            row, col = np.unravel_index(int(coherence.argmax()), coherence.shape)
            place = np.array([x[col], y[row], z[row]])
            out.append((float(coherence[row, col]), place))
            gone = (x[None] - x[col]) ** 2 + (y[:, None] - y[row]) ** 2 + (z[:, None] - z[row]) ** 2 < 0.25
            coherence[gone] = 0
        return out

    def _along_points(self, places: Floats, paths: Floats, range_m: Floats) -> tuple[Complexes, Floats]:
        """Echoes (k, n) of places with their propagation phase taken off, and ranges (k, n) [m]."""
        distance = np.linalg.norm(paths - places[:, None], axis=2)
        at = (distance - range_m[:, None] - self.first_m) * self.per_m
        seen = (at >= 0) & (at < self.fine.shape[1] - 1.001)
        at = np.where(seen, at, 0)
        low = at.astype(int)
        share = at - low
        flat, first = self.fine.ravel(), low + self.fine.shape[1] * np.arange(distance.shape[1])
        value = flat[first] * (1 - share) + flat[first + 1] * share
        return value * np.exp(4j * np.pi / self.wave_m * distance) * seen, distance

    def _gains(self, value: Complexes, amplitude: Floats) -> Floats:
        """Log-likelihoods (k) of steady scatterers over noise."""
        weight = amplitude * self.weight
        energy = (amplitude * weight).sum(1) * (self.weight * np.abs(value) ** 2 * (amplitude > 0)).sum(1)
        coherence = np.minimum(np.abs((weight * value).sum(1)) ** 2 / np.maximum(energy, 1e-30), 0.9999)
        samples = weight.sum(1) ** 2 / np.maximum((amplitude * weight).sum(1), 1e-30) / (self.wave_m / 2)
        return np.asarray(-samples * np.log(1 - coherence))

    def _placed(
        self, places: Floats, amplitude: Floats, paths: Floats, range_m: Floats, *, steps: int = 8
    ) -> tuple[Floats, Floats]:
        """The places (k, 3) nearby at which the phases agree best, by Gauss-Newton, and their log-likelihoods (k)."""
        places, live = places.copy(), np.arange(len(places))
        value, distance = self._along_points(places, paths, range_m)
        best, damping = self._gains(value, amplitude), np.full(len(places), 1e-4)
        for _ in range(steps):
            ahead = paths[live] if len(paths) > 1 else paths
            move = self._step(places[live], amplitude[live], ahead, value, distance, damping[live])
            tried, apart = self._along_points(places[live] + move, ahead, range_m[live])
            found = self._gains(tried, amplitude[live])
            better = found >= best[live]
            damping[live[~better]] *= 10
            places[live[better]] += move[better]
            best[live[better]] = found[better]
            value, distance = np.where(better[:, None], tried, value), np.where(better[:, None], apart, distance)
            open_ = np.linalg.norm(move, axis=1) >= 0.006 * self.wave_m
            live, value, distance = live[open_], value[open_], distance[open_]
            if not len(live):
                break
        return places, best

    def _step(
        self, places: Floats, amplitude: Floats, paths: Floats, value: Complexes, distance: Floats, damping: Floats
    ) -> Floats:
        """Moves (k, 3) of places that make the phases agree, at most two thirds of a wavelength."""
        per_m = 4 * np.pi / self.wave_m
        weight = amplitude * self.weight
        phase = np.angle(value * np.conj((weight * value).sum(1))[:, None])
        weight = weight * np.abs(value) * (np.cos(phase) > -0.3)
        design = np.empty((*distance.shape, 4))
        design[..., :3] = per_m * (places[:, None] - paths) / distance[..., None]
        design[..., 3] = 1
        turned = np.swapaxes(design * weight[..., None], 1, 2)
        normal = turned @ design
        corner = np.arange(3)
        normal[:, corner, corner] += (damping * np.trace(normal[:, :3, :3], axis1=1, axis2=2))[:, None]
        move = -np.linalg.solve(normal + 1e-12 * np.eye(4), turned @ phase[..., None])[:, :3, 0]
        size = np.linalg.norm(move, axis=1, keepdims=True)
        return np.asarray(move * np.minimum(1.0, 0.66 * self.wave_m / np.maximum(size, 1e-9)))

    def _amplitudes(self, places: Floats, paths: Floats, range_m: Floats) -> Floats:
        """Amplitudes (k, n) of scatterers along the track over the noise around them; 0 where they are not seen."""
        value, _ = self._along_points(places, paths, range_m)
        steady = np.abs(np.asarray(self.window @ value.T)).T ** 2
        power = np.asarray(self.window @ (np.abs(value.T) ** 2)).T
        noise = np.maximum(power - steady, 1e-3 * power) * self.wave_m / (2 * 0.9 * VISIBLE_M)
        return np.where(steady > 3 * noise, np.sqrt(np.maximum(steady - noise, 0)), 0.0)

    def starts(self, offset_s: float, range_m: float) -> list[Start]:
        """Scatterers to start from, each seen from the middle of its part of the track."""
        path = self.path(offset_s)
        out = []
        for _, place, along in self.seeds(offset_s, range_m):
            ray = place - path[np.argmin(np.abs(self.along - along))]
            distance = float(np.linalg.norm(ray))
            out.append(Start(ray / distance, distance - range_m, along))
        return out

    def drawn(self, starts: Sequence[Start], offset_s: float, range_m: float) -> list[Point]:
        """The scatterer of each start under these offsets, with the part of the track from which it is seen."""
        if not starts:
            return []
        path = self.path(offset_s)
        paths, ranges = path[None], np.full(len(starts), range_m)
        along = np.array([one.along_m for one in starts])
        middle = path[np.argmin(np.abs(self.along - along[:, None]), axis=1)]
        places = middle + np.array([one.ray * (one.bin_m + range_m) for one in starts])
        near = np.exp(-(((self.along - along[:, None]) / 0.5) ** 2))
        places, gain = self._placed(places, near, paths, ranges)
        for _ in range(2):
            amplitude = self._amplitudes(places, paths, ranges)
            places, gain = self._placed(places, amplitude, paths, ranges)
        gains = np.asarray(np.where(amplitude.any(axis=1), gain, 0.0)).tolist()
        return [Point(*one) for one in zip(places, amplitude, gains, strict=True)]

    def redrawn(self, places: Floats, theta: Floats) -> tuple[Point, ...]:
        """Scatterers at these places, with the parts of the track from which they are seen; each echo once."""
        path, ranges = self.bent(theta)[None], np.full(len(places), theta[RANGE])
        amplitude = self._amplitudes(places, path, ranges)
        gain = self._gains(self._along_points(places, path, ranges)[0], amplitude)
        points = [Point(*one) for one in zip(places, amplitude, gain.tolist(), strict=True)]
        return tuple(points[k] for k in self.distinct(points, float(theta[0])))

    def distinct(self, points: Sequence[Point], offset_s: float) -> list[int]:
        """Indices of the scatterers of highest likelihood, each echo once."""
        path = self.path(offset_s)
        out: list[int] = []
        for k in np.argsort([-one.gain for one in points]):
            one = points[int(k)]
            if one.amplitude.any() and not any(self._same(one, points[other], path) for other in out):
                out.append(int(k))
            if len(out) == MOST_POINTS:
                break
        return out

    def _same(self, one: Point, other: Point, path: Floats) -> bool:
        """Return whether two places explain the same echo."""
        weight = one.amplitude * self.weight * (other.amplitude > 0)
        if not weight.any():
            return False
        apart = np.linalg.norm(path - one.place, axis=1) - np.linalg.norm(path - other.place, axis=1)
        return float(np.sqrt((weight * apart**2).sum() / weight.sum())) < SAME_M

    def brightness(self, places: Floats, offset_s: float, ranges_m: Floats) -> Floats:
        """Log-likelihood (k, places) of steady echoes at surveyed places, over noise of unit power, by range offset."""
        path, total = self.path(offset_s), max(float(self.weight.sum()), 1e-9)
        out = np.zeros((len(ranges_m), len(places)))
        for row, range_m in enumerate(ranges_m):
            for column, place in enumerate(places):
                value, _ = self._along_points(place[None], path[None], np.array([range_m]))
                out[row, column] = abs((self.weight * value[0]).sum()) ** 2 / total / (self.wave_m / 2)
        return out


def _interpolated(when: Floats, known_s: NDArray[np.floating], values: NDArray[np.floating]) -> Floats:
    """Values (n, q) at times (n) between known ones (m, q), held beyond their ends."""
    return np.stack([np.interp(when, known_s, column) for column in values.T], axis=1)


def _neighbourhood(along: Floats, weight: Floats) -> csr_array:
    """Weights (n, n) of a mean over the track near each frame; those below 1e-4 of the greatest are left out."""
    from scipy.sparse import csr_array

    width = VISIBLE_M / 2
    low, high = (np.searchsorted(along, along + side * 3 * width) for side in (-1, 1))
    count = high - low
    start = np.concatenate([[0], np.cumsum(count)])
    column = np.arange(start[-1]) + np.repeat(low - start[:-1], count)
    near = np.exp(-(((along[column] - np.repeat(along, count)) / width) ** 2)) * weight[column]
    near = near / np.repeat(np.add.reduceat(near, start[:-1]), count) if len(near) else near
    return csr_array((near, column, start), shape=(len(along), len(along)))
