"""Maps of recordings: phase of RF samples, floors, coherent scatterers, and the surveyed reflectors of real flights."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import ullage as ul
from ullage.data import Calibration
from ullage.processing.baseband import as_baseband, to_baseband
from ullage.processing.calibrate import _floor_zero, _Prior
from ullage.processing.floor import floor_echo
from ullage.processing.own_echo import without_own_echo
from ullage.processing.scatterers import Scatterer, find_scatterers, with_scatterers

DATA = Path(__file__).parents[3] / "shared" / "data" / "pulson440"
OFFSETS = {"rail_a": (4.44, -0.425), "flight_a": (6.60, -0.30)}  # clock [s] and range [m], from the data's README
KNOWN = Calibration(0.0, 0.0, 0.01, 0.01, 1.0)


def path_of(position: np.ndarray) -> ul.Trajectory:
    t_ns = (np.arange(len(position)) * 20_000_000).astype(np.int64)
    return ul.Trajectory(t_ns, position, np.tile([0.0, 0, 0, 1], (len(position), 1)))


def rf_frames(position: np.ndarray, distances: list[np.ndarray], *, noise: float = 0.05) -> ul.Frames:
    """RF frames of a PulsON 440 with echoes of amplitude 1 at these distances (n) [m] in white noise."""
    spec = ul.RadarSpec.preset("pulson440", bins=900, range_start_m=0.7)
    sigma_m = 0.5 * 299_792_458 * spec.pulse_sigma_s
    samples = np.random.default_rng(4).normal(0, noise, (len(position), 900))
    for distance in distances:
        away = spec.range_m - distance[:, None]
        samples += np.exp(-0.5 * (away / sigma_m) ** 2) * np.cos(4 * np.pi / spec.wavelength_m * away)
    path = path_of(position)
    return ul.Frames(samples, spec.range_m, path.t_ns, spec, poses=path, sensor="pulson", unit="normalised")


def near(frames: ul.Frames, bins: int = 330) -> ul.Frames:
    """The first bins, to 3.7 m: a smaller volume to search."""
    spec = frames.spec.but(bins=bins)
    return replace(frames, samples=frames.samples[:, :bins], range_m=frames.range_m[:bins], spec=spec)


def curved(n: int = 300) -> np.ndarray:
    s = np.linspace(0, 1, n)
    return np.stack([0.5 * np.sin(3 * s), 4 * s, 1.2 + 0.5 * np.sin(5 * s)], axis=1)


def test_baseband_keeps_range_phase_and_amplitude() -> None:
    position = curved(40)
    frames = rf_frames(position, [np.linalg.norm(position - (3, 2, 1), axis=1)], noise=0.0)
    got = as_baseband(frames)
    every = round(float(np.diff(got.range_m).mean() / np.diff(frames.range_m).mean()))
    assert every >= 2
    full = to_baseband(frames)[:, ::every]
    assert abs(got.samples - full).max() < 0.03 * abs(full).max()
    np.testing.assert_allclose(got.spec.range_m, got.range_m, atol=1e-6)
    assert as_baseband(got) is got


def test_a_reflector_under_the_noise_of_a_profile_is_found_from_the_track() -> None:
    position, place = curved(), np.array([3.0, 2.0, 0.3])
    frames = rf_frames(position, [np.linalg.norm(position - place, axis=1)], noise=1.0)
    found = find_scatterers(near(frames))
    assert np.linalg.norm(found[0].place - place) < 0.05
    assert found[0].height_known
    assert find_scatterers(near(rf_frames(position, [], noise=1.0))) == []


def clutter(position: np.ndarray, *, seed: int, length: float = 25.0) -> ul.Frames:
    """Frames in which every range bin fades slowly along the track, with noise of a third, and nothing focuses."""
    rng = np.random.default_rng(seed)
    white = rng.normal(size=(len(position), 900))
    lag = np.arange(len(position))
    window = np.exp(-0.5 * (np.minimum(lag, len(lag) - lag) / length) ** 2)
    slow = np.fft.irfft(np.fft.rfft(white, axis=0) * np.fft.rfft(window)[:, None], len(position), axis=0)
    samples = slow / slow.std() + 0.3 * rng.normal(size=slow.shape)
    return replace(rf_frames(position[:1], []), samples=samples.astype(np.float32), t_ns=path_of(position).t_ns,
                   poses=path_of(position))  # fmt: skip


def test_clutter_that_fades_slowly_along_the_track_is_no_scatterer() -> None:
    assert find_scatterers(near(clutter(curved(), seed=0)), everywhere=True) == []


@pytest.mark.slow
def test_scatterers_are_false_as_often_as_asked() -> None:
    """Of 12 recordings of clutter at a probability of 0.4, 1 to 9 give alarms in all but one case in 190."""
    alarms = sum(bool(find_scatterers(near(clutter(curved(), seed=k)), pfa=0.4, everywhere=True)) for k in range(12))
    assert 1 <= alarms <= 9


def test_a_scatterer_in_clutter_is_found_among_no_others() -> None:
    position, place = curved(), np.array([3.0, 2.0, 0.3])
    echo = rf_frames(position, [np.linalg.norm(position - place, axis=1)], noise=0.0)
    frames = clutter(position, seed=2)
    found = find_scatterers(near(replace(frames, samples=frames.samples + 2 * echo.samples)))
    assert found
    assert all(np.linalg.norm(one.place - place) < 0.2 for one in found)
    assert found[0].chance < 0.01


@pytest.mark.parametrize("pfa", [0.0, 1.0, float("nan")])
def test_a_false_alarm_probability_has_bounds(pfa: float) -> None:
    with pytest.raises(ul.InputError, match=r"pfa is .*allowed: between 0 and 1"):
        find_scatterers(clutter(curved(40), seed=0), pfa=pfa)


def test_a_scatterer_where_the_vehicle_flew_shows_only_where_it_outweighs_the_flight() -> None:
    grid = ul.Grid((0.0, 0.0, 1.0), 0.1, (20, 20))
    percent = np.full(grid.shape, -1, np.int8)
    percent[:, 5], percent[:, 10] = 0, 1  # flown through, and freed by silence
    omap = ul.OccupancyMap(grid, percent)
    for x, chance, shown in ((0.55, 0.01, False), (0.55, 1e-5, True), (1.55, 0.01, True), (1.55, 0.1, False),
                             (1.05, 0.01, True), (1.05, 0.1, False)):  # fmt: skip
        got = with_scatterers(omap, [Scatterer(np.array([x, 1.05, 1.0]), 100.0, True, chance)])
        assert got.occupied.any() == shown, (x, chance)
    assert with_scatterers(omap, []).percent is omap.percent


def test_a_straight_track_takes_the_height_that_is_given() -> None:
    position, place = np.stack([np.zeros(300), np.linspace(0, 4, 300), np.full(300, 1.8)], axis=1), (4.0, 2.0, 0.1)
    frames = rf_frames(position, [np.linalg.norm(position - place, axis=1)])
    best = find_scatterers(frames, z_m=0.1)[0]
    assert not best.height_known
    np.testing.assert_allclose(best.place, place, atol=0.06)


def test_calibrated_frames_map_their_scatterers_and_nothing_on_the_path() -> None:
    position, place = curved(), np.array([3.0, 2.0, 0.3])
    frames = rf_frames(position, [np.linalg.norm(position - place, axis=1)], noise=1.0)
    grid = ul.Grid.covering(np.array([[-2.0, -2, 0], [5, 6, 2]]), 0.1)
    omap = ul.map_occupancy(replace(near(frames), calibration=KNOWN), grid, remove_own_echo=False)
    assert to_nearest(omap, place[None]) < 0.15
    assert to_nearest(omap, position) > 0.3


def test_a_known_floor_is_no_wall_along_a_straight_track() -> None:
    position = np.stack([np.zeros(300), np.linspace(0, 4, 300), np.full(300, 1.8)], axis=1)
    frames = rf_frames(position, [np.full(300, 1.8)], noise=0.01)
    grid = ul.Grid.covering(np.array([[-4.0, -2, 0], [4, 6, 2]]), 0.1)
    assert ul.map_occupancy(frames, grid, remove_own_echo=False).occupied.any()
    assert not ul.map_occupancy(frames, grid, remove_own_echo=False, floor_z_m=0.0).occupied.any()


@pytest.mark.parametrize("long_m", [-0.15, 0.0, 0.2])
def test_the_floor_shows_an_error_of_the_range_axis(long_m: float) -> None:
    position = curved()
    frames = rf_frames(position, [position[:, 2] + long_m], noise=0.5)
    found = floor_echo(frames)
    assert found is not None
    assert abs(found.long_m - long_m) < 0.04
    assert floor_echo(rf_frames(position, [], noise=0.5)) is None
    level = position * [1, 1, 0] + [0, 0, 1.5]
    assert floor_echo(rf_frames(level, [level[:, 2]])) is None


@pytest.mark.parametrize("long_m", [-0.15, 0.0, 0.2])
def test_a_floor_that_contradicts_the_range_offset_becomes_its_zero(long_m: float) -> None:
    position = curved()
    frames = rf_frames(position, [position[:, 2] + long_m], noise=0.5)
    known, found = _Prior.of(None, frames, 1.0), Calibration(0.0, -0.45, 0.01, 0.02, 1.0)
    prior = _floor_zero(known, found, frames, 0.0)
    if long_m:
        assert abs(prior.range_m - (-0.45 - long_m)) < 0.04
        assert prior.range_sigma_m < 0.1
        assert "floor" in prior.zero
    else:
        assert prior == known


def to_nearest(omap: ul.OccupancyMap, places: np.ndarray) -> float:
    """Least distance in plan between occupied cells and places [m]."""
    y, x = np.nonzero(omap.occupied)
    cells = np.stack([omap.grid.x_m[x], omap.grid.y_m[y]], axis=1)
    return float(np.linalg.norm(cells[:, None] - places[None, :, :2], axis=2).min(initial=np.inf))


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore::ullage.errors.UllageWarning")
@pytest.mark.parametrize("name", ["rail_a", "flight_a"])
def test_the_surveyed_reflector_is_on_the_map_and_nothing_on_the_path(name: str) -> None:
    """With the offsets that the data's README documents."""
    if not (DATA / name).exists():
        pytest.skip("the real recordings are not here")
    source = ul.open(DATA / name)
    raw, mark = source.frames(), source.reflectors()[0]
    assert isinstance(raw, ul.Frames)
    assert raw.track is not None
    clock_s, range_m = OFFSETS[name]
    t_ns = raw.t_ns + round(clock_s * 1e9)
    inside = (t_ns >= raw.track.t_ns[0]) & (t_ns <= raw.track.t_ns[-1])
    frames = replace(raw[inside], t_ns=t_ns[inside], poses=raw.track.at(t_ns[inside]), truth=None,
                     range_m=raw.range_m + range_m, calibration=KNOWN)  # fmt: skip
    position = frames.believed.position
    bounds = np.stack([position.min(0) - 7, position.max(0) + 7])
    omap = ul.map_occupancy(frames, ul.Grid.covering(bounds, 0.1), floor_z_m=0.0,
                            target_z_m=float(mark[2]), vehicle_radius_m=0.3)  # fmt: skip
    assert to_nearest(omap, mark[None]) < 0.15
    assert to_nearest(omap, position) > 0.3
    if name == "flight_a":
        floor = floor_echo(without_own_echo(frames)[0])
        assert floor is not None
        assert abs(floor.long_m) < 0.05
    else:  # the floor, 1.8 m under the rail, is no wall along it
        _, x = np.nonzero(omap.occupied)
        beside = abs(omap.grid.x_m[x] - (position[:, 0].mean() + 1.8)) < 0.2
        assert beside.sum() <= 2
