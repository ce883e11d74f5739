"""Places on earth and attitudes: against known points, and whatever the reference."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from ullage.geometry import matrix_quat, quat_matrix, quat_rpy, rpy_quat
from ullage.ports.imc.assemble import pose_of
from ullage.ports.imc.frames import state_of
from ullage.ports.imc.table import own
from ullage.ports.ned import Geodetic
from ullage.ports.pose_events import BodyState

ANYWHERE = st.builds(Geodetic, st.floats(-1.55, 1.55), st.floats(-3.1, 3.1), st.floats(-100, 5000))
OFFSETS = st.tuples(*[st.floats(-2000, 2000)] * 3).map(np.array)


def test_known_points_of_the_ellipsoid() -> None:
    assert Geodetic(0, 0).earth_centred == pytest.approx([6_378_137.0, 0, 0])
    assert Geodetic(math.pi / 2, 0).earth_centred == pytest.approx([0, 0, 6_356_752.314245], abs=1e-6)
    # a minute of latitude at 45 degrees, by the meridian's radius of curvature there: 6 367 381.8 m
    north = Geodetic.degrees(45, 10).moved(np.array([6_367_381.8 * math.radians(1 / 60), 0, 0]))
    assert math.degrees(north.lat_rad) == pytest.approx(45 + 1 / 60, abs=1e-6)


@settings(max_examples=60, deadline=None)
@given(ANYWHERE, OFFSETS)
def test_a_point_moved_is_where_it_was_moved_to(place: Geodetic, ned: np.ndarray) -> None:
    there = place.moved(ned)
    back = place.earth_from_ned.T @ (there.earth_centred - place.earth_centred)
    assert np.allclose(back, ned, atol=1e-6)


@settings(max_examples=60, deadline=None)
@given(ANYWHERE, OFFSETS, st.tuples(*[st.floats(-3, 3)] * 3))
def test_the_reference_that_a_vehicle_uses_changes_nothing(origin: Geodetic, ned: np.ndarray, far: tuple) -> None:
    attitude = np.array([0.1, -0.2, 0.3, 0.9]) / math.sqrt(0.95)
    pose = BodyState(5, np.array([10.0, -20.0, 3.0]), attitude, np.array(far), np.array([0.1, 0.2, -0.3]))
    told = state_of(pose, origin)
    other = origin.moved(ned)
    # the same pose, told by a vehicle whose reference lies elsewhere
    turn = other.earth_from_ned.T @ origin.earth_from_ned
    x, y, z = other.earth_from_ned.T @ (
        origin.earth_centred + origin.earth_from_ned @ [told["x"], told["y"], told["z"]] - other.earth_centred
    )
    velocity = turn @ [told["vx"], told["vy"], told["vz"]]
    frd = turn @ quat_matrix(rpy_quat(told["phi"], told["theta"], told["psi"]))
    phi, theta, psi = quat_rpy(matrix_quat(frd))
    place = {"lat": other.lat_rad, "lon": other.lon_rad, "height": other.height_m, "x": x, "y": y, "z": z}
    turned = {"phi": phi, "theta": theta, "psi": psi}
    moving = dict(zip(("vx", "vy", "vz"), velocity, strict=True))
    for state in (told, told | place | turned | moving):
        got = pose_of(state, 5, origin)
        assert np.allclose(got.position, pose.position, atol=1e-5)
        assert abs(got.quat_xyzw @ pose.quat_xyzw) == pytest.approx(1, abs=1e-9)
        assert np.allclose(got.velocity, pose.velocity, atol=1e-9)
        assert np.allclose(got.spin, pose.spin)


def test_north_is_y_east_is_x_and_a_heading_of_east_looks_along_x() -> None:
    names = [field.name for field in own().by_name["EstimatedState"].fields]
    state = dict.fromkeys(names, 0.0)
    got = pose_of(state | {"x": 1.0, "y": 2.0, "z": -3.0, "psi": math.pi / 2, "vx": 4.0, "r": 0.5}, 0, Geodetic(0, 0))
    assert got.position == pytest.approx([2, 1, 3])
    assert got.quat_xyzw == pytest.approx([0, 0, 0, 1])
    assert got.velocity == pytest.approx([0, 4, 0])
    assert got.spin == pytest.approx([0, 0, -0.5])
