"""The radar's own echo: direct path, ring-down and echoes of the body that carries it, estimated and removed.

The own echo moves with the sensor, so it is the same in every frame up to one complex gain. Echoes of the world change
their phase as the sensor moves: over different places they average out, unless their range stays constant. A wall
that is parallel to a straight track is the one case in which both look alike; `OwnEcho.ambiguity` measures it.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ullage.arrays import Bools, Complexes, Floats
from ullage.data import Frames, Recording, joined, makes_room, one_sensor, sensors_of
from ullage.geometry import C0
from ullage.processing.baseband import has_phase, to_baseband
from ullage.processing.echoes import BLIND_M

_PLACE = 0.25  # side of a place in wavelengths: frames of one place count once
_LEAST_FRAMES = 3  # fewer have no statistics
_LEAST_PLACES = 8  # fewer places cannot show what moves with the track
_MOST_FRAMES = 600  # used for one estimate
_MOST_PLACES = 20_000  # that are known again: 200 m of track
_ROUNDS, _REFINEMENTS = 12, 2  # of the robust mean; of the gains
_STEADY = 5.0  # bins whose own echo exceeds its variation by this factor give the gain of a frame
_SEPARABLE = 0.95  # a wall's mean phasor above which it is not separable from the own echo
_EXPLAINED = 0.5  # share of what remains that a wall must explain before it is held against the own echo
_OVER_NOISE = 12.0  # of a mean's power over that of the noise left in it
_MARGIN = 1.3  # on the steadiness that a wall may have
_LARGEST_CHANGE = 0.3  # of a frame's gain; a larger one is not believed


@dataclass(frozen=True, slots=True, eq=False)
class OwnEcho:
    """Estimate of one radar's own echo, and how well the track separates it from the world."""

    sensor: str
    range_m: Floats  # (b) [m]
    profile: Complexes  # (b) complex baseband that is removed, in the frames' unit
    received_db: Floats  # (b) mean power received, over distinct places [dB]
    remaining_db: Floats  # (b) the same after removal [dB]
    extent_m: float  # range up to which everything that moves with the sensor is removed [m]
    ambiguity: float  # 0..1: largest share of a world echo's amplitude that may pass as own echo beyond the extent
    energy_share: float  # 0..1: share of the received energy that was removed
    places: int  # distinct places (a quarter wave wide) behind the estimate; 0: unknown poses
    steady: Bools = field(repr=False)  # (b) bins that give the gain of each frame

    @property
    def level_db(self) -> Floats:
        """Level of the removed profile at each range (b) [dB]."""
        return np.asarray(20 * np.log10(np.maximum(np.abs(self.profile), 1e-15)))

    def removed_from(self, frames: Frames) -> Frames:
        """Subtract the own echo, scaled to each frame by one complex gain (drift, jitter of phase and amplitude).

        Samples that are exactly zero stay so: dropped packets leave them.
        """
        if not self.profile.any() or not has_phase(frames):
            return frames
        here = frames.samples != 0
        own = here * self.profile
        if self.steady.any():
            values = to_baseband(frames)[:, self.steady]
            own *= _gains(values, self.profile[self.steady], here[:, self.steady])[:, None]
        if np.iscomplexobj(frames.samples):
            return replace(frames, samples=(frames.samples - own).astype(np.complex64))
        up = np.exp(4j * np.pi * frames.spec.center_hz / C0 * frames.range_m)  # from baseband to RF
        return replace(frames, samples=(frames.samples - (own * up).real).astype(np.float32))


def own_echo(frames: Frames) -> OwnEcho:
    """Estimate the radar's own echo from a recording.

    Each place counts once, however long the sensor hovers there. The estimate is the geometric median over places of
    every range bin, after each frame's common gain has been divided out. Up to `RadarSpec.own_echo_m` all of it is
    taken as own echo. Beyond, only what exceeds the mean that a reflector at rest could leave on this track.

    Args:
        frames: one sensor's frames; without poses, or of fewer than eight places, only the direct path is taken.
            Nothing is estimated from fewer than three frames or three known places, from amplitudes without phase,
            from samples that are not finite, or where `spec.noise` says that there is no direct path.
    """
    if not _expected(one_sensor(frames, "own_echo")):
        return _none(frames)
    frames, places = _distinct(frames)
    if frames.poses is not None and places < _LEAST_FRAMES:
        return _none(frames)
    values = np.asarray(to_baseband(frames), np.complex128)
    moved = places >= _LEAST_PLACES
    extent_m = frames.spec.own_echo_m if moved else min(frames.spec.own_echo_m, BLIND_M)
    phasors = _wall_phasors(frames) if moved else np.ones((len(frames), 1), np.complex128)
    ambiguity = float(np.abs(phasors.mean(axis=0)).max())
    common, steady = _common(values, frames.range_m <= extent_m)
    level = values if not steady.any() else values / _gains(values[:, steady], common[steady])[:, None]
    profile = _without_walls(level, common, phasors)
    share = np.maximum(frames.range_m <= extent_m, _unexplained(level, ambiguity))
    profile = profile * np.where(_significant(level), share, 0.0)
    found = OwnEcho(
        frames.sensor, frames.range_m, profile, _power_db(values), _power_db(values), extent_m, ambiguity, 0.0,
        places if frames.poses is not None else 0, steady,
    )  # fmt: skip
    rest = np.asarray(to_baseband(found.removed_from(frames)))
    before, after = float(np.sum(np.abs(values) ** 2)), float(np.sum(np.abs(rest) ** 2))
    return replace(found, remaining_db=_power_db(rest), energy_share=max(0.0, 1 - after / max(before, 1e-300)))


def without_own_echo(frames: Recording) -> list[Frames]:
    """Remove each radar's own echo, estimated from these very frames."""
    return [own_echo(part).removed_from(part) for part in sensors_of(frames)]


class OwnEchoFilter:
    """Estimate and remove the own echo of every sensor as frames come, in bounded memory.

    The estimate uses one frame of each place seen so far, and is renewed when their number has grown by a factor.

    Args:
        most: places that are remembered for each sensor.
        growth: that factor; a larger one costs less time and follows later.
    """

    def __init__(self, *, most: int = _MOST_FRAMES, growth: float = 1.1) -> None:
        self._most = most
        self._growth = growth
        self._kept: dict[str, _Places] = {}
        self._last: tuple[Any, dict[str, Frames]] = (None, {})
        self.found: dict[str, OwnEcho] = {}

    def learn(self, chunk: Mapping[str, Frames]) -> None:
        """Take these frames into the estimate."""
        for name, part in chunk.items():
            self._kept.setdefault(name, _Places()).add(part, self._most)

    def removed_from(self, chunk: Mapping[str, Frames]) -> dict[str, Frames]:
        """Remove the present estimate of the own echo from sensors that have one."""
        for name in chunk:
            if self.is_due(name):
                self.renew(name)
        return self.known_removed_from(chunk)

    def known_removed_from(self, chunk: Mapping[str, Frames]) -> dict[str, Frames]:
        """Remove the estimates as they are; frames of a sensor without one stay as they are."""
        return {name: self.found[name].removed_from(part) if name in self.found else part
                for name, part in chunk.items()}  # fmt: skip

    def is_due(self, name: str) -> bool:
        """Whether there is no estimate of a sensor yet, or one from far fewer places than are remembered."""
        return name not in self.found or len(self._kept[name]) >= self._growth * self._kept[name].used

    def renew(self, name: str) -> None:
        """Estimate the own echo of a sensor from all places that are remembered."""
        kept = self._kept[name]
        kept.used = len(kept)
        kept.pieces = [joined(kept.pieces)]
        self.found[name] = own_echo(kept.pieces[0])

    def clean(self, chunk: Mapping[str, Frames]) -> dict[str, Frames]:
        """Learn from a chunk and remove the own echo from it; the same chunk again costs nothing."""
        if self._last[0] is not chunk:
            self.learn(chunk)
            self._last = chunk, self.removed_from(chunk)
        return self._last[1]


@dataclass(slots=True)
class _Places:
    """One frame of each place of a track; of unknown poses every so-manieth frame."""

    pieces: list[Frames] = field(default_factory=list)
    seen: dict[tuple[int, ...], None] = field(default_factory=dict)  # the last places, in order
    stride: int = 1
    count: int = 0
    used: int = 0

    def __len__(self) -> int:
        return sum(map(len, self.pieces))

    def add(self, part: Frames, most: int) -> None:
        if not has_phase(part):
            self.pieces = self.pieces or [part[np.array([0])]]
            return
        if not makes_room(self.pieces, part):
            return
        new = []
        for i, place in enumerate(_places_of(part)):
            if place not in self.seen:
                self.seen[place] = None
                new.append(i)
            if len(self.seen) > _MOST_PLACES:
                del self.seen[next(iter(self.seen))]
        if kept := new[-self.count % self.stride :: self.stride]:
            self.pieces.append(part[np.array(kept)])  # a copy: a view would keep the whole piece
        self.count += len(new)
        if len(self) > most:
            whole = joined(self.pieces)
            self.pieces, self.stride = [whole[np.arange(0, len(whole), 2)]], 2 * self.stride
            self.used = 0


def _places_of(frames: Frames) -> list[tuple[int, ...]]:
    if frames.poses is None:
        return [(int(t),) for t in frames.t_ns]
    side = _PLACE * frames.spec.wavelength_m
    return list(map(tuple, np.floor(frames.poses.position / side).astype(int).tolist()))


def _distinct(frames: Frames) -> tuple[Frames, int]:
    """The first frame of each place, thinned evenly, and the number of places (1 for unknown poses)."""
    first = np.array(sorted({place: i for i, place in reversed(list(enumerate(_places_of(frames))))}.values()))
    places = 1 if frames.poses is None else len(first)
    if frames.poses is not None and places < _LEAST_PLACES:
        first = np.arange(len(frames))
    return frames[first[:: max(1, -(-len(first) // _MOST_FRAMES))]], places


def _expected(frames: Frames) -> bool:
    noise = frames.spec.noise
    leaks = noise is not None and noise.leakage and has_phase(frames)
    return leaks and len(frames) >= _LEAST_FRAMES and bool(np.isfinite(frames.samples).all())


def _none(frames: Frames) -> OwnEcho:
    level = 20 * np.log10(np.maximum(np.sqrt(np.mean(np.abs(frames.samples) ** 2, axis=0)), 1e-15))
    nothing = np.zeros(len(frames.range_m))
    return OwnEcho(
        frames.sensor, frames.range_m, nothing.astype(complex), level, level, 0.0, 0.0, 0.0, 0, nothing.astype(bool)
    )


def _power_db(values: NDArray[Any]) -> Floats:
    return np.asarray(10 * np.log10(np.maximum(np.mean(np.abs(values) ** 2, axis=0), 1e-30)))


def _common(values: Complexes, near: Bools) -> tuple[Complexes, Bools]:
    """The profile that all frames (n, b) share up to a gain each, and the bins (b) steady enough to show the gain."""
    mean = _median(values)
    steady = np.zeros(len(mean), bool)
    for _ in range(_REFINEMENTS):
        steady = near & (np.abs(mean) > _STEADY * np.median(np.abs(values - mean), axis=0))
        if np.count_nonzero(steady) < 3 or len(values) < 3:
            return mean, np.zeros(len(mean), bool)
        mean = _median(values / _gains(values[:, steady], mean[steady])[:, None])
    return mean, steady


def _median(values: Complexes) -> Complexes:
    """The geometric median (b) of complex values (n, b), by Weiszfeld's iteration."""
    out = values.mean(axis=0)
    least = 1e-3 * np.sqrt(np.mean(np.abs(values) ** 2, axis=0)) + 1e-30
    for _ in range(_ROUNDS):
        weight = 1 / np.maximum(np.abs(values - out), least)
        out = (weight * values).sum(axis=0) / weight.sum(axis=0)
    return np.asarray(out)


def _gains(values: NDArray[Any], profile: Complexes, here: Bools | None = None) -> Complexes:
    """The complex gain (n) that fits a profile (s) best to each frame (n, s); 1 where it is far from that.

    `here` (n, s) says which samples were received.
    """
    power = np.abs(profile) ** 2
    total = power.sum() if here is None else here @ power
    gain = (values if here is None else values * here) @ profile.conj() / np.maximum(total, 1e-300)
    return np.asarray(np.where(np.abs(gain - 1) < _LARGEST_CHANGE, gain, 1.0))


def _wall_phasors(frames: Frames) -> Complexes:
    """The phases (n, d) that a flat wall's echo has along the track, for directions d about across the track.

    Only these directions matter: an echo from elsewhere turns many times along the track and averages out.
    """
    place = frames.believed.position - frames.believed.position.mean(axis=0)
    axes = np.linalg.svd(place, full_matrices=False)[2]
    around = np.linspace(0, np.pi, 48, endpoint=False)
    across = np.cos(around)[:, None] * axes[2] + np.sin(around)[:, None] * axes[1]
    across = np.concatenate([across, -across])
    lobe = frames.spec.wavelength_m / 4 / max(float(np.ptp(place @ axes[0])), 1e-6)
    direction = (across[:, None] + lobe * np.linspace(-1, 1, 9)[:, None] * axes[0]).reshape(-1, 3)
    direction /= np.linalg.norm(direction, axis=1, keepdims=True)
    turn = 4j * np.pi / frames.spec.wavelength_m * place @ direction.T
    # the sum changes nothing, but right after OpenBLAS' zgemm the exponential takes ten times as long
    return np.asarray(np.exp(turn + 0.0))


def _without_walls(values: Complexes, common: Complexes, phasors: Complexes) -> Complexes:
    """The common profile (b) without the part that a flat wall leaves in it.

    Least squares of x_n = g + a e_n in each bin, e_n being the wall phase that fits the remainder best: the means
    m = g + a rho and c = a + g conj(rho) give g = (m - rho c) / (1 - |rho|^2).
    """
    rest = values - common
    projected = phasors.conj().T @ rest / len(values)
    best = np.argmax(np.abs(projected), axis=0)
    bins = np.arange(len(common))
    rho = phasors.mean(axis=0)[best]
    across = np.maximum(1 - np.abs(rho) ** 2, 1e-9)
    mean = rest.mean(axis=0)
    wall = (projected[best, bins] - rho.conj() * mean) / across
    own = mean - rho * wall
    fitted = np.mean(np.abs(rest - own - wall * phasors[:, best]) ** 2, axis=0)
    explains = fitted < (1 - _EXPLAINED) * np.mean(np.abs(rest) ** 2, axis=0)
    return np.asarray(common + np.where(explains & (np.abs(rho) < _SEPARABLE), own, 0))


def _significant(values: Complexes) -> Bools:
    """Where the mean of frames (n, b) stands out of what they differ by (b): noise alone does in e^-12 of all bins."""
    mean = values.mean(axis=0)
    spread = np.mean(np.abs(values - mean) ** 2, axis=0) / max(len(values) - 1, 1)
    return np.asarray(np.abs(mean) ** 2 > _OVER_NOISE * spread)


def _unexplained(values: Complexes, ambiguity: float) -> Floats:
    """The part of the mean (b) that no reflector at rest leaves on this track."""
    power = np.maximum(np.mean(np.abs(values) ** 2, axis=0), 1e-300)
    steadiness = np.maximum(np.abs(values.mean(axis=0)) ** 2 / power, 1e-30)
    return np.asarray(np.clip(1 - (_MARGIN * ambiguity**2 + _OVER_NOISE / len(values)) / steadiness, 0.0, 1.0))
