"""Which frames count as looks: a sensor is heard again only after it has moved, and with the frames around it."""

from __future__ import annotations

import math
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from ullage.arrays import Bools, Floats
from ullage.data import Frames
from ullage.geometry import quat_matrix
from ullage.kernels.occupancy_listen import find_peaks, fit_bearings, focus_echoes
from ullage.processing.baseband import envelope
from ullage.processing.echoes import blind_m, echo_level

MOST_PEAKS = 16
STEP_M, TURN_RAD = 0.05, np.radians(4.0)
LOOK_SHARE = 0.4
WINDOW_M = 0.2
LEAST_ASIDE, SPARSE_M = 2, 0.35
BEND_M = 0.02
STRAIGHT_RAD = 0.05
LEAST_BASE_M = 0.12
JUMP_M = 0.5
MOST_WAITING = 96
MOST_SPOTS = 200_000
DENSE_M, MOST_DENSE = 0.06, 2.5
SMOOTH = 0.25
STILL_M, STILL_RAD = 0.004, np.radians(1.0)
WANDER_M, PAUSE_NS = 0.01, 500_000_000
GATE_M, LEAST_SIGMA_M = 0.03, 0.004
LEAST_SMOOTHED, ROUGH_M, SMOOTH_M = 8, 1e-3, 0.3


@dataclass(slots=True, eq=False)
class Heard:
    """One frame as the mapper keeps it."""

    t_ns: int
    position: Floats  # (3)
    axes: Floats  # (3, 3) world_from_sensor
    count: int
    ranges: Floats  # (MOST_PEAKS)
    heights: Floats  # (MOST_PEAKS)
    quiet: Bools  # (b)
    samples: NDArray[np.complex64] | None  # (b) where there is a phase
    smooth: Floats = field(default_factory=lambda: np.zeros(3))  # position without the single pose's noise [m]
    look: bool = False
    step_m: float = 0.0  # from the look before


@dataclass(slots=True, eq=False)
class Look:
    """A frame that counts, with its echoes: range, sigma, cosine to the track, sigma, share, height."""

    heard: Heard
    track: Floats  # (3) unit vector along the way, zero when there was none
    echoes: Floats  # (k, 6)
    sharp: (
        Floats  # (k, 5) coherence, cosine where it is best, its sigma, coherence as wall and as point; 0 without phase
    )
    wobble: float = 0.0  # doubt in the track's direction [rad]

    def only(self, keep: Bools) -> Look:
        """The same look with some of its echoes."""
        return Look(self.heard, self.track, self.echoes[keep], self.sharp[keep], self.wobble)


class Listener:
    """Turns one sensor's frames into looks; a look waits until the frames around it are there.

    A frame becomes a look when the (smoothed) pose has moved 5 cm or turned 4 deg since the last one, to a place and
    heading where no look was taken before: standing still, or coming back, adds nothing.
    """

    def __init__(self, start_m: float, bin_m: float, wavelength_m: float) -> None:
        self._start, self._bin, self._wavenumber = start_m, bin_m, 2 * np.pi / wavelength_m
        self._held: list[Heard] = []
        self._next = 0
        self._smooth: Floats | None = None
        self._rest = np.zeros(3)
        self._last: tuple[Floats, Floats] | None = None
        self._spots: dict[tuple[int, ...], None] = {}
        self.heard_ns = 0

    @property
    def pending_ns(self) -> int:
        """Time before which no look will be completed any more [ns]."""
        return next((one.t_ns for one in self._held[self._next :] if one.look), self.heard_ns + 1)

    def hear(self, frames: Frames) -> list[Look]:
        """The looks that these frames complete."""
        out: list[Look] = []
        for heard in _heard(frames):
            self.heard_ns = heard.t_ns
            if self._held and _apart(heard.position, self._held[-1].position) > JUMP_M:
                out += self.flush()
            before = heard.position if self._smooth is None else self._smooth
            self._smooth = before + SMOOTH * (heard.position - before)
            if self._held and self._still(heard, self._smooth):
                continue
            self._rest = self._smooth
            heard.smooth = self._smooth
            apart = 0.0 if self._last is None else _apart(self._smooth, self._last[0])
            heard.look = self._counts(heard, self._smooth)
            heard.step_m = apart
            self._held.append(heard)
            out += self._ready(patient=True)
        return out

    def flush(self) -> list[Look]:
        """The looks that still waited, with what is there; nothing is joined across."""
        out = self._ready(patient=False)
        self._held, self._next, self._smooth, self._last = [], 0, None, None
        return out

    def _still(self, heard: Heard, smooth: Floats) -> bool:
        """Whether a frame adds nothing: it has not moved on, or wanders about places that are held already."""
        last = self._held[-1]
        if _apart(smooth, self._rest) < STILL_M and heard.axes[:, 0] @ last.axes[:, 0] > np.cos(STILL_RAD):
            return True
        before = self._held[:-1]
        near = [one for one in before if _apart(smooth, one.smooth) < WANDER_M]
        return any(heard.axes[:, 0] @ one.axes[:, 0] > np.cos(STILL_RAD) for one in near)

    def _counts(self, heard: Heard, smooth: Floats) -> bool:
        if self._last is not None:
            moved = _apart(smooth, self._last[0]) >= STEP_M
            if not moved and heard.axes[:, 0] @ self._last[1] > np.cos(TURN_RAD):
                return False
        heading = np.rint(heard.axes[:, 0] / TURN_RAD).astype(int)
        spot = (*np.floor(smooth / STEP_M).astype(int).tolist(), *heading.tolist())
        if spot in self._spots:
            return False
        self._last = smooth.copy(), heard.axes[:, 0].copy()
        self._spots[spot] = None
        if len(self._spots) > MOST_SPOTS:
            del self._spots[next(iter(self._spots))]
        return True

    def _ready(self, *, patient: bool) -> list[Look]:
        out = []
        while self._next < len(self._held):
            heard = self._held[self._next]
            if heard.look:
                ahead = _apart(self._held[-1].position, heard.position)
                after = len(self._held) - 1 - self._next
                if patient and (ahead < WINDOW_M or after < LEAST_ASIDE) and after < MOST_WAITING:
                    break
                out.append(self._look(self._next))
            self._next += 1
        drop = 0
        if self._next:
            here = self._held[min(self._next, len(self._held) - 1)].position
            while drop < self._next and (
                _apart(self._held[drop].position, here) > 1.5 * WINDOW_M or self._next - drop > MOST_WAITING
            ):
                drop += 1
        del self._held[:drop]
        self._next -= drop
        return out

    def _look(self, index: int) -> Look:
        heard, window = self._held[index], self._window(index)
        offsets, shift, wobble = self._offsets(index, window)
        heard = replace(heard, position=heard.position + shift)
        span = np.linalg.norm(offsets, axis=1)
        track = offsets[int(np.argmax(span))] / max(span.max(), 1e-9)
        along = offsets @ track
        aside = np.linalg.norm(offsets - along[:, None] * track, axis=1)
        straight = aside < BEND_M + wobble * WINDOW_M
        straight[window.index(index)] = True
        window, along = [j for j, ok in zip(window, straight, strict=True) if ok], along[straight]
        echoes, count = np.zeros((MOST_PEAKS, 6)), heard.count
        sharp = np.zeros((count, 5))
        if np.ptp(along) < LEAST_BASE_M:
            echoes[:count, 0], echoes[:count, 5] = heard.ranges[:count], heard.heights[:count]
            return Look(heard, np.zeros(3), echoes[:count], sharp, wobble)
        bend = float(aside[straight].max()) / (0.5 * float(np.ptp(along)))
        wobble = float(np.hypot(wobble, max(bend - max(wobble, STRAIGHT_RAD), 0.0)))
        counts = np.array([self._held[j].count for j in window])
        ranges = np.stack([self._held[j].ranges for j in window])
        heights = np.stack([self._held[j].heights for j in window])
        fit_bearings(window.index(index), along, counts, ranges, heights, GATE_M, LEAST_SIGMA_M, echoes)
        rows = [r for r in (self._held[j].samples for j in window) if r is not None]
        if rows:
            focus_echoes(np.stack(rows), along, self._start, self._bin, self._wavenumber, echoes[:count], sharp)
        return Look(heard, track, echoes[:count], sharp, wobble)

    def _offsets(self, index: int, window: list[int]) -> tuple[Floats, Floats, float]:
        """Positions (m, 3) about the look's own, how far that was moved, and the doubt left in the track's direction.

        A body's path is smooth, a tracker's noise is not: where the positions scatter by over a millimetre about a low
        polynomial of time, the polynomial is believed. It has the lowest order that fits nearly as well as a cubic.
        """
        here = self._held[index]
        wide = sorted({*self._window(index, reach_m=SMOOTH_M), *window})
        raw = np.array([self._held[j].position for j in wide]) - here.position
        pick = np.searchsorted(wide, window)
        if len(wide) < LEAST_SMOOTHED:
            return raw[pick], np.zeros(3), 0.0
        t = np.array([self._held[j].t_ns - here.t_ns for j in wide], float)
        t /= max(float(abs(t).max()), 1.0)
        found, rough, order = smoothest(t, raw)
        if rough < ROUGH_M:
            return raw[pick], np.zeros(3), 0.0
        shift = found[wide.index(index)]
        span = max(float(np.ptp(np.linalg.norm(found - shift, axis=1))), STEP_M)
        return found[pick] - shift, shift, order * 1.7 * rough / (np.sqrt(len(t)) * span)

    def _go_on(self, at: int, before: int, index: int, reach_m: float) -> bool:
        """Whether one more held frame belongs to the same stretch of flight: near, and without a pause between.

        Where frames are sparse, the nearest on each side may lie farther off: a bearing takes five.
        """
        one, pause = self._held[at], abs(self._held[at].t_ns - self._held[before].t_ns)
        reach_m = max(reach_m, SPARSE_M) if abs(at - index) <= LEAST_ASIDE else reach_m
        return bool(pause < PAUSE_NS and _apart(one.position, self._held[index].position) <= reach_m)

    def _window(self, index: int, *, reach_m: float = WINDOW_M) -> list[int]:
        """Indices of some 21 held frames within reach on both sides, up to a pause; fewer where there are fewer."""
        first = last = index
        while first > 0 and self._go_on(first - 1, first, index, reach_m):
            first -= 1
        while last + 1 < len(self._held) and self._go_on(last + 1, last, index, reach_m):
            last += 1
        stride = max(1, -(-(last - first) // round(100 * reach_m)))
        return sorted({*range(first, last + 1, stride), index})


def _apart(one: Floats, other: Floats) -> float:
    """Distance of two places (3), as np.linalg.norm has it but in a fourth of its time."""
    gap = one - other
    return math.sqrt(gap.dot(gap))


def dense_looks(step_m: float) -> float:
    """How many looks of a dense flight, 6 cm apart, one stands for so far from the one before: it shares less with it.

    To a tenth, lest steps that are alike count a hair differently.
    """
    return round(min(max(step_m / DENSE_M, 1.0), MOST_DENSE), 1)


def lit_ways(axes: Floats, track: Floats, cosine: float, least: float) -> list[Floats]:
    """Level directions (3) at this cosine to the track whose cosine to boresight is over `least`."""
    level = np.array([track[0], track[1], 0.0])
    level /= max(float(np.linalg.norm(level)), 1e-9)
    across = np.array([-level[1], level[0], 0.0])
    off = np.sqrt(max(1 - cosine**2, 0.0))
    both = [cosine * level + sign * off * across for sign in (-1, 1)]
    return [way for way in both if way @ axes[:, 0] > least]


def ways_apart(axes: Floats, arc: Floats, least: float) -> float:
    """How far apart lie the two places that a bearing leaves open, zero where only one is lit [m].

    Args:
        axes: (3, 3) world_from_sensor.
        arc: range, its sigma, track (3), cosine to it, and more.
        least: cosine to boresight above which a direction is lit.
    """
    lit = lit_ways(axes, arc[2:5], float(arc[5]), least)
    return float(arc[0]) * float(np.linalg.norm(lit[1] - lit[0])) if len(lit) == 2 else 0.0


def smoothest(t: Floats, values: Floats) -> tuple[Floats, float, int]:
    """Values (n, 3) of the lowest polynomial in t that fits within 15 % as well as a cubic; its scatter and order."""
    fits = []
    for order in (1, 2, 3):
        basis = np.vander(t, order + 1, increasing=True)
        fitted = basis @ np.linalg.lstsq(basis, values, rcond=None)[0]
        fits.append((fitted, float(np.sqrt(np.sum((fitted - values) ** 2) / (3 * (len(t) - order - 1)))), order))
    return next(fit for fit in fits if fit[1] <= 1.15 * fits[-1][1])


def _heard(frames: Frames) -> list[Heard]:
    amplitude = np.ascontiguousarray(envelope(frames), np.float32)
    n, bins = amplitude.shape
    counts, quiet = np.zeros(n, np.int64), np.zeros((n, bins), bool)
    ranges, heights = np.zeros((n, MOST_PEAKS)), np.zeros((n, MOST_PEAKS))
    step = float(frames.range_m[-1] - frames.range_m[0]) / (bins - 1)
    first, level = int(np.searchsorted(frames.range_m, blind_m(frames))), echo_level(frames).astype(np.float32)
    find_peaks(amplitude, level, first, float(frames.range_m[0]), step, counts, ranges, heights, quiet)
    path = frames.believed
    axes = quat_matrix(path.quat_xyzw)
    phased = frames.samples if np.iscomplexobj(frames.samples) else [None] * n
    return [
        Heard(
            int(frames.t_ns[i]), path.position[i], axes[i], int(counts[i]), ranges[i], heights[i], quiet[i], phased[i]
        )
        for i in range(n)
    ]


def look_share(step_m: float) -> float:
    """Share of a look's log-odds that are its own, and not those of the look before, so far from it."""
    return min(LOOK_SHARE * max(step_m, STEP_M) / STEP_M, 1.0)
