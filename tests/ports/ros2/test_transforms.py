"""The tree of frames: where something was, interpolated, or why that is not known."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from ullage.geometry import rpy_quat, transform
from ullage.ports.ros2.incoming import Transforms

S = 1_000_000_000


def tree() -> Transforms:
    """map - odom (moves a little) - base_link (moves) - front (fixed)."""
    out = Transforms()
    for k in range(11):
        t_ns = k * S // 10
        out.add("map", "odom", t_ns, np.array([0.01 * k, 0, 0]), rpy_quat(0, 0, 0))
        out.add("odom", "base_link", t_ns, np.array([k * 0.1, 0, 1]), rpy_quat(0, 0, 0.1 * k))
    out.add("base_link", "front", 0, np.array([0.1, 0, 0]), rpy_quat(0, 0.2, 0), fixed=True)
    return out


@pytest.mark.parametrize("t_s", [0.0, 0.05, 0.1, 0.333, 1.0])
def test_a_chain_is_the_product_of_its_links_at_that_time(t_s: float) -> None:
    answer = tree().at("map", "front", round(t_s * S))
    odom, body, front = (
        transform((0.1 * t_s, 0, 0)),
        transform((t_s, 0, 1), (0, 0, t_s)),
        transform((0.1, 0, 0), (0, 0.2, 0)),
    )
    assert answer.status == "known"
    np.testing.assert_allclose(answer.pose, odom @ body @ front, atol=1e-9)


def test_attitude_goes_along_the_great_arc() -> None:
    out = Transforms()
    a, b = Rotation.from_euler("xyz", [0.3, -0.2, 0.1]), Rotation.from_euler("xyz", [1.5, 0.4, -2.0])
    out.add("map", "b", 0, np.zeros(3), a.as_quat())
    out.add("map", "b", S, np.zeros(3), -b.as_quat())  # the same attitude with the other sign
    turn = Rotation.from_matrix(out.at("map", "b", S // 4).pose[:3, :3])
    assert (a.inv() * turn).magnitude() == pytest.approx(0.25 * (a.inv() * b).magnitude())


def test_what_is_not_known_says_why() -> None:
    known = tree()
    assert known.at("map", "front", 2 * S).status == "wait"
    assert known.at("odom", "front", 2 * S).missing == "odom to base_link"
    assert known.at("map", "front", -1).status == "never"
    assert known.at("map", "left", 0).status == "wait"
    assert known.at("earth", "front", 0).missing == "map is not joined to earth"
    known.add("odom", "base_link", 5 * S, np.zeros(3), rpy_quat(0, 0, 0))
    assert known.at("odom", "base_link", 3 * S).status == "never"  # nothing is guessed across a gap of 4 s


def test_a_late_transform_slips_into_its_place_and_a_jump_back_forgets() -> None:
    out = Transforms()
    for t_ns in (0, 4, 2, 2):
        assert not out.add("map", "b", t_ns * S // 10, np.array([t_ns**2, 0, 0]), rpy_quat(0, 0, 0))
    assert out.at("map", "b", S // 10).pose[0, 3] == pytest.approx(2.0)  # between 0 and 4, not 0 and 16
    out.add("map", "b", 100 * S, np.zeros(3), rpy_quat(0, 0, 0))
    assert out.add("map", "b", 5 * S, np.ones(3), rpy_quat(0, 0, 0))
    assert out.at("map", "b", 5 * S).pose[0, 3] == 1
    assert out.at("map", "b", 100 * S).status == "wait"


def test_old_poses_are_let_go() -> None:
    out = Transforms()
    for k in range(100):
        out.add("map", "b", k * S, np.zeros(3), rpy_quat(0, 0, 0))
    assert out.at("map", "b", 68 * S).status == "never"
    assert out.at("map", "b", 70 * S).status == "known"
