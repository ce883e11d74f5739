"""Poses from an autopilot's messages: frames of reference, times, and what cannot be used."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest

pytest.importorskip("pymavlink")

from pymavlink.dialects.v20 import common as mav

import ullage as ul
from ullage.geometry import quat_matrix, quat_rpy, rpy_quat
from ullage.ports.intake import Counters
from ullage.ports.mavlink.source import PoseBuilder, origin_of


def builder(wanted: Any = "auto", origin: str = "", counters: Counters | None = None) -> PoseBuilder:
    return PoseBuilder(counters or Counters(), wanted, origin_of(origin))


def attitude(ms: int, yaw_deg: float, pitch_deg: float = 0.0) -> Any:
    return mav.MAVLink_attitude_message(ms, 0.0, math.radians(pitch_deg), math.radians(yaw_deg), 0, 0, 0)


def position(ms: int, north: float, east: float, down: float) -> Any:
    return mav.MAVLink_local_position_ned_message(ms, north, east, down, 0, 0, 0)


def odometry(us: int, ned: tuple[float, float, float], q: list[float], *, frame: int = 1, resets: int = 0) -> Any:
    return mav.MAVLink_odometry_message(
        us, frame, 12, *ned, q, 0, 0, 0, 0, 0, 0, [0.0] * 21, [0.0] * 21, resets, 0, 100
    )


def test_north_east_down_becomes_east_north_up() -> None:
    build = builder()
    build.take(attitude(1000, 0.0))  # nose to the north
    (found,) = build.take(position(1000, 3.0, 2.0, -1.5))
    assert found.t_ns == 1_000_000_000
    np.testing.assert_allclose(found.position, (2.0, 3.0, 1.5), atol=1e-6)
    forward = quat_matrix(found.quat_xyzw)[:, 0]
    np.testing.assert_allclose(forward, (0, 1, 0), atol=1e-7)


def test_nose_up_stays_nose_up_and_right_becomes_clockwise() -> None:
    build = builder()
    build.take(attitude(0, 90.0, pitch_deg=10.0))  # nose to the east, and up
    (found,) = build.take(position(0, 0, 0, 0))
    forward = quat_matrix(found.quat_xyzw)[:, 0]
    np.testing.assert_allclose(forward, (math.cos(math.radians(10)), 0, math.sin(math.radians(10))), atol=1e-7)


def test_attitude_lies_between_those_before_and_after_a_position() -> None:
    build = builder()
    build.take(attitude(1000, 10.0))
    assert not build.take(position(1015, 0, 0, 0))  # waits
    (found,) = build.take(attitude(1020, 30.0))
    yaw = math.degrees(quat_rpy(found.quat_xyzw)[2])
    assert 90 - yaw == pytest.approx(25.0, abs=1e-5)


def test_attitudes_far_apart_are_not_interpolated() -> None:
    counters = Counters()
    build = builder(counters=counters)
    build.take(attitude(1000, 10.0))
    build.take(position(1500, 0, 0, 0))
    assert not build.take(attitude(2000, 30.0))
    assert counters.dropped("no pose") == 1


def test_quaternions_are_preferred_to_angles() -> None:
    build = builder()
    build.take(mav.MAVLink_attitude_quaternion_message(1000, 1, 0, 0, 0, 0, 0, 0))
    build.take(attitude(1000, 77.0))
    (found,) = build.take(position(1000, 0, 0, 0))
    np.testing.assert_allclose(quat_matrix(found.quat_xyzw)[:, 0], (0, 1, 0), atol=1e-9)


def test_odometry_is_a_pose_by_itself_and_preferred() -> None:
    build = builder()
    half = math.radians(45)
    (found,) = build.take(odometry(7_000_000, (1.0, 2.0, -3.0), [math.cos(half), 0, 0, math.sin(half)]))
    assert found.t_ns == 7_000_000_000
    np.testing.assert_allclose(found.position, (2.0, 1.0, 3.0))
    np.testing.assert_allclose(quat_matrix(found.quat_xyzw)[:, 0], (1, 0, 0), atol=1e-7)
    build.take(attitude(7000, 0.0))
    assert not build.take(position(7000, 9, 9, 9))
    assert builder("local").take(odometry(1, (0, 0, 0), [1, 0, 0, 0])) == []


def test_odometry_agrees_with_position_and_attitude() -> None:
    angles = np.radians([10.0, -20.0, 30.0])
    x, y, z, w = rpy_quat(*angles).tolist()
    one, other = builder(), builder()
    (direct,) = one.take(odometry(0, (1, 2, 3), [w, x, y, z]))
    other.take(mav.MAVLink_attitude_message(0, *angles.tolist(), 0, 0, 0))
    (joined,) = other.take(position(0, 1, 2, 3))
    np.testing.assert_allclose(direct.position, joined.position)
    np.testing.assert_allclose(quat_matrix(direct.quat_xyzw), quat_matrix(joined.quat_xyzw), atol=1e-9)


def test_the_local_origin_is_placed_in_the_world() -> None:
    build = builder(origin="10,20,1,90")
    build.take(attitude(0, 0.0))
    (found,) = build.take(position(0, 2.0, 0.0, -0.5))
    np.testing.assert_allclose(found.position, (8.0, 20.0, 1.5), atol=1e-9)  # north of it is west in the world
    np.testing.assert_allclose(quat_matrix(found.quat_xyzw)[:, 0], (-1, 0, 0), atol=1e-7)


@pytest.mark.parametrize(
    ("message", "cause"),
    [
        (odometry(1, (0, 0, 0), [1, 0, 0, 0], frame=0), "frame 0 is not MAV_FRAME_LOCAL_NED"),
        (odometry(1, (math.nan, 0, 0), [1, 0, 0, 0]), "position is not finite"),
        (odometry(1, (0, 0, 0), [0, 0, 0, 0]), "not of unit length"),
        (mav.MAVLink_attitude_message(1, math.nan, 0, 0, 0, 0, 0), "quaternion is not finite"),
        (mav.MAVLink_attitude_quaternion_message(1, 2, 0, 0, 0, 0, 0, 0), "not of unit length"),
        (position(1, math.inf, 0, 0), "position is not finite"),
    ],
)
def test_what_is_no_pose_is_counted(message: Any, cause: str) -> None:
    counters = Counters()
    build = builder(counters=counters)
    assert not build.take(message)
    assert counters.dropped("bad") == 1
    assert cause in counters.lines()[0]


def test_a_reset_of_the_estimator_is_noticed() -> None:
    build = builder()
    build.take(odometry(1, (0, 0, 0), [1, 0, 0, 0], resets=3))
    assert not build.reset
    build.take(odometry(2, (5, 0, 0), [1, 0, 0, 0], resets=4))
    assert build.reset


@pytest.mark.parametrize("text", ["1,2", "a,b,c", "1,2,3,4,5", "1,2,nan"])
def test_an_origin_that_is_none_is_refused(text: str) -> None:
    with pytest.raises(ul.InputError, match=r"origin is .*X,Y,Z or X,Y,Z,YAW"):
        origin_of(text)
