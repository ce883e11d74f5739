import numpy as np
import pytest
from ideal_points import frames_of_points, width

import ullage as ul
from ullage.geometry import C0
from ullage.processing.backprojection import Backprojector, oversampled

TRACK = ul.Trajectory.line((0, -0.25, 0), (0, 0.25, 0), 0.17, 17)  # 1 cm steps
TARGET = (3.0, 0.1, 0.0)


@pytest.mark.parametrize("output", ["baseband", "rf"])
def test_a_point_is_where_it_is_and_has_its_amplitude(output):
    spec = ul.RadarSpec.preset(
        "x4m05", antenna={"kind": "isotropic"}, noise=None, output=output, bins=188 if output == "baseband" else 1000
    )
    frames = frames_of_points([TARGET], TRACK, spec=spec)
    grid = ul.Grid((2.796, -0.1 + 0.004 - 0.008, 0.0), 0.008, (50, 50))
    image = ul.focus(frames, grid, window="none")
    assert np.abs(image.peak_m - TARGET).max() <= 0.006
    assert image.amplitude.max() == pytest.approx(1.0, abs=0.01)
    cell = np.unravel_index(np.argmax(image.amplitude), image.grid.shape)
    assert image.coherence[cell] > 0.99
    offset = np.linalg.norm(image.peak_m) - np.linalg.norm(TARGET)
    assert abs(np.angle(image.values[cell])) < 4 * np.pi * 7.29e9 / C0 * abs(offset) + 0.05


def test_range_width_is_the_pulses():
    frames = frames_of_points([(3.0, 0, 0)], ul.Trajectory.stationary())
    grid = ul.Grid((2.8, -0.001, 0.0), 0.002, (1, 200))
    image = ul.focus(frames, grid)
    theory = C0 / 2 * 2 * frames.spec.pulse_sigma_s * np.sqrt(np.log(2))  # |p|^2 = exp(-t^2/sigma^2) falls to a half
    assert width(grid.x_m, image.amplitude[0].astype(float) ** 2, 10 * np.log10(2)) == pytest.approx(theory, rel=0.05)


@pytest.mark.parametrize("distance", [2.0, 4.0])
def test_cross_range_width_is_that_of_the_aperture(distance):
    frames = frames_of_points([(distance, 0, 0)], TRACK)
    length = 0.51  # 51 positions 1 cm apart stand for 51 cm
    grid = ul.Grid((distance - 0.001, -0.2, 0.0), 0.002, (200, 1))
    image = ul.focus(frames, grid, window="none")
    theory = 0.886 * frames.spec.wavelength_m * distance / (2 * length)
    assert width(grid.y_m, image.amplitude[:, 0].astype(float) ** 2) == pytest.approx(theory, rel=0.05)


def test_chunks_and_threads_change_nothing():
    frames = frames_of_points([TARGET, (2.5, -0.3, 0.4)], TRACK, noise=0.1)
    grid = ul.Grid((2.0, -0.5, 0.1), 0.05, (21, 30))
    whole = ul.focus(frames, grid, window="none", threads=1)
    two = ul.focus(frames, grid, window="none", threads=2)
    stream = Backprojector(grid)
    for part in frames.chunks(7):
        stream.update(part)
    assert np.array_equal(whole.values, two.values)
    assert np.array_equal(whole.values, stream.image().values)


def test_against_the_slow_twin():
    rng = np.random.default_rng(4)
    frames = frames_of_points([(1.5, 0.4, 0.3), (2.0, -0.5, -0.2)], TRACK, noise=0.05)
    grid = ul.Grid((1.2, -0.6, -0.3), 0.23, (3, 5, 4))
    image = ul.focus(frames, grid, window="none")
    delay = 2 * frames.range_m / C0
    for _ in range(10):
        z, y, x = (int(rng.integers(n)) for n in grid.shape)
        reach = np.linalg.norm([grid.x_m[x], grid.y_m[y], grid.z_m[z]] - TRACK.position, axis=1)
        fine = np.stack([np.sinc((2 * r / C0 - delay) / frames.spec.step_s) for r in reach])
        echo = (frames.samples * fine).sum(1) * np.exp(4j * np.pi * frames.spec.center_hz * reach / C0)
        assert image.values[z, y, x] == pytest.approx(echo.mean(), abs=0.02)


def test_oversampling_keeps_a_pulse():
    spec = ul.RadarSpec.preset("x4m05")
    fine_axis = np.linspace(spec.range_m[0], spec.range_m[-1], 187 * 8 + 1)
    shape = [np.exp(-((axis - 3.0217) ** 2) / (2 * 0.0517**2)) for axis in (spec.range_m, fine_axis)]
    fine = oversampled(shape[0][None].astype(np.complex64), 8)[0]
    assert np.abs(fine - shape[1]).max() < 7e-3  # the pulse itself keeps 0.7 % at the Nyquist frequency of the bins


def test_a_grid_too_large_is_refused_before_it_is_made():
    with pytest.raises(ul.InputError, match=r"20.0 GB"):
        Backprojector(ul.Grid((0, 0, 0), 0.01, (1000, 1000, 1000)))


def test_frames_without_poses_or_with_nan_are_refused():
    frames = frames_of_points([TARGET], TRACK)
    bare = ul.Frames(frames.samples, frames.range_m, frames.t_ns, frames.spec)
    grid = ul.Grid((0, 0, 0), 0.1, (10, 10))
    with pytest.raises(ul.InputError, match="no poses"):
        ul.focus(bare, grid)
    bad = frames.samples.copy()
    bad[3, 7] = np.nan
    broken = ul.Frames(bad, frames.range_m, frames.t_ns, frames.spec, poses=TRACK)
    with pytest.raises(ul.InputError, match="frame 3, bin 7 is not finite"):
        ul.focus(broken, grid)
    with pytest.raises(ul.InputError, match="backprojection, summation"):
        ul.focus(frames, grid, method="magic")
