"""What the public functions refuse, in one line each: values of the wrong type, shape or size."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

import ullage as ul

LEVEL = np.array([[0.0, 0.0, 0.0, 1.0]] * 2)
STILL = np.zeros((2, 3))
SPEC = ul.RadarSpec.preset("x4m05")
BOX = ((-1.0, -1.0, -1.0), (1.0, 1.0, 1.0))
PLANE = ul.Grid.covering(BOX, 0.5)


@pytest.fixture(scope="module")
def frames() -> ul.Frames:
    noise = np.random.default_rng(3).normal(size=(4, SPEC.bins))
    path = ul.Trajectory.line((0, 0, 0), (0.3, 0, 0), speed_m_s=1.0, rate_hz=10)
    return ul.Frames(noise + 0j, SPEC.range_m, path.t_ns, SPEC, poses=path, unit="normalised")


def refused(words: str, make: Callable[[], Any]) -> None:
    with pytest.raises(ul.InputError, match=words) as caught:
        make()
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(
    ("words", "times", "position"),
    [
        ("t_ns has a time that is not finite", [0, np.nan], STILL),
        ("t_ns has a time that is not finite", [0, 1e30], STILL),
        ("t_ns is", ["noon", "one"], STILL),
        ("position is", [0, 5], [[0, 0, 0], [1, 0]]),
        ("position is", [0, 5], [["a"] * 3] * 2),
        ("position is complex", [0, 5], STILL + 1j),
        ("position has masked values", [0, 5], np.ma.masked_array(STILL, mask=True)),
    ],
)
def test_a_trajectory_refuses_what_is_no_number(words: str, times: Any, position: Any) -> None:
    refused(words, lambda: ul.Trajectory(times, position, LEVEL))


@pytest.mark.parametrize("unit", ["s", "ms", "us", "ns"])
def test_dates_of_any_unit_become_nanoseconds(unit: str) -> None:
    dates = np.array(["2026-11-24T00:00:00", "2026-11-24T00:00:02"], f"datetime64[{unit}]")
    assert ul.Trajectory(dates, STILL, LEVEL).duration_s == 2.0


def test_seconds_times_a_billion_are_rounded() -> None:
    path = ul.Trajectory(np.array([0.0, 299_999_999.9999999]), STILL, LEVEL)
    assert path.t_ns[1] == 300_000_000


@pytest.mark.parametrize(
    ("words", "make"),
    [
        ("position_m is 'abc'", lambda: ul.Trajectory.stationary(position_m="abc")),
        ("yaw_deg is '90'", lambda: ul.Trajectory.stationary(yaw_deg="90")),
        ("n is 2.5", lambda: ul.Trajectory.stationary(n=2.5)),
        ("end_m has shape", lambda: ul.Trajectory.line((0, 0, 0), (1, 0))),
        ("end_m is not finite", lambda: ul.Trajectory.line((0, 0, 0), (np.nan, 0, 0))),
        ("1e\\+10 samples", lambda: ul.Trajectory.stationary(n=10**10)),
        ("1e\\+12 samples", lambda: ul.Trajectory.line((0, 0, 0), (1e6, 0, 0), 1.0, 1e6)),
        ("speed_m_s is inf", lambda: ul.Trajectory.line((0, 0, 0), (1, 0, 0), np.inf)),
    ],
)
def test_paths_refuse_what_is_no_place_or_number(words: str, make: Callable[[], Any]) -> None:
    refused(words, make)


@pytest.mark.parametrize(
    ("words", "pose"),
    [
        ("left-handed", np.diag([1.0, -1.0, 1.0, 1.0])),
        ("not rigid", np.diag([2.0, 2.0, 2.0, 1.0])),
        ("shape", np.eye(3)),
        ("not finite", np.full((4, 4), np.nan)),
    ],
)
def test_a_mount_must_be_rigid_and_right_handed(words: str, pose: Any) -> None:
    refused(words, lambda: ul.Trajectory.stationary().mounted(pose))


def test_a_path_is_asked_for_one_time_or_more(frames: ul.Frames) -> None:
    refused("t_ns has shape", lambda: frames.believed.at([]))
    refused("t_ns has a time", lambda: frames.believed.at(np.nan))


@pytest.mark.parametrize(
    ("words", "changes"),
    [
        ("spec is None", {"spec": None}),
        ("sensor is 3", {"sensor": 3}),
        ("poses is a ndarray", {"poses": np.zeros((4, 3))}),
        ("unit is 'volts'", {"unit": "volts"}),
        ("samples is", {"samples": np.full((4, SPEC.bins), "a")}),
        ("2 bins or more", {"samples": np.zeros((4, 1)), "range_m": [0.0]}),
        ("not evenly spaced", {"range_m": np.geomspace(1, 10, SPEC.bins)}),
    ],
)
def test_frames_refuse_what_no_processor_can_use(words: str, changes: dict[str, Any], frames: ul.Frames) -> None:
    refused(words, lambda: replace(frames, **changes))


@pytest.mark.parametrize("given", [None, "frames", 5, np.zeros((3, 8))])
@pytest.mark.parametrize(
    "use",
    [ul.detect, ul.calibrate, ul.own_echo, lambda f: ul.focus(f, PLANE), lambda f: ul.map_occupancy(f, PLANE)],
    ids=["detect", "calibrate", "own_echo", "focus", "map_occupancy"],
)
def test_only_frames_are_processed(use: Callable[[Any], Any], given: Any) -> None:
    refused("frames", lambda: use(given))


@pytest.mark.parametrize(
    ("words", "options"),
    [
        ("combine is 'coherrent'", {"combine": "coherrent"}),
        ("no window 'box'", {"window": "box"}),
        ("threads is -1", {"threads": -1}),
        ("subaperture_m is 'a'", {"subaperture_m": "a"}),
    ],
)
def test_an_image_refuses_unknown_options(words: str, options: dict[str, Any], frames: ul.Frames) -> None:
    refused(words, lambda: ul.focus(frames[:2], PLANE, **options))


@pytest.mark.parametrize(
    ("words", "options"),
    [
        ("threshold is 'a'", {"threshold": "a"}),
        ("min_range_m is nan", {"min_range_m": np.nan}),
        ("max_echoes is 1.5", {"max_echoes": 1.5}),
        ("train is 3.5", {"method": "cfar", "train": 3.5}),
        ("guard is '3'", {"method": "cfar", "guard": "3"}),
        ("correlation", {"method": "cfar", "correlation": [1, np.nan]}),
        ("correlation", {"method": "cfar", "correlation": "a"}),
        ("window_m is nan", {"method": "track", "window_m": np.nan}),
    ],
)
def test_detection_refuses_numbers_out_of_bounds(words: str, options: dict[str, Any], frames: ul.Frames) -> None:
    refused(words, lambda: ul.detect(frames, **options))


@pytest.mark.parametrize(
    ("words", "options"),
    [
        ("floor_z_m is nan", {"floor_z_m": np.nan}),
        ("vehicle_radius_m is 'a'", {"vehicle_radius_m": "a"}),
        ("no option 'treshold' of method 'elfes'.*allowed: threshold", {"method": "elfes", "treshold": 0.1}),
        ("no option 'threshold' of method 'likelihood'", {"threshold": 0.1}),
        ("threshold is -1", {"method": "elfes", "threshold": -1}),
        ("lobe_deg is nan", {"method": "elfes", "lobe_deg": np.nan}),
    ],
)
def test_the_mapper_refuses_numbers_out_of_bounds(words: str, options: dict[str, Any], frames: ul.Frames) -> None:
    refused(words, lambda: ul.map_occupancy(frames, PLANE, **options))


@pytest.mark.parametrize(
    ("words", "make"),
    [
        ("bounds is", lambda: ul.Grid.covering("a", 0.1)),
        ("bounds is", lambda: ul.Grid.covering([[0, 0, 0], [1, 1]], 0.1)),
        ("step_m is 'a'", lambda: ul.Grid.covering(BOX, "a")),
        ("dims is 4", lambda: ul.Grid.covering(BOX, 0.1, dims=4)),
        ("z_m is 'a'", lambda: ul.Grid.covering(BOX, 0.1, z_m="a")),
        ("margin_m is -10", lambda: ul.Grid.covering(BOX, 0.1, margin_m=-10)),
        ("margin_m is nan", lambda: ul.Grid.covering(BOX, 0.1, margin_m=np.nan)),
        ("shape is", lambda: ul.Grid.covering(BOX, 1e-300)),
        ("shape is 3.5", lambda: ul.Grid((0, 0, 0), 0.1, (3.5, 3))),
        ("shape is 3", lambda: ul.Grid((0, 0, 0), 0.1, 3)),
        ("origin_m is", lambda: ul.Grid((0, 0), 0.1, (3, 3))),
    ],
)
def test_a_grid_refuses_what_makes_no_cells(words: str, make: Callable[[], Any]) -> None:
    refused(words, make)


def test_a_grid_of_arrays_is_the_same_as_one_of_numbers() -> None:
    given: Any = np.zeros(3), np.float64(0.1), np.array([3, 4])
    same = ul.Grid((0.0, 0.0, 0.0), 0.1, (3, 4))
    assert ul.Grid(*given) == same
    assert hash(ul.Grid(*given)) == hash(same)


@pytest.mark.parametrize("method", ["elfes", "likelihood"])
def test_maps_larger_than_memory_are_refused(method: str, frames: ul.Frames) -> None:
    grid = ul.Grid.covering(BOX, 2e-6)
    refused("takes .* GB", lambda: ul.map_occupancy(frames, grid, method=method))


@pytest.mark.parametrize("use", [ul.focus, ul.map_occupancy])
def test_cells_are_those_of_a_grid(use: Callable[..., Any], frames: ul.Frames) -> None:
    refused("grid is a list", lambda: use(frames, [1, 2]))


def test_only_a_map_and_a_scene_are_compared(frames: ul.Frames) -> None:
    omap: Any = ul.map_occupancy(frames, PLANE, method="elfes")
    refused("scene is a str", lambda: ul.metrics.map_quality(omap, "room", frames))
    refused("omap is a Image", lambda: ul.metrics.map_quality(ul.focus(frames, PLANE), ul.scenes.room(), frames))


def test_images_larger_than_memory_are_refused(frames: ul.Frames) -> None:
    refused("takes .* GB", lambda: ul.focus(frames, ul.Grid.covering(BOX, 2e-6), method="summation"))


@pytest.mark.parametrize(
    ("words", "make"),
    [
        ("yaw is", lambda: ul.Waypoints([(0, 0, 1), (1, 0, 1)], yaw=["a", "b"])),
        ("wander is 'x'", lambda: ul.Waypoints([(0, 0, 1)], wander="x")),
        ("the mission takes", lambda: ul.fly(ul.Waypoints([(0, 0, 1)], hold_s=1e12))),
        ("the mission takes", lambda: ul.fly(ul.Waypoints([(0, 0, 1), (1, 0, 1)], 1e-9))),
        ("seed is -1", lambda: ul.fly([(0, 0, 1)], seed=-1)),
        ("seed is 1.5", lambda: ul.fly([(0, 0, 1)], seed=1.5)),
        ("scene is a str", lambda: ul.fly([(0, 0, 1)], scene="x")),
        ("wind_m_s is 'a'", lambda: ul.fly([(0, 0, 1)], wind_m_s="a")),
        ("start is", lambda: ul.fly([(0, 0, 1)], start=[1, 2, "x"])),
        ("flown is a list", lambda: ul.navigate([])),
        ("seed is None", lambda: ul.navigate(ul.Trajectory.stationary(), noise_m=1, seed=None)),
        ("noise_m is 'a'", lambda: ul.navigate(ul.Trajectory.stationary(), noise_m="a")),
    ],
)
def test_a_flight_refuses_what_cannot_be_flown(words: str, make: Callable[[], Any]) -> None:
    refused(words, make)


@pytest.mark.parametrize(
    ("words", "make"),
    [
        ("faces is", lambda: ul.Scene.of_mesh(np.eye(3), np.array([[0, 1.5, 2]]), name="a")),
        ("faces have shape", lambda: ul.Scene.of_mesh(np.eye(3), np.array([[0, 1, 2, 0]]), name="a")),
        ("vertices have shape", lambda: ul.Scene.of_mesh(np.zeros((3, 2)), np.array([[0, 1, 2]]), name="a")),
        ("radius_m is 0", lambda: ul.Scene.of_wires(np.zeros(3), np.ones(3), 0.0, name="w")),
        ("start has shape", lambda: ul.Scene.of_wires(np.full(3, np.nan), np.ones(3), 0.1, name="w")),
        ("a part is no scene", lambda: ul.Scene.union([None])),
    ],
)
def test_a_scene_refuses_what_is_no_shape(words: str, make: Callable[[], Any]) -> None:
    refused(words, make)


@pytest.mark.parametrize(
    ("words", "given"),
    [
        ("poses of shapes", ([], np.zeros((0, 3)), np.zeros((0, 4)))),
        ("poses of shapes", ([1, 2], [[0, 0, 0]], LEVEL)),
        ("a pose is not finite", ([1], [0, np.nan, 0], [0, 0, 0, 1])),
        ("quaternion is zero", ([1], [0, 0, 0], [0, 0, 0, 0])),
    ],
)
def test_live_radars_take_in_no_pose_that_is_none(words: str, given: Any) -> None:
    live = ul.LiveRadars(ul.Scene.empty(), SPEC)
    refused(words, lambda: live.advance(*given))
    assert len(live.advance(1, (0, 0, 0), (0, 0, 0, 1))["radar"]) == 1
    live.close()


@pytest.mark.parametrize(
    ("words", "options"),
    [
        ("i is 1.5", {"path": 1.5}),
        ("i is 'a'", {"path": "a"}),
        ("max_bounces is 9", {"max_bounces": 9}),
        ("count is '3'", {"count": "3"}),
        ("scene is a str", {"scene": "room"}),
    ],
)
def test_explain_refuses_what_names_no_frame(words: str, options: dict[str, Any], frames: ul.Frames) -> None:
    refused(words, lambda: ul.explain(frames, **({"scene": ul.Scene.empty()} | options)))


def test_explain_takes_one_radar_of_a_rig() -> None:
    rig: Any = ul.Rig.preset("thesis-4")
    refused("radar is a Rig", lambda: ul.explain(ul.Scene.empty(), ul.Trajectory.stationary(), rig))


def test_one_heading_for_a_whole_flight_stays_one_number() -> None:
    for yaw in (90.0, 90, np.float32(90)):
        assert ul.Waypoints([(0, 0, 1), (1, 0, 1)], yaw=yaw).yaw == 90.0
