"""A mission is flown: where it goes, how smooth, how repeatable."""

from __future__ import annotations

import numpy as np
import pytest

import ullage as ul


def test_a_flight_ends_at_its_last_waypoint_at_rest():
    flown = ul.fly(ul.Waypoints([(0, 0, 1), (3, 0, 1), (3, 2, 1.5)]))
    np.testing.assert_allclose(flown.position[0], (0, 0, 1), atol=1e-6)
    np.testing.assert_allclose(flown.position[-1], (3, 2, 1.5), atol=0.02)
    assert np.linalg.norm(flown.rates[0][-1]) < 0.05


def test_the_same_seed_gives_the_same_bits_and_another_does_not():
    way = ul.Waypoints([(0, 0, 1), (1, 0, 1)])
    one, two, three = (ul.fly(way, gust_m_s=0.5, seed=s) for s in (4, 4, 5))
    assert np.array_equal(one.position, two.position)
    assert np.array_equal(one.quat_xyzw, two.quat_xyzw)
    assert not np.array_equal(one.position, three.position)


def test_progress_rises_from_zero_to_one():
    seen = []
    ul.fly(ul.Waypoints([(0, 0, 1), (2, 0, 1)]), progress=seen.append)
    assert seen[0] == 0
    assert seen[-1] == 1
    assert seen == sorted(seen)
    assert len(seen) > 4


def test_an_interrupted_flight_leaves_at_once_and_the_next_is_untouched():
    way = ul.Waypoints([(0, 0, 1), (2, 0, 1)])
    whole = ul.fly(way)

    def stop(done):
        if done > 0.3:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        ul.fly(way, progress=stop)
    assert np.array_equal(ul.fly(way).position, whole.position)
