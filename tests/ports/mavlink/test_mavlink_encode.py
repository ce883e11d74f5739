"""Obstacle distances as bytes that another decoder reads, field by field, against what autopilots do with them."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

pytest.importorskip("pymavlink")

from pymavlink.dialects.v20 import common as mav

from ullage.geometry import quat_matrix, rpy_quat
from ullage.ports.mavlink.sink import CUSTOM, distance_sensors, obstacle_distance, orientation_of, sector_distances
from ullage.processing.bearings import CELLS
from ullage.processing.obstacles import ObstacleSectors, ObstacleTracks

UNKNOWN = 65535


def sectors(
    yaw_deg: Any, distance_m: Any, *, pitch_deg: Any = 0.0, width_deg: float = 65.0, sigma_m: Any = 0.02,
    snr_db: Any = 20.0, reach_m: Any = 9.0, t_ns: int = 0, broken: tuple[int, ...] = (),
) -> ObstacleSectors:  # fmt: skip
    """What radars of these boresights (counter-clockwise from forward; up above zero) detect."""
    distance = np.atleast_1d(np.asarray(distance_m, float))
    k = len(distance)
    yaw, pitch, sigma, snr, reach = (
        np.broadcast_to(np.asarray(value, float), k) for value in (yaw_deg, pitch_deg, sigma_m, snr_db, reach_m)
    )
    bore = quat_matrix(rpy_quat(np.zeros(k), -np.radians(pitch), np.radians(yaw)))[:, :, 0]
    valid = np.array([n not in broken for n in range(k)])
    seen = np.isfinite(distance) & valid
    rows, none = np.flatnonzero(seen), np.full(k, np.nan)
    tracks = ObstacleTracks(
        rows, np.arange(len(rows)), distance[rows], sigma[rows], none[rows], none[rows], snr[rows],
        np.zeros(len(rows), bool),
    )  # fmt: skip
    return ObstacleSectors(
        t_ns, tuple(f"radar{n}" for n in range(k)), bore, np.radians(yaw), np.full(k, math.radians(width_deg)),
        np.full(k, 0.2), reach.copy(), np.where(valid, distance, np.nan), np.where(seen, sigma, np.nan), none, none,
        valid, ~valid, tuple("" if ok else "no new frame" for ok in valid), tracks,
    )  # fmt: skip


def decoded(message: Any) -> Any:
    """The message as another decoder reads its bytes, which must be MAVLink 2."""
    data = message.pack(mav.MAVLink(None, srcSystem=1, srcComponent=196))
    assert data[0] == 0xFD
    (out,) = mav.MAVLink(None).parse_buffer(data)
    return out


def test_an_obstacle_fills_every_element_that_its_lobe_touches_and_no_other() -> None:
    found = decoded(obstacle_distance(sectors([0.0], [2.0], width_deg=40), 123_456_789))
    assert (found.time_usec, found.sensor_type, found.frame) == (123_456_789, mav.MAV_DISTANCE_SENSOR_RADAR, 12)
    assert (found.increment, found.increment_f, found.angle_offset) == (5, 5.0, 0.0)
    assert (found.min_distance, found.max_distance) == (20, 900)
    # the lobe ends at 20 degrees; element j holds 5 j - 2.5 to 5 j + 5 degrees, clockwise
    inside = {j % 72 for j in range(-5, 5)}
    assert [d for j, d in enumerate(found.distances) if j in inside] == [200] * len(inside)
    assert {d for j, d in enumerate(found.distances) if j not in inside} == {UNKNOWN}


def test_elements_go_clockwise_as_forward_right_down_asks() -> None:
    left = decoded(obstacle_distance(sectors([90.0], [1.0], width_deg=20), 0)).distances
    right = decoded(obstacle_distance(sectors([-90.0], [1.0], width_deg=20), 0)).distances
    assert left[54] == 100
    assert left[18] == UNKNOWN
    assert right[18] == 100
    assert right[54] == UNKNOWN


def test_free_is_one_more_than_the_greatest_distance_and_only_where_a_lobe_covers_all_of_an_element() -> None:
    found = decoded(obstacle_distance(sectors([0.0], [np.inf], width_deg=40), 0))
    free = {j for j, d in enumerate(found.distances) if d == found.max_distance + 1}
    assert free == {j % 72 for j in range(-3, 4)}  # 5 j + 5 <= 20 and 5 j - 2.5 >= -20
    assert {d for j, d in enumerate(found.distances) if j not in free} == {UNKNOWN}


def test_a_broken_radar_leaves_its_elements_unknown_also_where_a_neighbour_is_free() -> None:
    both = sector_distances(sectors([0.0, 30.0], [np.inf, np.inf], width_deg=60, broken=(1,)))
    assert np.isnan(both[-6 % 72])
    assert np.isnan(both[-2 % 72])  # the neighbour covers it, and is free
    assert both[4] == np.inf
    seen = sector_distances(sectors([0.0, 30.0], [1.5, np.inf], width_deg=60, broken=(1,)))
    assert seen[-2 % 72] == 1.5  # what the neighbour detects counts


def test_the_nearest_of_two_lobes_counts() -> None:
    both = sector_distances(sectors([0.0, 20.0], [3.0, 2.0], width_deg=60))
    assert both[0] == 2.0
    assert both[5] == 3.0


@pytest.mark.parametrize(("distance_m", "cm"), [(0.01, 21), (0.2, 21), (1.999, 199), (9.0, 900), (9.02, 901)])
def test_distances_are_never_below_the_least_which_autopilots_ignore_and_never_rounded_up(
    distance_m: float, cm: int
) -> None:
    found = decoded(obstacle_distance(sectors([0.0], [distance_m]), 0))
    assert found.distances[0] == cm
    assert found.distances[0] > found.min_distance


def test_all_messages_name_the_limits_within_which_every_radar_sees() -> None:
    view = sectors([0.0, 90.0], [np.inf, np.inf], reach_m=[9.0, 4.0])
    assert decoded(obstacle_distance(view, 0)).max_distance == 400
    assert {decoded(one).max_distance for one in distance_sensors(view, 0)} == {400}


def test_a_track_fills_the_elements_that_its_directions_touch_and_leaves_the_rest_of_the_lobe_free() -> None:
    view = sectors([0.0], [2.0], width_deg=60)
    cells = np.degrees(np.arccos(CELLS @ [math.cos(math.radians(20)), math.sin(math.radians(20)), 0.0])) < 1
    view = replace(view, tracks=replace(view.tracks, cells=cells[None]))
    found = sector_distances(view)
    # the cell holds 17.5 to 22.5 degrees to the left: element -4 from there, and -5, which PX4 ends at 20 degrees
    assert set(np.flatnonzero(found == 2.0)) == {72 - 4, 72 - 5}
    assert set(np.flatnonzero(np.isinf(found))) == {j % 72 for j in range(-5, 6)} - {72 - 4, 72 - 5}


def test_a_radar_that_points_down_fills_no_level_element() -> None:
    found = decoded(obstacle_distance(sectors([0.0], [1.0], pitch_deg=-90.0), 0))
    assert set(found.distances) == {UNKNOWN}


@pytest.mark.parametrize(
    ("yaw_deg", "pitch_deg", "name"),
    [
        (0, 0, "NONE"),
        (45, 0, "YAW_315"),
        (90, 0, "YAW_270"),
        (180, 0, "YAW_180"),
        (-90, 0, "YAW_90"),
        (0, 90, "PITCH_90"),
        (0, -90, "PITCH_270"),
    ],
)
def test_each_radar_says_how_it_is_mounted(yaw_deg: float, pitch_deg: float, name: str) -> None:
    (found,) = (decoded(one) for one in distance_sensors(sectors([yaw_deg], [2.5], pitch_deg=pitch_deg), 1234))
    assert mav.enums["MAV_SENSOR_ORIENTATION"][found.orientation].name == f"MAV_SENSOR_ROTATION_{name}"
    assert (found.time_boot_ms, found.current_distance, found.type, found.id) == (1234, 250, 3, 0)
    assert (found.min_distance, found.max_distance) == (20, 900)
    assert found.covariance == 4  # (2 cm)^2
    assert found.horizontal_fov == found.vertical_fov == pytest.approx(math.radians(65))
    assert found.signal_quality == 90  # 20 dB: a tenth of the amplitude is noise
    assert not any(found.quaternion)


def test_a_mount_that_has_no_name_has_a_quaternion_in_forward_right_down() -> None:
    (found,) = (decoded(one) for one in distance_sensors(sectors([20.0], [2.5], pitch_deg=-10.0), 0))
    assert found.orientation == CUSTOM == mav.MAV_SENSOR_ROTATION_CUSTOM
    w, x, y, z = found.quaternion
    forward = quat_matrix([x, y, z, w])[:, 0]
    yaw, dip = math.radians(20), math.radians(10)
    wanted = [math.cos(dip) * math.cos(yaw), -math.cos(dip) * math.sin(yaw), math.sin(dip)]
    np.testing.assert_allclose(forward, wanted, atol=1e-6)


def test_unknown_covariance_and_quality_are_said_so() -> None:
    (free,) = (decoded(one) for one in distance_sensors(sectors([0.0], [np.inf]), 0))
    assert (free.current_distance, free.covariance, free.signal_quality) == (901, 255, 0)
    (vague,) = (decoded(one) for one in distance_sensors(sectors([0.0], [2.0], sigma_m=0.3), 0))
    assert vague.covariance == 255


def test_a_broken_radar_sends_nothing_so_that_the_autopilot_forgets_it() -> None:
    found = [decoded(one) for one in distance_sensors(sectors([0.0, 90.0], [1.0, 2.0], broken=(0,)), 0)]
    assert [(one.id, one.current_distance) for one in found] == [(1, 200)]


def test_every_named_rotation_is_found_by_its_boresight() -> None:
    for yaw in range(0, 360, 45):
        turn = math.radians(yaw)
        assert orientation_of(np.array([math.cos(turn), math.sin(turn), 0.0])) == yaw // 45
