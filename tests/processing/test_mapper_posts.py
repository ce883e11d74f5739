"""Pillars, poles and edges are told by ranges alone, once legs on several sides have heard them."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest

from ullage.kernels.rolls import AHEAD, COLUMNS, COSINE, LEG, NORMAL, PLACE, RANGE, TRACK, WIDE
from ullage.processing.mapper_echoes import Echo, SpecularPoint
from ullage.processing.mapper_legs import Legs
from ullage.processing.mapper_posts import along_post, post_of

PLACES = np.array([0.3, -0.2])
LEAST = 0.64


def legs_about(*corners, step_m: float = 0.6):
    """Middle, way and number of stretches of legs from corner to corner (n, 2), which climb a little."""
    for leg, (start, end) in enumerate(pairwise(corners)):
        a, b = np.array([*start, -0.3 + 0.2 * leg]), np.array([*end, -0.1 + 0.2 * leg])
        way = (b - a) / np.linalg.norm(b - a)
        for s in np.arange(0.3, np.linalg.norm(b - a), step_m):
            yield a + s * way, way, leg


def heard_of(post, radius_m: float, flight, *, walls: tuple[float, ...] = (), scatter_m: float = 0.003) -> np.ndarray:
    """Stretches (m, 22) of four sensors, ahead and abeam, that hear a post and flat walls to the east and north."""
    rng, rows = np.random.default_rng(4), []
    for at, way, leg in flight:
        ahead = way * [1, 1, 0] / np.linalg.norm(way[:2])
        for k in range(4):
            facing = np.array([[1, 0], [0, 1], [-1, 0], [0, -1]])[k] @ np.array([ahead, np.cross([0, 0, 1.0], ahead)])
            told = (
                [(np.linalg.norm(gap := post - at[:2]) - radius_m, gap / np.linalg.norm(gap))]
                if post is not None
                else []
            )
            told += [(far - at[axis], np.eye(2)[axis]) for axis, far in enumerate(walls)]
            for reach, out in told:
                if out @ facing[:2] < LEAST:
                    continue
                row = np.zeros(COLUMNS)
                row[PLACE : PLACE + 3], row[TRACK : TRACK + 3], row[AHEAD : AHEAD + 3] = at, way, facing
                row[RANGE], row[COSINE], row[LEG], row[WIDE] = (
                    reach + rng.normal(0, scatter_m),
                    out @ way[:2],
                    leg,
                    LEAST,
                )
                rows.append(row)
    return np.array(rows)


ROUND = [(-1.8, -1.7), (1.9, -1.6), (1.8, 1.7), (-1.7, 1.8), (-1.8, -1.7)]


@pytest.mark.parametrize("radius_m", [0.0, 0.05, 0.15, 0.3])
def test_a_pillar_flown_about_is_told_with_its_thickness(radius_m):
    rows = heard_of(PLACES, radius_m, legs_about(*ROUND), walls=(3.0, 2.8))
    right = 0
    for me in rows[abs(rows[:, RANGE] - np.linalg.norm(rows[:, PLACE : PLACE + 2] - PLACES, axis=1) + radius_m) < 0.02]:
        found = post_of(me, rows)
        if found is not None:
            post, ways = found
            assert post.centre[:2] == pytest.approx(PLACES, abs=0.02)
            assert -post.radius_m == pytest.approx(radius_m, abs=0.02)
            feet = (rows[:, PLACE : PLACE + 3] + rows[:, [RANGE]] * ways)[ways.any(axis=1)]
            assert np.linalg.norm(feet[:, :2] - PLACES, axis=1) == pytest.approx(radius_m, abs=0.03)
            right += 1
    assert right >= 8


def test_flat_walls_are_no_post():
    rows = heard_of(None, 0.0, legs_about(*ROUND), walls=(3.0, 2.8))
    assert all(post_of(me, rows) is None for me in rows)


def test_one_side_alone_leaves_a_post_open():
    passes = [(-1.8, -1.7), (1.9, -1.7), (-1.8, -1.9), (1.9, -1.8)]
    far = np.array([0.0, 4.0])
    rows = heard_of(far, 0.1, legs_about(*passes))
    assert len(rows) > 8
    assert all(post_of(me, rows) is None for me in rows)


def test_what_is_told_to_be_a_wall_is_no_posts():
    rows = heard_of(PLACES, 0.1, legs_about(*ROUND))
    assert any(post_of(me, rows) is not None for me in rows)
    rows[:, NORMAL : NORMAL + 3] = [1.0, 0.0, 0.0]
    assert all(post_of(me, rows) is None for me in rows)


def test_legs_tell_a_post_once_and_draw_it_upright():
    rng, legs, told = np.random.default_rng(2), Legs(), []
    centre = np.array([0.1, 0.0])
    for a, b in pairwise(ROUND):
        path = np.linspace([*a, 0.1], [*b, 0.3], 70)
        way = (path[-1] - path[0]) / np.linalg.norm(path[-1] - path[0])
        inward = np.array([-way[1], way[0], 0.0]) / np.hypot(*way[:2])
        for k in range(0, 57, 13):
            some = path[k : k + 13]
            gap = centre - some[:, :2]
            if (gap @ inward[:2] < LEAST * np.linalg.norm(gap, axis=1)).any():
                continue
            reach = np.linalg.norm(gap, axis=1) - 0.15 + rng.normal(0, 0.002, 13)
            echoes = [Echo(j, some[j], way, reach[j], 0.0, 1e-3, 0.02, 0.9) for j in range(13)]
            legs.add(echoes, echoes, inward, LEAST, 2.0)
            told += legs.tell(4)
    told += legs.tell_all()
    posts = [(echoes, ways, axis) for echoes, ways, *_, axis in told if axis is not None]
    assert len(posts) >= 6
    assert not list(legs.tell_all()), "once is enough"
    for echoes, ways, axis in posts:
        assert axis == pytest.approx([0, 0, 1])
        feet = np.array([e.position + e.range_m * w for e, w in zip(echoes, ways, strict=True)])
        assert np.linalg.norm(feet[:, :2] - centre, axis=1) == pytest.approx(0.15, abs=0.03)
    foot = SpecularPoint(posts[0][0][0], posts[0][1][0], False, 2.0, np.inf, posts[0][2])
    drawn = along_post(foot, 0.25, 0.1)
    assert drawn[:, 2] - foot.at[2] == pytest.approx([-0.2, -0.1, 0.0, 0.1, 0.2])
    assert along_post(SpecularPoint(foot.echo, foot.way, True), 0.25, 0.1) == pytest.approx(foot.at[None])
