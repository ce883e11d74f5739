"""The simulated receiver beside two real XeThru X4 recordings: each measured by the same lines of code.

The long recording (module unknown, four counts) stands still in frames 200-4900; Novelda's own (X4M300) in 0-150.
"""

import struct
from pathlib import Path

import numpy as np
import pytest
from scipy.stats import kurtosis, skew

import ullage as ul
from ullage.radar.leakage import leakage
from ullage.radar.pulse import chip_taps, envelope, spectrum
from ullage.radar.receiver import FILTER_SCALE, SIGMA_RATIO, noise_sigma, receive, unit
from ullage.radar.simulate import simulate
from ullage.specs import RadarSpec

DATA = Path(__file__).parents[3] / "shared" / "data" / "x4"
LONG, NOVELDA = DATA / "xethru_datafloat_20190614_141837.dat", DATA / "xethru_baseband_iq_20170913_150437.dat"
needs_data = pytest.mark.skipif(not LONG.exists(), reason="the X4 recordings are not in ../shared/data/x4")
FOUR = RadarSpec.preset("x4m05", iterations=4, pulses_per_step=1, bins=180)


def recorded() -> np.ndarray:
    """The long recording, (9128, 180) complex."""
    raw = LONG.read_bytes()
    values = struct.unpack_from("<3I", raw)[2]
    rows = np.frombuffer(raw, np.uint8).reshape(-1, 12 + 4 * values)[:, 12:].copy().view("<f4")
    return (rows[:, : values // 2] + 1j * rows[:, values // 2 :]).astype(complex)


def still() -> np.ndarray:
    """The still part of the long recording, (n, 180) complex."""
    return recorded()[200:4900]


def novelda() -> np.ndarray:
    """The still part of Novelda's recording, (150, 54) complex."""
    raw = NOVELDA.read_bytes()
    bins = struct.unpack_from("<2I", raw)[1]
    rows = np.frombuffer(raw, np.uint8).reshape(-1, 24 + 8 * bins)[:, 24:].copy().view("<f4")
    return (rows[:, :bins] + 1j * rows[:, bins:])[:150].astype(complex)


def simulated(spec: RadarSpec, n: int = 4700) -> np.ndarray:
    """As many frames of an empty world, in normalised units."""
    return receive(np.zeros((n, spec.bins), complex), spec, seed=11).astype(complex) * unit(spec)


@pytest.fixture(scope="module")
def pair() -> dict[str, np.ndarray]:
    """Real and simulated frames."""
    return {"real": still(), "simulated": simulated(FOUR)}


def changes(frames: np.ndarray) -> np.ndarray:
    """From frame to frame, so that what stands still or drifts slowly drops out."""
    return np.diff(frames, axis=0) / np.sqrt(2)


def correlation(frames: np.ndarray, *, first: int, lags: int = 4) -> np.ndarray:
    """Complex correlation between bins at lags 1, 2, ..."""
    d = changes(frames)[:, first:]
    power = (abs(d) ** 2).mean()
    return np.array([(d[:, :-k] * d[:, k:].conj()).mean() / power for k in range(1, lags + 1)])


def against_mean(frames: np.ndarray, bins: slice) -> np.ndarray:
    """Relative change of each bin from frame to frame: real part amplitude, imaginary part phase."""
    mean = frames.mean(0)[bins]
    return np.diff(frames[:, bins] / mean, axis=0) / np.sqrt(2)


@needs_data
@pytest.mark.parametrize("which", ["real", "simulated"])
def test_1_additive_noise(pair, which):
    noise = changes(pair[which])[:, 100:]
    assert np.sqrt((abs(noise) ** 2).mean()) == pytest.approx(0.3455 * 1.16e-3 / 2, rel=0.04)  # sigma_c, four counts
    assert np.sqrt((abs(noise) ** 2).mean(0)) == pytest.approx(noise_sigma(FOUR), rel=0.08)  # whatever the range
    for part in (noise.real.ravel(), noise.imag.ravel()):
        assert abs(skew(part)) < 0.015
        assert abs(kurtosis(part)) < 0.02
        assert abs(part.mean()) < 0.01 * part.std()
    assert noise.real.std() == pytest.approx(noise.imag.std(), rel=0.02)
    assert abs(np.corrcoef(noise.real.ravel(), noise.imag.ravel())[0, 1]) < 0.02
    white = pair[which][:, 100:] - pair[which][:, 100:].mean(0)
    over_time = (white[:-1] * white[1:].conj()).mean().real / (abs(white) ** 2).mean()
    assert abs(over_time) < 0.06  # white over time; the real room drifts a little


@needs_data
@pytest.mark.parametrize("which", ["real", "simulated"])
def test_1_the_counts_can_be_read_out_of_the_lattice(pair, which):
    values = abs(np.concatenate([pair[which].real.ravel(), pair[which].imag.ravel()]))
    small = values[(values < 2e-4) & (values > 0)][:20_000]

    def fit(counts):
        return abs(np.exp(2j * np.pi * small * 1024 * FILTER_SCALE * counts).mean())

    assert fit(4) > 0.999
    assert max(fit(n) for n in (1, 2, 3, 5, 6, 7)) < 0.6


@needs_data
def test_2_correlation_between_bins(pair):
    real, ours = correlation(pair["real"], first=60), correlation(pair["simulated"], first=60)
    other = correlation(novelda(), first=24)
    for got in (real, ours, other):
        assert abs(got[0]) == pytest.approx(0.635, abs=0.02)
        assert 0.13 < abs(got[1]) < 0.175
        assert abs(got[2]) < 0.03
    assert np.abs(real - ours).max() < 0.035


@needs_data
@pytest.mark.parametrize("which", ["real", "simulated"])
def test_3_phase_and_amplitude_common_to_the_frame(pair, which):
    relative = against_mean(pair[which], slice(0, 8))
    assert relative.imag.std(0) == pytest.approx(0.0186, rel=0.10)
    between = np.corrcoef(relative.imag.T)
    assert between[0, :5].min() > 0.88
    assert (relative.real.std(0)[:2] > 0.001).all()
    assert (relative.real.std(0)[:2] < 0.0023).all()  # 0.1-0.2 %


@needs_data
@pytest.mark.parametrize("which", ["real", "simulated"])
def test_3_referring_to_the_direct_path_leaves_little_more_than_the_floor(pair, which):
    frames, mean = pair[which], pair[which].mean(0)
    phase = np.angle((frames[:, :8] * mean[:8].conj()).sum(1))
    before = abs(changes(frames)[:, :8]).std(0)
    after = np.sqrt((abs(changes(frames * np.exp(-1j * phase)[:, None])[:, :8]) ** 2).mean(0))
    assert after.max() < 1.8 * noise_sigma(FOUR)
    assert (np.sqrt((abs(changes(frames)[:, :6]) ** 2).mean(0)) > 3.5 * noise_sigma(FOUR)).all()
    assert before.max() > noise_sigma(FOUR)


def test_3_phase_at_many_counts():
    spec = RadarSpec.preset("x4m05", iterations=64, pulses_per_step=64)
    relative = against_mean(simulated(spec, 3000), slice(0, 8))
    assert relative.imag.std(0) == pytest.approx(0.010, rel=0.06)
    assert relative.imag.std() / (2 * np.pi * spec.center_hz) == pytest.approx(0.22e-12, rel=0.06)
    assert np.corrcoef(relative.imag.T).min() > 0.88


@needs_data
def test_4_direct_path(pair):
    table = [0.067, 0.068, 0.053, 0.049, 0.055, 0.047, 0.031, 0.018, 0.008]
    means = {k: v.mean(0) for k, v in pair.items()}
    for mean in means.values():
        assert abs(mean[:9]) == pytest.approx(table, abs=0.001)
        assert abs(mean[9]) < 0.0015  # the null
        assert 20 * np.log10(abs(mean[:2]).max() / noise_sigma(FOUR)) == pytest.approx(50, abs=1.5)
    turn = np.angle(means["real"][:9] * means["simulated"][:9].conj())
    assert abs(turn).max() < 0.05


def width_m(spec: RadarSpec) -> float:
    """Width of the pulse at half its amplitude."""
    t = np.linspace(-3e-9, 3e-9, 6001)
    return float(np.ptp(t[envelope(spec, t) > 0.5]) * 299792458 / 2)


def band_hz(spec: RadarSpec) -> float:
    """Width of the pulse's spectrum at -10 dB."""
    f = np.linspace(-1.5e9, 1.5e9, 6001)
    return float(np.ptp(f[spectrum(spec, f) > 10**-0.5]))


@pytest.mark.parametrize(
    ("pulse", "bandwidth_hz", "off"),
    [("gaussian", 1.4e9, (0.065, 0.02, 0.065)), ("raised-cosine", 1.46e9, (0.01, 0.01, 0.025))],
)
def test_5_pulse_widths(pulse, bandwidth_hz, off):
    """At RF, behind the filter, in frequency: a raised cosine has all three, a Gaussian of the nominal width nearly."""
    spec = RadarSpec.preset("x4m05", pulse=pulse, bandwidth_hz=bandwidth_hz)
    raw = spec.but(output="rf", bins=1504)
    assert width_m(raw) == pytest.approx(0.129, rel=off[0])
    assert width_m(spec) == pytest.approx(0.148, rel=off[1])
    assert band_hz(raw) == pytest.approx(1.49e9, rel=off[2])


def test_5_the_pulse_lasts_as_long_as_its_energy_and_peak_power_say():
    """Data sheet: 0.45, 1.47, 2.65 pJ at peaks of -0.7, 4.1, 6.3 dBm are 0.53 to 0.62 ns of peak power."""
    told = [pj * 1e-12 / (1e-3 * 10 ** (dbm / 10)) for pj, dbm in ((0.45, -0.7), (1.47, 4.1), (2.65, 6.3))]
    t = np.linspace(-3e-9, 3e-9, 6001)
    lasts = np.trapezoid(envelope(RadarSpec.preset("x4m05", output="rf", bins=1504), t) ** 2, t)
    assert min(told) < lasts < max(told)


def test_2_baseband_amplitude_over_the_rf_envelope():
    """0.78: from the filter whose noise is 0.3455 of RF's for a steady tone; from recordings for pulses."""
    taps = chip_taps()
    tone = SIGMA_RATIO / np.linalg.norm(taps) / 2  # half of a real carrier's amplitude is left after mixing
    assert FOUR.noise.baseband_gain == pytest.approx(0.78)
    assert tone == pytest.approx(FOUR.noise.baseband_gain, rel=0.02)
    rf, low = (unit(RadarSpec.preset("x4m05", output=o, bins=188)) for o in ("rf", "baseband"))
    assert low / rf == pytest.approx(0.78)


@needs_data
def test_4_the_direct_path_of_one_module_falls_as_that_of_the_other():
    """Taken from the long recording, tested on Novelda's first three bins, 0.33 to 0.44 m: one shift under a bin."""
    spec = RadarSpec.preset("x4m05", bins=54)
    real = 20 * np.log10(abs(novelda().mean(0)[:3]))
    worst = {}
    for shift in np.arange(-0.05, 0.051, 0.005):
        ours = abs(leakage(spec.but(range_start_m=0.33432 + shift)))[:3] * spec.noise.baseband_gain
        worst[shift] = abs(20 * np.log10(ours) - real).max()
    assert min(worst.values()) < 1.5


def test_6_a_room_is_as_loud_as_the_recorded_ones():
    """This holds `unit_gain` in place: strongest echoes of 2-3e-3, allowing 8 dB for rooms unlike each other."""
    spec = RadarSpec.preset("x4m05", iterations=64, pulses_per_step=64)
    strongest = []
    for size, yaw in (((6, 4, 3), 0), ((6, 4, 3), 90), ((8, 6, 3), 0), ((5, 5, 2.6), 180)):
        at = ul.Trajectory.stationary((-0.7, 0.4, -0.1), yaw_deg=yaw)
        room = ul.scenes.room(size_m=size, material="concrete")
        quiet = spec.but(noise=spec.noise.but(leakage=False))
        echo = abs(simulate(room, at, quiet, fidelity="physical").samples[0]) * unit(spec)
        strongest.append(echo[spec.range_m > 1].max())
    off_db = 20 * np.log10(np.array(strongest) / 2.5e-3)
    assert abs(np.median(off_db)) < 8
