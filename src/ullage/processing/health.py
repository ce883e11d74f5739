"""Health of the radars as they fly: which frames were really received, and since when a radar receives none.

A frame is sound if it shows that the radar received it. Three tests need no scene: receiver noise never repeats, the
direct path from transmitter to receiver never ends, and few samples reach the greatest value. A radar is faulty once it
has given no sound frame for `LIMIT_S`, whatever the cause. It is sound again with the next sound frame.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ullage.arrays import Bools, Floats
from ullage.data import Frames, Recording, sensors_of
from ullage.flow import Stage
from ullage.processing.baseband import has_phase, is_amplitude
from ullage.processing.echoes import FALSE_ALARM

LIMIT_S = 0.5
"""Without a sound frame for so long, a radar is faulty; slow radars have four of their periods [s]."""
DROP_DB = 10.0
"""A direct path so far below its least level so far is gone; those of recordings vary by 3.4 dB [X4Recordings]."""
KNOWN_FRAMES, KNOWN_M = 16, 0.3
"""Frames and track after which the level of the direct path is known: echoes near the radar have changed by then."""
FULL_SCALE, CLIPPED = 0.995, 0.05
"""Share of the greatest value that counts as full scale, and of samples there that make a frame saturated."""
LEAST_NOISE = 1e-6
"""Share of the greatest value below which a quarter of the samples holds no noise: receivers have 120 dB at most."""
STUCK, SILENT, DEAF, LEVEL = "stuck", "without a signal", "deaf", "its direct path is gone"
CLIPS, MISSING = "saturated", "no frames came"
_QUARTER = {True: 0.7585, False: 0.3186}  # lower quartile of the size of complex and of real noise, in sigmas


@dataclass(frozen=True, slots=True)
class Fault:
    """The times in which a radar gave no sound frame for one cause."""

    sensor: str
    cause: str
    from_ns: int  # first frame that was not sound, or the last one before they ended
    to_ns: int | None  # next sound frame; None: it lasts
    times: int = 1
    lasted_ns: int = 0  # all times together that are over

    def line(self, zero_ns: int) -> str:
        """One line for people, with times since `zero_ns` [s]."""
        often = f" {self.times:,} times" if self.times > 1 else ""
        begun = f"{self.sensor}: {self.cause}{often} from {(self.from_ns - zero_ns) * 1e-9:.1f} s"
        if self.to_ns is None:
            return begun
        ended = f"{begun} to {(self.to_ns - zero_ns) * 1e-9:.1f} s"
        return f"{ended}, {self.lasted_ns * 1e-9:.1f} s in all" if often else ended

    def again(self, from_ns: int, to_ns: int | None) -> Fault:
        """The same with one more time."""
        lasted_ns = self.lasted_ns + (0 if to_ns is None else to_ns - from_ns)
        return replace(self, to_ns=to_ns, times=self.times + 1, lasted_ns=lasted_ns)


@dataclass(slots=True)
class _Sensor:
    """What is known of one radar."""

    first_ns: int
    last_ns: int  # of its last frame
    sound_ns: int | None = None  # of its last sound frame
    period_ns: float = 0.0
    cause: str = ""  # of the frames since then
    since_ns: int | None = None  # the first of them
    sample: NDArray[Any] | None = None  # of the last frame that differed from the one before
    place: Floats | None = None  # at which it was received
    frames: int = 0
    flown_m: float = 0.0
    least: float = np.inf  # level of the direct path


@dataclass(slots=True)
class HealthMonitor(Stage):
    """Judge each frame of each radar as it comes; as a stage of a run it gives no results.

    Where `RadarSpec.noise` is None, silence is normal, and frames may repeat while the radar rests.

    Args:
        limit_s: without a sound frame for so long, a radar is faulty [s].
    """

    limit_s: float = LIMIT_S
    _sensors: dict[str, _Sensor] = field(default_factory=dict)
    _past: dict[tuple[str, str], Fault] = field(default_factory=dict)  # by radar and cause
    _latest: tuple[Any, dict[str, Bools]] = (None, {})

    def judge(self, chunk: Mapping[str, Frames]) -> dict[str, Bools]:
        """Whether each frame (n) of each radar is sound; the same chunk again costs nothing."""
        if self._latest[0] is not chunk:
            self._latest = chunk, {name: self._judged(name, part) for name, part in chunk.items()}
        return self._latest[1]

    def sound(self, chunk: dict[str, Frames]) -> dict[str, Frames]:
        """The sound frames of a chunk; the chunk itself where all are."""
        sound = self.judge(chunk)
        if all(rows.all() for rows in sound.values()):
            return chunk
        return {name: part[sound[name]] for name, part in chunk.items() if sound[name].any()}

    def update(self, chunk: dict[str, Frames]) -> Iterable[Any]:
        """Judge a chunk."""
        self.judge(chunk)
        return ()

    def fault(self, name: str, t_ns: int | None = None) -> str:
        """Why a radar is faulty at a time [ns]; "" where it is sound or gave no frames yet.

        Args:
            name: of the radar.
            t_ns: not before its last frame; None: that of the newest frame of all radars.
        """
        one, now = self._sensors.get(name), self._newest_ns if t_ns is None else t_ns
        if one is None or now - self._begun(one) <= self._limit_ns(one):
            return ""
        return one.cause or MISSING

    def faulty(self) -> list[str]:
        """The radars that are faulty now, each with its cause."""
        return [f"{name} {why}" for name in self._sensors if (why := self.fault(name))]

    @property
    def _newest_ns(self) -> int:
        return max((one.last_ns for one in self._sensors.values()), default=0)

    def faults(self) -> list[Fault]:
        """What was wrong so far, one for each radar and cause, in order of their first time."""
        found = dict(self._past)
        for name, one in self._sensors.items():
            if cause := self.fault(name):
                _note(found, name, cause, self._begun(one) if one.since_ns is None else one.since_ns, None)
        return sorted(found.values(), key=lambda fault: (fault.from_ns, fault.sensor))

    def lines(self) -> list[str]:
        """The same for people, in seconds since the first frame: "left: deaf from 12.4 s"."""
        zero_ns = min((one.first_ns for one in self._sensors.values()), default=0)
        return [fault.line(zero_ns) for fault in self.faults()]

    def _begun(self, one: _Sensor) -> int:
        return one.first_ns if one.sound_ns is None else one.sound_ns

    def _limit_ns(self, one: _Sensor) -> float:
        return max(self.limit_s * 1e9, 4 * one.period_ns)

    def _judged(self, name: str, part: Frames) -> Bools:
        one = self._sensors.setdefault(name, _Sensor(int(part.t_ns[0]), int(part.t_ns[0])))
        size = np.abs(part.samples)
        moved = _moved(part, one)
        stuck = _repeats(part, one, moved)
        causes = _heard(part, size, one, moved)
        causes[stuck & (causes == "")] = STUCK
        for t_ns, cause in zip(part.t_ns.tolist(), causes.tolist(), strict=True):
            self._take(name, one, t_ns, cause)
        return np.asarray(causes == "")

    def _take(self, name: str, one: _Sensor, t_ns: int, cause: str) -> None:
        if t_ns < one.last_ns:  # its clock was set back
            one.last_ns = one.first_ns = t_ns
            one.sound_ns = one.since_ns = None
        gap_ns = t_ns - one.last_ns
        if gap_ns > self._limit_ns(one) and one.frames > 2:
            if not one.cause:
                _note(self._past, name, MISSING, one.last_ns, t_ns)
        elif one.frames:
            one.period_ns += (gap_ns - one.period_ns) / min(one.frames, KNOWN_FRAMES)
        one.last_ns, one.frames = t_ns, one.frames + 1
        if cause:
            one.since_ns = t_ns if one.since_ns is None else one.since_ns
            one.cause = cause
            return
        if one.since_ns is not None and t_ns - self._begun(one) > self._limit_ns(one):
            _note(self._past, name, one.cause, one.since_ns, t_ns)
        one.sound_ns, one.cause, one.since_ns = t_ns, "", None


def _note(faults: dict[tuple[str, str], Fault], name: str, cause: str, from_ns: int, to_ns: int | None) -> None:
    """Add one time of a fault to those of its radar and cause, so that they do not grow with a long flight."""
    known = faults.get((name, cause))
    lasted_ns = 0 if to_ns is None else to_ns - from_ns
    faults[name, cause] = known.again(from_ns, to_ns) if known else Fault(name, cause, from_ns, to_ns, 1, lasted_ns)


def judged(frames: Recording) -> tuple[list[Frames], list[str]]:
    """The sound frames of a recording, by radar, and a line for each fault."""
    monitor, out = HealthMonitor(), []
    for part in sensors_of(frames):
        rows = monitor.judge({part.sensor: part})[part.sensor]
        out += [part] if rows.all() else [part[rows]] if rows.any() else []
    return out, monitor.lines()


def _moved(part: Frames, one: _Sensor) -> Floats:
    """Track from each frame's predecessor to it (n) [m]; enough where poses are unknown."""
    if part.poses is None:
        return np.full(len(part), KNOWN_M)
    place = part.poses.position
    before = place[:1] if one.place is None else one.place[None]
    one.place = place[-1].copy()
    return np.asarray(np.linalg.norm(np.diff(place, axis=0, prepend=before), axis=1))


def _is_noisy(part: Frames) -> bool:
    """Whether the receiver adds noise, so that no two frames are the same."""
    noise = part.spec.noise
    return noise is not None and (part.spec.thesis.noise_sigma if is_amplitude(part) else noise.thermal) > 0


def _holds_noise(size: NDArray[np.floating]) -> Bools:
    """Whether samples of these sizes (n, b) hold noise at all: profiles that somebody computed may be ideal."""
    quarter = max(size.shape[1] // 4, 1)
    return np.asarray(np.partition(size, quarter, axis=1)[:, quarter] > LEAST_NOISE * size.max(axis=1))


def _repeats(part: Frames, one: _Sensor, moved: Floats) -> Bools:
    """Whether each frame (n) is the one before it once more, where it must differ."""
    before = part.samples[:1] if one.sample is None else one.sample[None]
    same = (part.samples == np.concatenate([before, part.samples[:-1]])).all(axis=1)
    same[0] &= one.sample is not None
    one.sample = part.samples[-1].copy()
    if _is_noisy(part):
        return np.asarray(same & _holds_noise(np.abs(part.samples)))
    # without noise a frame repeats while the radar rests, and stays empty where nothing is in range
    return np.asarray(same & has_phase(part) & (moved > 0) & part.samples.any(axis=1))


def _heard(part: Frames, size: NDArray[np.floating], one: _Sensor, moved: Floats) -> NDArray[np.str_]:
    """Why each frame (n) does not show that it was received; "" where it does."""
    out = np.full(len(part), "", "<U32")
    noise = part.spec.noise
    top = size.max(axis=1)
    out[((size >= FULL_SCALE * top[:, None]).mean(axis=1) > CLIPPED) & (top > 0)] = CLIPS
    if not _is_noisy(part) or noise is None:
        return out
    if noise.leakage and has_phase(part):
        quarter = max(size.shape[1] // 4, 1)
        sigma = np.partition(size, quarter, axis=1)[:, quarter] / _QUARTER[np.iscomplexobj(part.samples)]
        clear = np.sqrt(-2 * np.log(FALSE_ALARM)) * sigma
        out[top <= clear] = DEAF
        near = size[:, part.range_m <= part.spec.own_echo_m]
        if near.shape[1]:
            level = np.sqrt((near**2).mean(axis=1))
            out[(out == "") & _is_gone(np.where(out == "", level, np.inf), one, moved)] = LEVEL
    out[top == 0] = SILENT
    return out


def _is_gone(level: Floats, one: _Sensor, moved: Floats) -> Bools:
    """Whether the direct path of each frame (n), by its level, lies far below all that came before."""
    gone = np.zeros(len(level), bool)
    drop = 10 ** (-DROP_DB / 20)
    for i in range(len(level)):
        one.flown_m += float(moved[i])
        known = one.frames + i >= KNOWN_FRAMES and one.flown_m >= KNOWN_M
        gone[i] = known and level[i] < drop * one.least
        if not gone[i]:
            one.least = min(one.least, float(level[i]))
    return gone
