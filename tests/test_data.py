"""Trajectories and frames: laws of motion, cutting and joining, bad input."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

import ullage as ul
from ullage.data import even_times, joined, sensors_of
from ullage.geometry import apply, quat_matrix, rpy_quat, transform


def circle(n: int = 200) -> ul.Trajectory:
    """One turn in 10 s at 2 m radius, nose along the path."""
    t_ns = even_times(20.0, count=n)
    angle = 2 * np.pi * t_ns * 1e-9 / 10
    position = np.stack([2 * np.cos(angle), 2 * np.sin(angle), np.full(n, 1.0)], axis=1)
    return ul.Trajectory(t_ns, position, rpy_quat(np.zeros(n), np.zeros(n), angle + np.pi / 2))


def frames(n: int = 10, bins: int = 16) -> ul.Frames:
    path = ul.Trajectory.stationary(n=n)
    rng = np.random.default_rng(1)
    samples = (rng.normal(size=(n, bins)) + 1j * rng.normal(size=(n, bins))).astype(np.complex64)
    spec = ul.RadarSpec.preset("x4m05")
    return ul.Frames(samples, np.arange(bins) * 0.05, path.t_ns, spec, path, path, "front")


def test_rates_of_a_circle_are_those_of_the_circle() -> None:
    path = circle()
    velocity, spin = path.rates
    speed = np.linalg.norm(velocity, axis=1)[5:-5]
    assert np.allclose(speed, 2 * 2 * np.pi / 10, rtol=1e-3)
    assert np.allclose(spin[5:-5], [0, 0, 2 * np.pi / 10], atol=1e-6)


@given(st.floats(0.0, 9.9))
def test_interpolation_stays_on_the_circle(t_s: float) -> None:
    at = circle().at(round(t_s * 1e9))
    assert abs(np.linalg.norm(at.position[0, :2]) - 2) < 1e-4
    heading = quat_matrix(at.quat_xyzw)[0, :2, 0]
    assert abs(heading @ at.position[0, :2]) < 1e-2


def test_a_mounted_sensor_moves_rigidly_with_the_body() -> None:
    path = circle()
    arm = transform((0.3, 0.1, -0.2), (0.1, 0.2, 0.3))
    sensor = path.mounted(arm)
    assert np.allclose(sensor.position[7], apply(path.world_from_body[7], arm[:3, 3][None])[0])
    numeric = np.gradient(sensor.position, sensor.t_ns * 1e-9, axis=0)
    assert np.allclose(sensor.velocity[5:-5], numeric[5:-5], atol=2e-3)


def test_a_line_has_one_sample_per_period_and_the_asked_speed() -> None:
    path = ul.Trajectory.line((0, 0, 1), (2, 0, 1), 0.5, 10)
    assert len(path) == 41
    assert path.duration_s == pytest.approx(4.0)
    assert np.allclose(path.velocity, [0.5, 0, 0])


@given(st.integers(1, 9))
def test_cutting_and_joining_gives_the_same_bits(at: int) -> None:
    whole = frames()
    again = joined([whole[:at], whole[at:]])
    assert np.array_equal(again.samples, whole.samples)
    assert np.array_equal(again.t_ns, whole.t_ns)
    assert np.array_equal(again.believed.position, whole.believed.position)


def test_frames_of_one_or_several_sensors_are_taken_alike() -> None:
    one = frames()
    assert len(sensors_of(one)) == 1
    assert len(sensors_of({"a": one, "b": one})) == 2
    with pytest.raises(ul.InputError, match="no frames"):
        sensors_of([])


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"t_ns": [0, 0, 1]}, "does not rise after sample 0"),
        ({"position": [[0, 0, 0], [0, np.nan, 0], [0, 0, 0]]}, "not finite in row 1"),
        ({"quat_xyzw": [[0, 0, 0, 2]] * 3}, "not of unit length"),
        ({"position": np.zeros((2, 3))}, r"shape \(2, 3\)"),
    ],
)
def test_a_bad_trajectory_is_refused(change: dict, words: str) -> None:
    good = {"t_ns": [0, 1, 2], "position": np.zeros((3, 3)), "quat_xyzw": [[0, 0, 0, 1.0]] * 3}
    with pytest.raises(ul.InputError, match=words):
        ul.Trajectory(**(good | change))


def test_times_outside_a_trajectory_are_refused() -> None:
    with pytest.raises(ul.InputError, match="outside the trajectory"):
        circle().at(-1)


@pytest.mark.parametrize("rate", [0.0, -5.0, float("nan"), float("inf")])
def test_a_rate_must_be_positive(rate: float) -> None:
    with pytest.raises(ul.InputError, match="rate_hz"):
        ul.Trajectory.line((0, 0, 0), (1, 0, 0), 0.5, rate)


def test_frames_with_poses_at_other_times_are_refused() -> None:
    good = frames()
    with pytest.raises(ul.InputError, match="not at the frames' times"):
        ul.Frames(good.samples, good.range_m, good.t_ns, good.spec, good.poses[:5])


def wall(n: int = 80, *, noise: float = 0.01) -> dict[str, np.ndarray]:
    """Amplitudes of a radar that looks left while it passes a wall at 3 m."""
    profiles = noise * np.abs(np.random.default_rng(0).standard_normal((n, 120)))
    profiles[:, 60] += 1
    places = np.c_[np.linspace(-2, 2, n), np.zeros((n, 2))]
    return {
        "samples": profiles,
        "range_m": 0.05 * np.arange(120),
        "times_s": 0.05 * np.arange(n),
        "positions_m": places,
    }


LEFT = (0, 0, np.sqrt(0.5), np.sqrt(0.5))
AROUND = ul.Grid.covering([[-3, -2, -1], [3, 4, 1]], 0.1)


def test_frames_from_arrays_have_the_axis_and_the_rate_of_the_arrays() -> None:
    one = wall()
    for turns in (LEFT, np.tile(LEFT, (80, 1))):
        got = ul.Frames.from_arrays(**one, quaternions_xyzw=turns)
        np.testing.assert_allclose(got.spec.range_m, one["range_m"], atol=1e-9)
        assert got.spec.fps == pytest.approx(20)
        assert got.poses is not None
        np.testing.assert_allclose(got.poses.position, one["positions_m"])
        np.testing.assert_allclose(got.poses.quat_xyzw[7], LEFT)
    assert ul.Frames.from_arrays(one["samples"], one["range_m"], one["times_s"]).poses is None


def test_stamps_in_nanoseconds_are_recognised_in_arrays() -> None:
    one = wall()
    one["times_s"] = np.rint(np.asarray(one["times_s"]) * 1e9)
    with pytest.warns(ul.UllageWarning, match="times_s: times are taken as nanoseconds"):
        got = ul.Frames.from_arrays(**one)
    np.testing.assert_array_equal(got.t_ns, ul.Frames.from_arrays(**wall()).t_ns)


@pytest.mark.parametrize("step_m", [0.002, 0.05, 0.5])
def test_any_range_axis_makes_frames_without_a_preset(step_m: float) -> None:
    axis, noise = 0.3 + step_m * np.arange(64), np.random.default_rng(0).standard_normal((2, 9, 64))
    for samples, output in ((noise[0] + 1j * noise[1], "baseband"), (noise[0], "rf"), (abs(noise[0]), "baseband")):
        got = ul.Frames.from_arrays(samples, axis, np.arange(9) / 5, center_hz=6.5e9)
        assert (got.spec.output, got.spec.center_hz) == (output, 6.5e9)
        np.testing.assert_allclose(got.spec.range_m, axis, atol=1e-9)


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"times_s": 1e18 + np.arange(80)}, "times_s is not in seconds"),
        ({"range_m": np.zeros(120)}, "range_m .*rising"),
        ({"range_m": np.arange(60.0)}, "range_m has shape"),
        ({"positions_m": np.zeros((3, 3))}, "position"),
        ({"carrier_hz": 6e9}, "carrier_hz"),
    ],
)
def test_arrays_that_do_not_fit_are_refused(change: dict, words: str) -> None:
    with pytest.raises(ul.InputError, match=words):
        ul.Frames.from_arrays(**(wall() | change))


def test_a_wall_of_plain_arrays_is_mapped() -> None:
    omap = ul.map_occupancy(ul.Frames.from_arrays(**wall(), quaternions_xyzw=LEFT), AROUND, method="elfes")
    rows, _ = np.nonzero(omap.occupied)
    assert abs(np.median(AROUND.y_m[rows]) - 3) < 0.1


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"quaternions_xyzw": (0, 0, 0, 1)}, r"stays at 3\.00 m while the radar moves 4\.0 m the way it looks"),
        ({"samples": wall()["samples"] - np.eye(1, 120, 60)}, "no echo stands out of the noise"),
        ({"positions_m": np.zeros((80, 3))}, "no radar moves"),
        ({"grid": ul.Grid.covering([[-3, -1, -1], [3, 1, 1]], 0.1)}, "outside the grid"),
    ],
)
@pytest.mark.filterwarnings("ignore:invalid value")
def test_an_empty_map_says_why(change: dict, words: str) -> None:
    given = wall() | {"quaternions_xyzw": LEFT, "grid": AROUND} | change
    grid = given.pop("grid")
    with pytest.warns(ul.UllageWarning, match=f"no cell of the map is occupied: .*{words}"):
        ul.map_occupancy(ul.Frames.from_arrays(**given), grid, method="likelihood")


def test_frames_without_poses_say_so_when_poses_are_wanted() -> None:
    good = frames()
    bare = ul.Frames(good.samples, good.range_m, good.t_ns, good.spec)
    with pytest.raises(ul.InputError, match="no poses"):
        bare.believed.position.sum()


def test_only_amplitudes_of_the_ray_model_carry_its_settings() -> None:
    waves = frames()
    assert waves.ray_model is None
    assert replace(waves, unit="normalised").ray_model is None
    rays = replace(waves, unit="thesis", spec=waves.spec.but(thesis={"threshold": 0.05}))
    assert rays.ray_model is not None
    assert rays.ray_model.threshold == 0.05


def test_what_flows_is_shown_on_one_short_line() -> None:
    room = ul.scenes.room(size_m=(6, 4, 3))
    path = ul.Trajectory.line((-1, 0, 0), (-0.5, 0, 0), 0.5, 10)
    frames = ul.simulate(room, path, ul.RadarSpec.preset("x4m05"), fidelity="thesis")
    omap = ul.map_occupancy(frames, ul.Grid.covering(room.bounds, 0.5), method="elfes")
    image = ul.focus(frames, ul.Grid.covering(room.bounds, 0.5), method="summation")
    shown = [repr(one) for one in (room, path, frames, ul.detect(frames), omap, image)]
    assert shown[1] == f"Trajectory({len(path)} poses, {path.duration_s:.1f} s, 0.50 m)"
    assert shown[0].startswith("Scene('room', ")
    assert shown[2].startswith(f"Frames('radar', {len(path)} x ")
    assert shown[4].startswith("OccupancyMap(elfes, 12 x 8 cells of 0.5 m: ")
    assert shown[5].startswith("Image(summation, 12 x 8 cells of 0.5 m, peak at (")
    assert all(len(text) < 120 and "\n" not in text for text in shown)


def test_the_scenes_list_scenes_alone() -> None:
    names = dir(ul.scenes)
    assert {"plate", "room", "hold", "cargo_hold", "ntnu_room"} <= set(names)
    assert all(callable(getattr(ul.scenes, name)) and getattr(ul.scenes, name).__doc__ for name in names)
