"""The radar's own echo is found and removed; walls beside the track, reflectors and chunks come through unharmed."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import ullage as ul
from ullage.processing.own_echo import OwnEchoFilter, own_echo

DATA = Path(__file__).parents[3] / "shared" / "data" / "pulson440"
needs_data = pytest.mark.skipif(not DATA.exists(), reason="the real recordings are not here")
LENGTH_M = 3.0


def track(wander_m: float, *, hover: int = 0, seed: int = 1) -> ul.Trajectory:
    """A flight along y past a wall at +x that strays by so much, rms in x and z, and may hover at its start."""
    path = ul.Trajectory.line((0, -LENGTH_M / 2, 0), (0, LENGTH_M / 2, 0), 0.3, 17)
    rng, u = np.random.default_rng(seed), np.linspace(0, 2 * np.pi, len(path))
    stray = np.zeros((len(path), 3))
    for axis in (0, 2):
        size = rng.normal(size=6)
        size *= wander_m * np.sqrt(2) / np.linalg.norm(size)
        stray[:, axis] = sum(a * np.sin((k + 1) * u + rng.uniform(0, 6)) for k, a in enumerate(size))
    position = np.concatenate([np.tile((path.position + stray)[:1], (hover, 1)), path.position + stray])
    times = np.arange(len(position)) * 58_823_529
    return ul.Trajectory(times, position, np.tile([0.0, 0, 0, 1], (len(position), 1)))


def beside_wall(preset: str, distance_m: float, path: ul.Trajectory, **changes: object) -> ul.Frames:
    scene = ul.scenes.plate(width_m=6, height_m=3, distance_m=distance_m, material="concrete")
    frames = ul.simulate(scene, path, ul.RadarSpec.preset(preset, **changes), seed=1)
    assert isinstance(frames, ul.Frames)
    return frames


def profile_db(frames: ul.Frames, **options: bool) -> tuple[np.ndarray, np.ndarray]:
    """Ranges from the track and the image's level there, rms along the middle of the wall [dB]."""
    image = ul.focus(frames, ul.Grid((0.05, -1.0, 0), 0.02, (100, 75)), **options)
    return image.grid.x_m, 10 * np.log10(np.maximum((image.amplitude[30:70] ** 2).mean(axis=0), 1e-30))


@pytest.mark.parametrize(
    ("preset", "wander_m"), [("x4m05", 0.0), ("x4m05", 0.003), ("x4m05", 0.02), ("pulson440", 0.01)]
)
@pytest.mark.parametrize("distance_m", [0.5, 0.7, 1.0])
def test_a_wall_beside_the_track_survives(preset: str, wander_m: float, distance_m: float) -> None:
    path = track(wander_m)
    frames = beside_wall(preset, distance_m, path)
    x, ideal = profile_db(beside_wall(preset, distance_m, path, noise=None))
    _, kept = profile_db(frames, remove_own_echo=False)
    _, found = profile_db(frames)
    wall = abs(x - distance_m) < 0.12
    assert abs(x[wall][found[wall].argmax()] - distance_m) <= 0.021
    assert found[wall].max() == pytest.approx(ideal[wall].max(), abs=0.5)
    if preset == "x4m05":
        own = x < min(0.25, distance_m - 0.25)
        assert kept[own].max() > ideal[wall].max()  # the own echo outshines the wall
        assert found[own].max() < kept[own].max() - 35
    else:  # the measured ring-down begins at 0.55 m
        own = (x > 0.6) & (abs(x - distance_m) > 0.3)
        assert found[own].max() < kept[own].max() - 25


def test_a_perfectly_straight_track_hides_a_wall_within_the_ring_down() -> None:
    """What cannot be told apart is removed up to `own_echo_m` and left alone beyond; the result says so."""
    frames = beside_wall("pulson440", 1.0, track(0.0))
    assert own_echo(frames).ambiguity > 0.99
    assert own_echo(beside_wall("pulson440", 1.0, track(0.02))).ambiguity < 0.5
    x, kept = profile_db(frames, remove_own_echo=False)
    wall = abs(x - 1.0) < 0.12
    short = replace(frames, spec=frames.spec.but(own_echo_m=0.45))
    assert profile_db(frames)[1][wall].max() < kept[wall].max() - 30
    assert profile_db(short)[1][wall].max() == pytest.approx(kept[wall].max(), abs=0.5)


def test_an_echo_measured_elsewhere_frees_a_wall_on_a_straight_track() -> None:
    free = ul.simulate(ul.scenes.plate(width_m=0.1, height_m=0.1, distance_m=9), track(0.02),
                       ul.RadarSpec.preset("pulson440"), seed=2)  # fmt: skip
    assert isinstance(free, ul.Frames)
    frames = beside_wall("pulson440", 0.7, track(0.0))
    x, ideal = profile_db(beside_wall("pulson440", 0.7, track(0.0), noise=None))
    _, found = profile_db(own_echo(free).removed_from(frames), remove_own_echo=False)
    wall = abs(x - 0.7) < 0.12
    assert found[wall].max() == pytest.approx(ideal[wall].max(), abs=0.8)  # beside the measured ring-down


def test_hovering_beside_a_wall_changes_nothing() -> None:
    flown, hovered = (beside_wall("x4m05", 0.5, track(0.02, hover=n)) for n in (0, 600))
    one, other = own_echo(flown), own_echo(hovered)
    assert other.places == one.places
    near = one.range_m < 0.4
    gap = np.linalg.norm((other.profile - one.profile)[near]) / np.linalg.norm(one.profile[near])
    assert gap < 0.01


def test_a_slow_drift_of_the_instrument_is_followed() -> None:
    frames = beside_wall("x4m05", 1.0, track(0.02))
    drift = np.exp((0.05 + 0.2j) * np.linspace(0, 1, len(frames)))[:, None]
    drifting = replace(frames, samples=(frames.samples * drift).astype(np.complex64))
    found = own_echo(drifting)
    near = found.range_m < 0.25
    assert (found.received_db - found.remaining_db)[near].min() > 30


def test_what_was_removed_is_reported() -> None:
    frames = beside_wall("x4m05", 1.0, track(0.02))
    found = own_echo(frames)
    assert found.sensor == frames.sensor
    assert found.extent_m == 0.45
    assert 0.9 < found.energy_share < 1
    assert found.level_db.shape == found.range_m.shape == found.remaining_db.shape
    assert found.level_db[0] == pytest.approx(found.received_db[0], abs=0.2)


@pytest.mark.parametrize("changes", [{"noise": None}, {"noise": {"leakage": False}}])
def test_nothing_is_removed_where_nothing_leaks(changes: dict[str, object]) -> None:
    frames = beside_wall("x4m05", 0.5, track(0.0), **changes)
    found = own_echo(frames)
    assert found.energy_share == 0
    assert found.removed_from(frames) is frames


def test_dropped_samples_stay_zero() -> None:
    frames = beside_wall("pulson440", 1.0, track(0.02))
    samples = frames.samples.copy()
    samples[40, :350] = 0
    assert (
        not own_echo(replace(frames, samples=samples))
        .removed_from(replace(frames, samples=samples))
        .samples[40, :350]
        .any()
    )


def test_frames_as_they_come_lose_the_own_echo_too() -> None:
    frames = beside_wall("x4m05", 0.7, track(0.02))
    one = OwnEchoFilter()
    parts = [one.clean({"radar": part})["radar"] for part in frames.chunks(20)]
    late = np.concatenate([part.samples for part in parts])[60:]
    near = frames.range_m < 0.25
    assert np.abs(late[:, near]).max() < 0.05 * np.abs(frames.samples[:, near]).max()
    assert one.found["radar"].places > 20


def test_detections_and_maps_are_freed_of_it_by_default() -> None:
    frames = beside_wall("x4m05", 0.7, track(0.02))
    kept = ul.detect(frames, min_range_m=0.0, remove_own_echo=False)
    found = ul.detect(frames, min_range_m=0.0)
    assert np.median(kept.range_m) < 0.3
    assert np.median(found.range_m) == pytest.approx(0.7, abs=0.05)
    grid = ul.Grid((-1, -2.5, 0), 0.1, (50, 40))
    omap = ul.map_occupancy(frames, grid)
    x = omap.grid.x_m[np.nonzero(omap.occupied)[1]]
    assert len(x)
    assert np.median(x) == pytest.approx(0.7, abs=0.15)
    assert not ((x > 0.0) & (x < 0.45)).any()


def placed(frames: ul.Frames, track: ul.Trajectory, t_s: float, range_m: float) -> ul.Frames:
    """Frames on the poses' clock, with true ranges."""
    t_ns = frames.t_ns + round(t_s * 1e9)
    inside = (t_ns >= track.t_ns[0]) & (t_ns <= track.t_ns[-1])
    return replace(frames, samples=frames.samples[inside], t_ns=t_ns[inside], poses=track.at(t_ns[inside]),
                   range_m=frames.range_m + range_m, track=None)  # fmt: skip


def rail_a() -> tuple[ul.Frames, np.ndarray]:
    source = ul.open(DATA / "rail_a")
    frames = source.frames()
    known = np.load(DATA / "rail_a/decoded.npz")
    offsets = float(known["t_offset_s"]), -float(known["range_offset_m"])
    return placed(frames, frames.track, *offsets), source.reflectors()[0]


def flight_a() -> tuple[ul.Frames, np.ndarray]:
    from ullage.ports.tracks import read_tracks

    track = read_tracks(DATA / "flight_a/mocap.csv")["Radar"]
    known = np.load(DATA / "flight_a/radar.npz")
    range_m, t_ms = known["range_m"], known["t_ms"].astype(np.int64)
    spec = ul.RadarSpec.preset("pulson440", range_start_m=float(range_m[0]), bins=len(range_m))
    frames = ul.Frames(known["scans"].astype(np.float32), range_m, (t_ms - t_ms[0]) * 10**6 + track.t_ns[0], spec,
                       unit="normalised")  # fmt: skip
    return placed(frames, track, 6.60, -0.32), np.array([1.793, 1.810, -0.017])


@needs_data
@pytest.mark.filterwarnings("ignore:.*packets are missing:ullage.errors.UllageWarning")
@pytest.mark.parametrize(("recording", "gone_db"), [(rail_a, 10), (flight_a, 6)])
def test_real_reflectors_stay_and_the_wall_along_the_track_goes(recording, gone_db: float) -> None:  # type: ignore[no-untyped-def]
    frames, truth = recording()
    path = frames.poses.position
    levels = []
    for removed in (False, True):
        at = ul.Grid((truth[0] - 0.5, truth[1] - 0.5, truth[2]), 0.03, (33, 33))
        near = ul.focus(frames, at, antenna=False, remove_own_echo=removed)
        assert np.linalg.norm(near.peak_m - truth) < 0.06
        box = np.stack([path.min(0), path.max(0)])
        plane = ul.Grid.covering(box, 0.05, z_m=float(path[:, 2].mean()), margin_m=0.5)
        along = ul.focus(frames, plane, antenna=False, remove_own_echo=removed)
        power = float((along.amplitude.astype(float) ** 2).mean())
        levels.append((20 * np.log10(near.amplitude.max()), 10 * np.log10(power)))
    (reflector, wall), (reflector_after, wall_after) = levels
    assert reflector_after == pytest.approx(reflector, abs=0.5)
    assert wall_after < wall - gone_db
