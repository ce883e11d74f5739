"""Power laws, whiteness and distribution of the noise, measured on simulated frames alone."""

import numpy as np
import pytest
from scipy.stats import kstest

from ullage.radar.receiver import lattice, noise_sigma, receive, unit
from ullage.specs import NoiseSpec, RadarSpec

ONLY = NoiseSpec(leakage=False, phase_rad=0, phase_thermal_rad=0, amplitude=0)


def frames(spec: RadarSpec, n: int = 400) -> np.ndarray:
    kind = np.float32 if spec.output == "rf" else np.complex64
    return receive(np.zeros((n, spec.bins), kind), spec, seed=2)


@pytest.mark.parametrize("output", ["rf", "baseband"])
def test_noise_power_falls_as_one_over_the_counts(output):
    settings = [(4, 1), (16, 4), (64, 64), (64, 90), (255, 1000)]
    measured = []
    for iterations, pulses in settings:
        spec = RadarSpec(
            output=output, bins=512, iterations=iterations, pulses_per_step=pulses, noise=ONLY.but(lattice=False)
        )
        measured.append(np.sqrt((abs(frames(spec)) ** 2).mean()))
    counts = np.array([a * b for a, b in settings])
    slope = np.polyfit(np.log(counts), np.log(measured), 1)[0]
    assert slope == pytest.approx(-0.5, abs=0.005)
    spec = RadarSpec(output=output, iterations=4, pulses_per_step=1)
    assert measured[0] == pytest.approx(noise_sigma(spec) / unit(spec), rel=0.01)


def test_the_measured_rf_sigmas():
    for (iterations, pulses), sigma in {(4, 1): 5.87e-4, (64, 64): 1.80e-5, (64, 90): 1.53e-5}.items():
        spec = RadarSpec(output="rf", bins=1504, iterations=iterations, pulses_per_step=pulses, noise=ONLY)
        assert frames(spec).std() * unit(spec) == pytest.approx(sigma, rel=0.025)


def test_rf_noise_is_white_gaussian_and_independent_of_range():
    spec = RadarSpec(output="rf", bins=1504, noise=ONLY)
    noise = frames(spec).astype(float) * unit(spec)
    assert abs(noise.mean()) < 3e-3 * noise.std()
    assert kstest(noise[::4].ravel() / noise.std(), "norm").statistic < 0.006
    for lag in (1, 2, 3, 8, 100):
        assert abs(np.mean(noise[:, :-lag] * noise[:, lag:])) < 0.006 * noise.var()
    assert np.mean(noise[:-1] * noise[1:]) == pytest.approx(0, abs=0.006 * noise.var())
    assert noise.reshape(400, 16, 94).std((0, 2)) == pytest.approx(noise_sigma(spec), rel=0.02)
    spectrum = (abs(np.fft.rfft(noise)) ** 2).mean(0)[1:-1]
    assert spectrum.std() < 0.07 * spectrum.mean()


def test_the_lattice_alone_moves_a_value_by_less_than_half_a_step():
    spec = RadarSpec(output="rf", bins=1504, iterations=4, pulses_per_step=1, noise=ONLY.but(thermal=0))
    wave = (1e-3 * np.random.default_rng(0).normal(size=(3, 1504))).astype(np.float32)
    off = (receive(wave, spec, seed=0) - wave) * unit(spec)
    assert abs(off).max() <= 0.5 * lattice(spec) * 1.001
    assert off.std() == pytest.approx(lattice(spec) / np.sqrt(12), rel=0.05)


def test_a_coarser_dac_step_costs_noise():
    sigma = [frames(RadarSpec(dac_step=s, noise=ONLY)).std() for s in (0, 1, 2)]
    assert sigma[1] / sigma[0] == pytest.approx(np.sqrt(2), rel=0.02)
    assert sigma[2] / sigma[0] == pytest.approx(2, rel=0.02)
