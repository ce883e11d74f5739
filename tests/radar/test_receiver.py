"""The receiver's parts: units, lattice, window, folding, filter, and their plain twins."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from ullage.errors import InputError
from ullage.kernels.receiver import limit_envelope
from ullage.radar.leakage import leakage, unlimited
from ullage.radar.pulse import chip_taps
from ullage.radar.receiver import (
    FILTER_SCALE,
    Draws,
    baseband_noise,
    counted,
    dac_limit,
    fold,
    lattice,
    noise_sigma,
    normalised,
    phase_sigma,
    receive,
    receive_thesis,
    short_filter,
    unit,
)
from ullage.specs import NoiseSpec, RadarSpec, ThesisSpec

X4 = RadarSpec.preset("x4m05")
RF = RadarSpec.preset("x4m05", output="rf", bins=1504)
QUIET = NoiseSpec(thermal=0, leakage=False, phase_rad=0, phase_thermal_rad=0, amplitude=0, clip=False, lattice=False)


def clean(spec, n=3, size=1e-4, seed=0):
    rng = np.random.default_rng(seed)
    wave = size * rng.normal(size=(n, spec.bins))
    if spec.output == "rf":
        return wave.astype(np.float32)
    return (wave + 1j * size * rng.normal(size=(n, spec.bins))).astype(np.complex64)


def test_without_noise_the_echoes_pass_unchanged():
    for spec in (X4.but(noise=None), RF.but(noise=None)):
        assert np.array_equal(receive(clean(spec), spec, seed=1), clean(spec))


@pytest.mark.parametrize("base", [X4, RF])
def test_with_every_part_off_only_units_come_and_go(base):
    spec = base.but(noise=QUIET)
    assert np.allclose(receive(clean(spec), spec, seed=1), clean(spec), rtol=1e-6, atol=1e-11)


@pytest.mark.parametrize("base", [X4, RF])
@given(cut=st.integers(1, 9), seed=st.integers(0, 2**62))
@settings(max_examples=10, deadline=None)
def test_a_frames_noise_depends_on_its_number_alone(base, cut, seed):
    echoes = clean(base, 10)
    whole = receive(echoes, base, seed=seed)
    rest = receive(echoes[cut:], base, seed=seed, first_frame=cut)
    assert rest.tobytes() == whole[cut:].tobytes()
    assert not np.array_equal(whole[0] - echoes[0], whole[1] - echoes[1])


def test_draws_are_those_of_a_fresh_counter_based_generator():
    draws = Draws(42, 1)
    for frame in (7, 0, 7):
        fresh = np.random.Generator(np.random.Philox(key=[42, 1], counter=[0, 0, 0, frame]))
        assert np.array_equal(draws.of(frame).standard_normal(50), fresh.standard_normal(50))
    assert not np.array_equal(Draws(42, 0).of(0).standard_normal(5), Draws(42, 1).of(0).standard_normal(5))


# --- units -----------------------------------------------------------------------------------------------------------


def test_counts_and_normalised_values_follow_the_drivers_formula():
    for spec in (X4, X4.but(dac_step=2, iterations=16, pulses_per_step=300, dac_min=0, dac_max=2047)):
        count, steps = 12345, spec.dac_max - spec.dac_min + 1
        by_hand = count * 2**spec.dac_step / (spec.iterations * spec.pulses_per_step * 1024) - steps / 2048
        assert normalised(count, spec) == pytest.approx(by_hand, rel=1e-14)
        assert counted(by_hand, spec) == count
        assert counted(-9.0, spec) == 0
        assert normalised(counted(9.0, spec), spec) == pytest.approx(dac_limit(spec))


def test_phase_sigma_gives_both_measured_values():
    assert phase_sigma(X4.but(iterations=64, pulses_per_step=64)) == pytest.approx(0.010, rel=0.02)
    assert phase_sigma(X4.but(iterations=4, pulses_per_step=1)) == pytest.approx(0.0186, rel=0.02)


@pytest.mark.parametrize("base", [X4, RF])
def test_values_lie_on_the_lattice_from_which_the_counts_can_be_read(base):
    spec = base.but(iterations=4, pulses_per_step=1)
    out = receive(np.zeros((20, spec.bins)), spec, seed=1).astype(complex) * unit(spec)
    step = lattice(spec) / (FILTER_SCALE if spec.output == "baseband" else 1)
    values = np.concatenate([out.real.ravel(), out.imag.ravel()]) / step
    far = abs(values) < 2000  # float32 holds these to a thousandth of a step
    assert abs(values - np.rint(values))[far].max() < 0.01
    assert np.unique(np.rint(values[far])).size > 5
    if spec.output == "rf":
        assert step == 1 / (1024 * 4)


# --- DAC window ------------------------------------------------------------------------------------------------------


def test_rf_samples_stop_at_the_dac_window():
    loud = np.full((1, RF.bins), 0.5, np.float32)
    out = receive(loud, RF, seed=1) * unit(RF)
    assert abs(out).max() == pytest.approx(dac_limit(RF), rel=1e-6)
    wide = RF.but(dac_min=0, dac_max=2047, noise=QUIET.but(clip=True))
    assert receive(loud / 10, wide, seed=1) == pytest.approx(loud / 10, rel=1e-5)


@pytest.mark.parametrize("loud", [0.5, 1.0, 1.2, 2.0, 10.0])
def test_limiting_the_envelope_is_limiting_the_carrier(loud):
    t = np.arange(4096)
    carrier = np.clip(loud * np.cos(2 * np.pi * 0.3125 * t + 0.3), -1, 1)  # a bin of the FFT, harmonics elsewhere
    phase = 2 * np.pi * np.linspace(0, 1, 100_000, endpoint=False)
    by_hand = 2 * np.mean(np.clip(loud * np.cos(phase), -1, 1) * np.cos(phase))
    value = np.array([[loud * np.exp(0.3j)]])
    limit_envelope(value, 1.0)
    assert abs(value[0, 0]) == pytest.approx(by_hand, rel=1e-6)
    assert np.angle(value[0, 0]) == pytest.approx(0.3)
    assert abs(np.mean(carrier * np.exp(-2j * np.pi * 0.3125 * t))) * 2 == pytest.approx(by_hand, rel=0.04)
    assert unlimited(np.array([by_hand]), 1.0)[0] == pytest.approx(loud, rel=1e-4)


def test_a_near_echo_clips_at_baseband_as_at_rf():
    """A pulse over the window: the complex envelope's describing function against clipping the real RF signal."""
    fs, fc, limit = RF.sampling_hz, RF.center_hz, dac_limit(RF)
    t = (np.arange(1504) - 700) / fs
    envelope = 2.5 * limit * np.exp(-0.5 * (t / RF.pulse_sigma_s) ** 2)
    taps = chip_taps()

    def down(x):
        return np.convolve(x * np.exp(-2j * np.pi * fc * t), taps, "same")

    literal = down(np.clip(envelope * np.cos(2 * np.pi * fc * t), -limit, limit))
    limited = envelope[None].astype(complex)
    limit_envelope(limited, limit)
    assert abs(np.convolve(limited[0] / 2, taps, "same") - literal).max() < 0.05 * abs(literal).max()


def test_a_narrower_window_hides_more_of_the_direct_path():
    def peak(spec):
        quiet = spec.but(noise=QUIET.but(leakage=True, clip=True))
        return abs(receive(np.zeros((1, 188), complex), quiet, seed=1) * unit(spec))[0].max()

    usual = peak(X4)
    assert usual == pytest.approx(0.0682, rel=0.01)
    assert peak(X4.but(dac_min=1000, dac_max=1050)) < 0.5 * usual
    assert peak(X4.but(dac_min=0, dac_max=2047)) > 1.1 * usual


# --- direct path -----------------------------------------------------------------------------------------------------


def test_the_direct_path_keeps_its_place_when_the_frame_moves():
    whole, later = leakage(X4), leakage(X4.but(range_start_m=3 * X4.bin_m, bins=50))
    assert np.allclose(later, whole[3:53], atol=1e-12)
    assert np.allclose(leakage(X4.but(frame_area_offset_m=2 * X4.bin_m))[:-2], whole[2:], atol=1e-12)
    assert not leakage(X4.but(range_start_m=1.0)).any()
    assert not whole[12:].any()


def test_the_direct_path_is_the_same_wave_at_rf():
    spec = RF.but(noise=QUIET.but(leakage=True), range_start_m=-0.5)
    wave = receive(np.zeros((1, RF.bins)), spec, seed=1)[0] * unit(spec)
    turn = np.exp(-4j * np.pi * spec.range_m / spec.wavelength_m)
    envelope = np.convolve(2 * wave * turn, chip_taps(), "same")
    base = X4.but(noise=spec.noise)
    seen = receive(np.zeros((1, 188), complex), base, seed=1)[0] * unit(base) / spec.noise.baseband_gain
    got = np.interp(base.range_m[:10], spec.range_m, abs(envelope))
    assert got == pytest.approx(abs(seen[:10]), abs=0.25 * float(abs(seen).max()))  # the filter widens it once more


def test_phase_noise_turns_the_carrier_at_rf_too():
    spec = RF.but(noise=QUIET.but(phase_rad=0.02))
    t = (np.arange(RF.bins) - 700) / RF.sampling_hz
    pulse = 1e-4 * np.exp(-0.5 * (t / RF.pulse_sigma_s) ** 2) * np.cos(2 * np.pi * RF.center_hz * t)
    out = receive(np.tile(pulse, (800, 1)), spec, seed=6) @ np.exp(-2j * np.pi * RF.center_hz * t)
    assert np.angle(out).std() == pytest.approx(0.02, rel=0.08)
    assert abs(out).std() < 1e-3 * abs(out).mean()


# --- folding ---------------------------------------------------------------------------------------------------------


def test_ranges_are_unambiguous_within_a_pulse_interval():
    assert X4.unambiguous_range_m == pytest.approx(9.87, abs=0.005)


@pytest.mark.parametrize("base", [X4, RF])
def test_an_echo_beyond_the_fold_lands_where_its_range_says(base):
    spec = base.but(noise=None)
    per_pulse = round(spec.unambiguous_range_m / spec.bin_m)
    assert per_pulse == (192 if spec.output == "baseband" else 1536)  # 15.1875 MHz is a whole number of bins
    long = np.zeros((2, 2 * per_pulse + 100), np.float32 if spec.output == "rf" else np.complex64)
    long[:, 40], long[:, per_pulse + 60], long[:, 2 * per_pulse + 80] = 3, 2, 1
    long[:, per_pulse - 1] = 9  # between the end of the frame and the next pulse
    out = receive(long, spec, seed=0)
    assert out.shape == (2, spec.bins)
    want = np.zeros(spec.bins)
    want[[40, 60, 80]] = 3, 2, 1
    assert out[0] == pytest.approx(want, abs=1e-5)


def test_a_fold_between_bins_is_shared_and_too_few_bins_are_refused():
    spec = X4.but(noise=None, sampling_hz=23e9)
    shift = spec.unambiguous_range_m / spec.bin_m
    long = np.zeros((1, 400), complex)
    long[0, 250] = 1
    out = abs(fold(long, spec)[0])
    place = (out @ np.arange(188)) / out.sum()
    assert place == pytest.approx(250 - shift, abs=1e-6)
    with pytest.raises(InputError, match=r"100 bins \(allowed: 188 or more"):
        receive(np.zeros((1, 100), complex), spec, seed=0)


# --- on-chip filter --------------------------------------------------------------------------------------------------


def test_the_taps_are_the_windowed_design_of_the_recordings():
    from scipy.signal import firwin

    assert chip_taps() == pytest.approx(firwin(32, 0.5e9, fs=23.328e9), rel=1e-9, abs=1e-12)


def test_the_short_filter_has_the_covariance_of_mixing_filtering_and_decimating():
    """The literal chain on white RF noise: covariance of its output in closed form, and that it is circular."""
    taps, short = chip_taps(), short_filter()
    mixed = taps * np.exp(-2j * np.pi * X4.center_hz / X4.sampling_hz * np.arange(32))
    for lag in range(4):
        literal = mixed[: 32 - 8 * lag] @ (taps[8 * lag :] * np.exp(
            2j * np.pi * X4.center_hz / X4.sampling_hz * np.arange(32 - 8 * lag)))  # fmt: skip
        assert short[: 4 - lag] @ short[lag:] == pytest.approx(literal.real / (taps @ taps), abs=1e-9)
        assert abs(literal.imag) < 1e-12
    assert abs(mixed @ mixed) / (taps @ taps) < 1e-4


def test_noise_by_either_way_looks_the_same():
    rng = np.random.default_rng(3)
    n, bins = 400, 64
    white = rng.normal(size=(n, 8 * (bins - 1) + 32))
    mix = np.exp(-2j * np.pi * X4.center_hz / X4.sampling_hz * np.arange(white.shape[1]))
    windows = np.lib.stride_tricks.sliding_window_view(white * mix, 32, axis=1)[:, ::8]
    literal = windows @ chip_taps() / np.linalg.norm(chip_taps())
    ours = baseband_noise(X4.but(bins=bins), 1, range(n)) / noise_sigma(X4)
    for lag in range(5):
        a, b = ((z[:, : bins - lag] * z[:, lag:].conj()).mean() for z in (literal, ours))
        assert abs(a - b) < 0.02


def test_other_decimations_keep_the_shape():
    assert short_filter(4) == pytest.approx(short_filter(8), abs=0.05)


# --- thesis ----------------------------------------------------------------------------------------------------------


def test_the_thesis_noise_is_white_then_averaged():
    spec = X4.but(thesis=ThesisSpec(noise_sigma=0.01, smoothing_bins=5))
    out = receive_thesis(np.zeros((300, 188), np.float32), spec, seed=3)[:, 5:-5].astype(float)
    assert out.std() == pytest.approx(0.01 / np.sqrt(5), rel=0.03)
    lags = [np.mean(out[:, : 178 - k] * out[:, k:]) / out.var() for k in range(1, 8)]
    assert lags == pytest.approx([0.8, 0.6, 0.4, 0.2, 0, 0, 0], abs=0.03)
    assert not receive_thesis(np.zeros((2, 188), np.float32), X4.but(noise=None), seed=3).any()


def test_default_noise_stays_well_below_the_thesis_threshold():
    out = receive_thesis(np.zeros((2000, 188), np.float32), X4, seed=3)
    assert abs(out).max() < X4.thesis.threshold / 4
