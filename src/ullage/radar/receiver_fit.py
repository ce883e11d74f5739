"""Fit the receiver model to a recording of a radar at rest.

The method needs no calibration target. While the radar and its surroundings stand still, frame x_i is

    x_i = (1 + a_i) exp(j phi_i) m + n_i,

with m the mean profile, phi_i and a_i the phase and amplitude errors common to a frame, and n_i the additive noise
[X4Recordings]. Differences of successive frames remove m and slow drift. At rest they are noise, whose correlation
between bins is that of the receiver's filter; echoes that move are as wide as the pulse and correlate more. This law
tells which frames are at rest. Bins without strong echoes give the variance of n.
The covariance of relative changes between strong bins so far apart that they share no noise gives those of phi
and a. White errors make successive differences anticorrelated; what their covariance does not explain is a random walk,
a drift that is reported and not simulated. Where the recording also holds
a part in which the radar moved, echoes of the surroundings average out and the instrument's own response stays: direct
path and ring-down. The fitted receiver then simulates as many frames at rest, and the same estimators measure both:
the differences are the misfit.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import yaml
from numpy.typing import NDArray
from scipy.signal import hilbert

from ullage.arrays import Bools, Complexes, Floats
from ullage.data import Frames, Metric
from ullage.errors import InputError
from ullage.files import write_whole
from ullage.geometry import C0
from ullage.radar.receiver import FILTER_SCALE, SIGMA_RATIO, dac_limit, noise_sigma, receive, unit
from ullage.specs import DirectPathSpec, NoiseSpec, RadarSpec

WINDOW = 16
"""Frames whose means are compared to find out whether anything moved."""
LEAST_STILL = 48
"""Fewer frames at rest give sigmas worse than 10 %."""
_DRIFT = 6.0
"""Change within and between windows, over what noise and the receiver's drift make, that counts as rest: 0 to 5 in most
windows of four recordings at rest; a radar that moves in simulation, 5 mm/s to 0.5 m/s: 39 to 13 000."""
_OWN_DRIFT = 0.001
"""Power by which a receiver at rest changes an echo from one window to the next: -30 dB."""
_UNLIKE_NOISE = 0.15
"""Mean excess of the correlation at lags 1 to 3 over the filter's. At rest: -0.03 to 0.13 on four recordings, 16 frames
each; a radar or a person that moves: 0.17 to 0.8."""
_LOUDER = 1.41
"""Power of changes over that of the quietest quarter of such windows: 1.5 dB, four sigma of a window."""
_LIKE_PRESET_DB = 6.0
"""Between the noise of a device and its preset at the counts that its lattice shows; measured: 0.2 dB."""
_MOST_MISFIT = {"noise": 0.5, "kurtosis": 1.5} | {f"correlation_lag_{k}": 0.2 for k in (1, 2, 3)}
"""Of the fit: beyond these the frames at rest are no noise of this receiver."""
_WHITE = -0.3
"""Correlation of successive changes: -0.5 for white noise about a constant, 0 and more for echoes that move."""
_LEAST_WHITE = 8
_LARGEST_DRIFT = 0.1
"""Of the phase of the strongest echo from frame to frame [rad]: a fourhundredth of a wavelength of path."""
_STRONG = 0.1
"""Bins above this share of the strongest one show the common phase and amplitude."""
_SIGNIFICANT = 4.0
"""Standard errors above which a bin of the mean over a moving part belongs to the instrument."""
_SATURATED = 0.03
"""Share of saturated samples that only a wrong gain explains; the direct path of an X4 saturates half a per cent."""
_LAGS = 3


@dataclass(frozen=True, slots=True, eq=False)
class Receiver:
    """A radar with its receiver as measured on a recording.

    `radar` is a preset to simulate with; `misfit` compares frames simulated with it with the recording.
    """

    radar: RadarSpec
    misfit: dict[str, Metric]
    still: Bools  # (n) frames at rest
    moving: Bools  # (n) frames of which the instrument's own response was taken; all False: of the still ones
    notes: tuple[str, ...] = ()

    @classmethod
    def fit(cls, recording: Frames | Mapping[str, Frames], *, counts: tuple[int, int] | None = None) -> Receiver:
        """Measure noise, phase and amplitude jitter, direct path and ring-down of a radar.

        Args:
            recording: frames of one radar, recorded or simulated, at rest for at least 48 frames; a part in which it
                moves separates the instrument's own response from the echoes of the place. Poses are not used.
            counts: iterations and pulses per step that the radar was set to; None: read from the lattice of the
                values where that is possible, else those of the frames' spec.

        Returns:
            The fitted receiver. Its `radar.noise.unit_gain` stays that of the frames' spec: a recording without a
            target of known size cannot tell it.

        Raises:
            InputError: more than one radar, amplitudes without phase, saturated samples, no part at rest, or what is
                taken for rest is not the noise of such a receiver.
        """
        frames = _only(recording)
        profiles = _baseband(frames)
        still, moving = _parts(profiles, frames)
        spec = _with_counts(frames, counts)
        measured = _Rest.of(profiles, still, spec, frames.sensor)
        own, notes = _own_response(profiles, still, moving, frames)
        noise = _noise(spec, measured, own, frames)
        radar = spec.but(noise=noise)
        misfit = _misfit(radar, measured, frames, own)
        _refuse_misfit(misfit, radar, frames, shown=counts is None and spec.counts != frames.spec.counts)
        return cls(radar, misfit, still, moving, notes)

    def write(self, path: str | Path) -> None:
        """Write the radar as YAML: `RadarSpec.preset(path)` and `sensing.preset` of a scenario read it.

        Raises:
            InputError: the file cannot be written.
        """
        fields = self.radar.model_dump(mode="json", exclude_defaults=True)
        lines = [f"Measured on {int(self.still.sum())} frames at rest.", *self.notes, "Simulated less recorded:"]
        lines += [f"  {row.name} {row.value:.3g} {row.unit}".rstrip() for row in self.misfit.values()]
        text = "".join(f"# {line}\n" for line in lines) + yaml.safe_dump(fields, sort_keys=False, width=110)
        write_whole(Path(path), lambda file: file.write(text.encode()))


def _only(recording: Frames | Mapping[str, Frames]) -> Frames:
    if isinstance(recording, Mapping):
        if len(recording) != 1:
            names = ", ".join(recording)
            raise InputError(f"{len(recording)} radars", where="Receiver.fit", allowed=f"frames of one of {names}")
        recording = next(iter(recording.values()))
    if not np.iscomplexobj(recording.samples) and (recording.spec.output != "rf" or recording.ray_model):
        raise InputError("amplitudes without phase", where=recording.sensor, allowed="complex baseband or RF samples")
    _refuse_saturated(recording)
    if recording.unit == "path_gain":
        return replace(recording, samples=recording.samples * unit(recording.spec), unit="normalised")
    return recording


def _refuse_saturated(frames: Frames) -> None:
    """Refuse RF recordings in which many samples of a frame lie at the very limits of the converter."""
    if np.iscomplexobj(frames.samples):
        return
    limit = np.abs(frames.samples).max()
    share = float((np.abs(frames.samples) >= limit).mean())
    if limit > 0 and share > _SATURATED:
        raise InputError(f"{100 * share:.0f} % of the samples are saturated at {limit:g}", where=frames.sensor,
                         allowed="a recording with less gain")  # fmt: skip


def _baseband(frames: Frames) -> Complexes:
    """Complex envelopes (n, b); of RF samples the analytic signal, mixed down."""
    if np.iscomplexobj(frames.samples):
        return frames.samples.astype(np.complex128)
    carrier = np.exp(-2j * np.pi * frames.spec.center_hz * (2 / C0) * (frames.range_m - _zero_m(frames)))
    return np.asarray(hilbert(frames.samples.astype(np.float64), axis=1) * carrier, np.complex128)


def _parts(profiles: Complexes, frames: Frames) -> tuple[Bools, Bools]:
    """Which frames are at rest, and which are surely not.

    Windows of 16 frames are at rest if changes from frame to frame are noise: as correlated over bins as the filter
    makes it, and as strong as in the quietest quarter of such windows. Neither their frames nor their means may differ
    by much more than noise and the drift of a receiver, in 90 % of the bins: a few may hold a person who breathes.
    """
    sensor, count = frames.sensor, len(profiles) // WINDOW
    if count < LEAST_STILL // WINDOW:
        raise InputError(f"{len(profiles)} frames", where=sensor, allowed=f"{LEAST_STILL} or more at rest")
    cut = profiles[: count * WINDOW].reshape(count, WINDOW, -1)
    noise, level = _noise_windows(cut, frames)
    if not noise.any():
        raise _moved("no part of it changes as the receiver's noise does: echoes move throughout", sensor)
    power = (np.abs(cut) ** 2).mean(1)
    within, between = (np.abs(np.diff(cut, axis=1)) ** 2).mean(1) / 2, np.abs(np.diff(cut.mean(1), axis=0)) ** 2
    shaken = _over_expected(within, level, power, 2 * level) > _DRIFT
    moved = _over_expected(between, 2 * level / WINDOW, power[:-1], 2 * level) > _DRIFT
    alone = np.append(moved, True) & np.append(True, moved)  # unlike both neighbours
    still, moving = np.zeros(len(profiles), bool), np.zeros(len(profiles), bool)
    still[: count * WINDOW] = np.repeat(noise & ~shaken & ~alone, WINDOW)
    moving[: count * WINDOW] = np.repeat(shaken | alone, WINDOW)
    if still.sum() < LEAST_STILL:
        raise _moved(f"only {int(still.sum())} of {len(profiles)} frames are at rest", sensor)
    return still, moving


def _noise_windows(cut: Complexes, frames: Frames) -> tuple[Bools, float]:
    """Which windows (w, 16, b) change from frame to frame as the receiver's noise does, and that noise's power."""
    law, _ = _window_law(_noise_alone(frames))
    found = [_window_law(window) for window in cut]
    excess = np.array([float((lags - law).mean()) for lags, _ in found])
    power = np.array([level for _, level in found])
    like = excess < _UNLIKE_NOISE
    level = float(np.quantile(power[like], 0.25)) if like.any() else 0.0
    return like & (power < _LOUDER * level), level


def _window_law(window: Complexes) -> tuple[Floats, float]:
    """Correlation of successive changes between bins at lags 1 to 3, and their power, in bins without strong echoes."""
    steps = np.diff(window, axis=0) / np.sqrt(2)
    power = (np.abs(steps) ** 2).mean(0)
    level = float(np.median(power))
    return _correlation(steps, power <= 1.5 * level).real, level


def _noise_alone(frames: Frames) -> Complexes:
    """Profiles of noise alone that this radar's receiver makes."""
    noise = (frames.spec.noise or NoiseSpec()).but(direct_path=None, leakage=False, phase_rad=0.0, amplitude=0.0)
    return _baseband(_empty_frames(frames.spec.but(noise=noise), 8 * WINDOW))


def _empty_frames(radar: RadarSpec, count: int) -> Frames:
    """What a radar receives where nothing is."""
    empty = np.zeros((count, radar.bins), np.float32 if radar.output == "rf" else np.complex64)
    samples = receive(empty, radar, seed=1) * unit(radar)
    return Frames(samples, radar.range_m, np.arange(count, dtype=np.int64) * 1_000_000, radar, unit="normalised")


def _over_expected(change: Floats, noise: float, power: Floats, echo: float) -> Floats:
    """Changes of windows (w, b) over what noise and drift make, in 90 % of the bins of more power than `echo` (w)."""
    ratio = change / (noise + _OWN_DRIFT * power + 1e-300)
    chosen = [row[strong] if strong.any() else row for row, strong in zip(ratio, power > echo, strict=True)]
    return np.array([np.quantile(row, 0.9) for row in chosen])


def _refuse_misfit(misfit: Mapping[str, Metric], radar: RadarSpec, frames: Frames, *, shown: bool) -> None:
    """Refuse a fit that its own simulation contradicts, or the lattice of the values where it shows the counts."""
    wrong = [f"{name} by {misfit[name].value:.2g} {misfit[name].unit}".rstrip() for name, most in _MOST_MISFIT.items()
             if not abs(misfit[name].value) <= most]  # fmt: skip
    usual = frames.spec.noise or NoiseSpec()
    if shown and radar.noise is not None and usual.thermal > 0:
        louder = 20 * float(np.log10(radar.noise.thermal / usual.thermal))
        if abs(louder) > _LIKE_PRESET_DB:
            wrong.append(f"the noise by {louder:.0f} dB from the {radar.counts} counts that the lattice shows")
    if wrong:
        raise _moved(f"what is taken for rest misses the receiver's noise: {', '.join(wrong)}", frames.sensor)


def _moved(what: str, sensor: str) -> InputError:
    return InputError(what, where=sensor, allowed=f"{LEAST_STILL} frames or more at rest: let the radar stand a while")


def _whiteness(steps: Complexes) -> Floats:
    """Correlation of successive changes (n) or (n, b) over time."""
    power = (np.abs(steps) ** 2).mean(0)
    return np.asarray((steps[:-1] * steps[1:].conj()).mean(0).real / np.maximum(power, 1e-300))


def _steps(profiles: Complexes, still: Bools) -> Complexes:
    """Changes between successive frames at rest, over root two: noise alone, with the variance of one frame."""
    pairs = np.flatnonzero(still[1:] & still[:-1])
    return np.asarray((profiles[pairs + 1] - profiles[pairs]) / np.sqrt(2))


@dataclass(frozen=True, slots=True)
class _Rest:
    """What frames at rest tell."""

    sigma: float  # additive noise of |c|
    phase_rad: float
    drift_rad: float  # random walk of the phase, a frame
    amplitude: float
    correlation: Floats  # between bins at lags 1, 2, 3
    mean: Complexes  # (b)
    kurtosis: float  # excess, of the additive noise

    @classmethod
    def of(cls, profiles: Complexes, still: Bools, spec: RadarSpec, sensor: str) -> _Rest:
        """Measure frames at rest (n, b).

        Raises:
            InputError: echoes change from frame to frame in all bins, or the direct path does.
        """
        steps = _steps(profiles, still)
        power = (np.abs(steps) ** 2).mean(0)
        white = _whiteness(steps) < _WHITE
        if white.sum() < _LEAST_WHITE:
            raise _moved("echoes move in all bins", sensor)
        variance = float(np.median(power[white]))
        quiet = white & (power < 1.5 * variance)  # bins whose echoes do not show the common jitter
        mean = profiles[still].mean(0)
        strong = _strong_bins(np.abs(mean), spec)
        between = _correlation(steps, quiet)
        values = np.concatenate([steps[:, quiet].real.ravel(), steps[:, quiet].imag.ravel()])
        excess = float(((values / values.std()) ** 4).mean() - 3)
        relative = steps[:, strong] / mean[strong]
        apart = _far_apart(np.flatnonzero(strong), np.abs(mean[strong]))
        phase, drift = _jitter(relative.imag, apart)
        if drift > _LARGEST_DRIFT:
            raise _moved(f"the phase of the strongest echo drifts by {drift:.2f} rad a frame", sensor)
        amplitude, _ = _jitter(relative.real, apart)
        return cls(np.sqrt(variance), phase, drift, amplitude, between.real, mean, excess)


def _strong_bins(size: Floats, spec: RadarSpec) -> Bools:
    """Bins whose echoes are strong and, where any are, within the DAC window, which would flatten their errors."""
    strong = size > _STRONG * size.max()
    noise = spec.noise or NoiseSpec()
    within = strong & (size < dac_limit(spec) * (noise.baseband_gain if spec.output == "baseband" else 1.0))
    return np.asarray(within if within.any() else strong)


def _far_apart(bins: NDArray[np.intp], size: Floats) -> Floats:
    """Weights of pairs of strong bins (k, k) that share no noise; sum 1. Of one echo's few bins: all pairs."""
    apart = np.abs(bins[:, None] - bins) > _LAGS
    pairs = np.outer(size, size) ** 2 * (apart if apart.any() else 1.0)
    return np.asarray(pairs / pairs.sum())


def _jitter(steps: Floats, pairs: Floats) -> tuple[float, float]:
    """White part of an error that all bins share and its random walk a frame.

    Args:
        steps: relative changes of the strong bins from frame to frame (n, k), over root two.
        pairs: weights of the pairs of bins (k, k) whose covariance holds what they share.
    """
    now = float((steps.T @ steps / len(steps) * pairs).sum())
    white = -2 * float((steps[:-1].T @ steps[1:] / (len(steps) - 1) * pairs).sum())
    return np.sqrt(max(white, 0.0)), np.sqrt(max(2 * (now - white), 0.0))


def _correlation(steps: Complexes, quiet: Bools) -> Complexes:
    """Correlation of the noise between bins at lags 1 to 3, over pairs of quiet bins."""
    power = max(float((np.abs(steps[:, quiet]) ** 2).mean()), 1e-300)
    out = []
    for lag in range(1, _LAGS + 1):
        pairs = quiet[:-lag] & quiet[lag:]
        out.append((steps[:, :-lag][:, pairs] * steps[:, lag:][:, pairs].conj()).mean() / power)
    return np.array(out)


def _own_response(
    profiles: Complexes, still: Bools, moving: Bools, frames: Frames
) -> tuple[DirectPathSpec, tuple[str, ...]]:
    """The instrument's own response over range, from the moving part where there is one."""
    every = 1 if np.iscomplexobj(frames.samples) else max(1, int(C0 / 2 / (4 * frames.spec.bandwidth_hz)
                                                                / frames.spec.bin_m))  # fmt: skip
    mean, last = _that_stays(profiles, moving) if moving.sum() >= LEAST_STILL else (None, 0)
    if mean is not None and last < profiles.shape[1] // 2:
        notes = (f"direct path and ring-down to {frames.range_m[last]:.2f} m, from {int(moving.sum())} moving frames",)
    else:
        mean = profiles[still].mean(0)
        size = np.abs(mean)
        low = size < 0.1 * size.max()
        last = int(np.argmax(low)) if low.any() else len(size) - 1
        notes = (f"the radar does not move: what is within {frames.range_m[last]:.2f} m is taken for the direct path; "
                 "standing echoes of the place may be in it",)  # fmt: skip
    values = _in_band(mean, frames)[: max(last + 1, 4 * every) : every]
    return DirectPathSpec(
        range_start_m=float(frames.range_m[0] + frames.spec.frame_area_offset_m - _zero_m(frames)),
        step_m=every * frames.spec.bin_m,
        in_phase=_rounded(values.real),
        quadrature=_rounded(values.imag),
    ), notes


def _zero_m(frames: Frames) -> float:
    """What cables and antennas add to the ranges of a recording that is not calibrated; simulated ranges are true."""
    return 0.0 if frames.calibration is not None else frames.spec.range_zero_m or 0.0


def _in_band(profile: Complexes, frames: Frames) -> Complexes:
    """A profile (b) without harmonics that the converter's limits make of RF samples."""
    if np.iscomplexobj(frames.samples):
        return profile
    offset = np.fft.fftfreq(len(profile), frames.spec.step_s)
    return np.asarray(np.fft.ifft(np.where(np.abs(offset) < frames.spec.bandwidth_hz, np.fft.fft(profile), 0)))


def _that_stays(profiles: Complexes, moving: Bools) -> tuple[Complexes, int]:
    """The mean (b) over a moving part, and the last bin that stays the same in it.

    That bin lies far out where only things around the radar move: their echoes and the instrument's are not parted.
    """
    windows = [profiles[cut].mean(0) for cut in _windows(moving)]
    mean = np.mean(windows, axis=0)
    error = np.std(windows, axis=0) / np.sqrt(len(windows))
    return mean, _last_of_run(np.abs(mean) > _SIGNIFICANT * error)


def _windows(chosen: Bools) -> list[slice]:
    """Pieces of at most 16 successive chosen frames."""
    edges = np.flatnonzero(np.diff(np.concatenate([[False], chosen, [False]])))
    return [slice(a, min(a + WINDOW, end)) for start, end in zip(edges[::2], edges[1::2], strict=True)
            for a in range(start, end, WINDOW)]  # fmt: skip


def _last_of_run(own: Bools) -> int:
    """The last bin of the run of significant bins from the start; gaps of up to a tenth of the run are bridged."""
    last = int(np.argmax(own))
    for here, there in pairwise(np.flatnonzero(own)):
        if there - here > max(4, 0.1 * there):
            return int(here)
        last = int(there)
    return last


def _with_counts(frames: Frames, counts: tuple[int, int] | None) -> RadarSpec:
    """The frames' spec with the radar's settings as given, or as the lattice of the values shows them."""
    spec = frames.spec
    if counts is None and np.iscomplexobj(frames.samples):
        found = lattice_counts(frames)
        counts = (found, 1) if found is not None else None
    return spec if counts is None else spec.but(iterations=counts[0], pulses_per_step=counts[1])


def lattice_counts(frames: Frames) -> int | None:
    """The number of counts N of an X4, read from its values, which are multiples of 1 / (306 * 1024 * N).

    None where float32 is too coarse for the lattice to show: N over about 64.
    """
    values = np.abs(np.concatenate([frames.samples.real.ravel(), frames.samples.imag.ravel()]).astype(np.float64))
    small = values[(values > 0) & (values < 2e-4)][:20_000]
    if len(small) < 1000:
        return None
    for counts in range(1, 65):
        if abs(np.exp(2j * np.pi * small * 1024 * FILTER_SCALE * counts).mean()) > 0.99:
            return counts
    return None


def _noise(spec: RadarSpec, rest: _Rest, own: DirectPathSpec, frames: Frames) -> NoiseSpec:
    """The noise settings that give the measured statistics at the radar's own counts."""
    before = spec.noise or NoiseSpec()
    x4 = np.iscomplexobj(frames.samples)
    sigma = rest.sigma / SIGMA_RATIO if x4 else rest.sigma / np.sqrt(2)  # of one RF sample
    values: dict[str, Any] = {
        "thermal": sigma * np.sqrt(spec.counts / 2.0**spec.dac_step),
        "phase_rad": rest.phase_rad,
        "phase_thermal_rad": 0.0,  # one recording shows the sum at its own counts
        "amplitude": rest.amplitude,
        "leakage": True,
        "direct_path": own if not x4 else _before_gain(own, before.baseband_gain),
    }
    return before.but(**values)


def _before_gain(own: DirectPathSpec, gain: float) -> DirectPathSpec:
    """The response at RF of one that was recorded at baseband."""
    return own.but(
        in_phase=_rounded(np.array(own.in_phase) / gain), quadrature=_rounded(np.array(own.quadrature) / gain)
    )


def _rounded(values: Floats) -> tuple[float, ...]:
    """Values to five digits, which is beyond what is measured."""
    return tuple(float(f"{value:.5g}") for value in values)


def _misfit(radar: RadarSpec, recorded: _Rest, recording: Frames, own: DirectPathSpec) -> dict[str, Metric]:
    """Frames at rest simulated with the fitted receiver, beside the recorded ones: simulated less or over recorded."""
    radar = radar.but(range_start_m=float(recording.range_m[0]) - _zero_m(recording))
    count = min(len(recording), 4000)
    frames = _empty_frames(radar, count)
    ours = _Rest.of(_baseband(frames), np.ones(count, bool), radar, "simulated")
    rows = [
        Metric("noise", 20 * np.log10(ours.sigma / recorded.sigma), "dB"),
        Metric("noise_law", 20 * np.log10(ours.sigma / _expected(radar)), "dB"),
        Metric("direct_path", _difference_db(ours.mean, recorded.mean, own, frames), "dB"),
        Metric("phase_jitter", (ours.phase_rad - recorded.phase_rad) * 1e3, "mrad"),
        Metric("phase_drift", (ours.drift_rad - recorded.drift_rad) * 1e3, "mrad a frame"),
        Metric("amplitude_jitter", (ours.amplitude - recorded.amplitude) * 1e2, "%"),
        Metric("kurtosis", ours.kurtosis - recorded.kurtosis, ""),
    ]
    lags = zip(ours.correlation, recorded.correlation, strict=True)
    rows += [Metric(f"correlation_lag_{k}", float(a - b), "") for k, (a, b) in enumerate(lags, 1)]
    return {row.name: row for row in rows}


def _difference_db(ours: Complexes, recorded: Complexes, own: DirectPathSpec, frames: Frames) -> float:
    """What is left of the recorded direct path without the simulated one, over its range, but for one phase [dB]."""
    end_m = own.range_start_m + own.step_m * len(own.in_phase)
    bins = frames.range_m + frames.spec.frame_area_offset_m < end_m
    one, other = _in_band(ours, frames)[bins], _in_band(recorded, frames)[bins]
    one = one * np.exp(1j * np.angle(np.vdot(one, other)))
    return float(20 * np.log10(np.linalg.norm(one - other) / np.linalg.norm(other)))


def _expected(radar: RadarSpec) -> float:
    """Sigma of |c| that the settings of a radar mean."""
    return noise_sigma(radar) * (np.sqrt(2) if radar.output == "rf" else 1.0)
