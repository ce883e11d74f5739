"""Walls and edges told apart by how their ranges go on over a metre."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest

from ullage.processing.mapper_runs import EchoRuns, fit_edges, fit_walls

TRACK_M = np.linspace(-0.5, 0.5, 41)


def passing(ranges: np.ndarray, heading: float = 0.0) -> tuple[np.ndarray, np.ndarray]:
    """A straight metre flown, with the ranges measured on it."""
    rows = np.stack([TRACK_M * np.cos(heading), TRACK_M * np.sin(heading), ranges], axis=-1)
    return rows[None], np.ones((1, len(TRACK_M)))


def to_edge(place: np.ndarray, heading: float = 0.0) -> np.ndarray:
    way = np.array([np.cos(heading), np.sin(heading)])
    return np.linalg.norm(place - TRACK_M[:, None] * way, axis=1)


def to_wall(angle: float, offset: float) -> np.ndarray:
    return offset - np.cos(angle) * TRACK_M


def unit(angle: float) -> np.ndarray:
    return np.array([np.cos(angle), np.sin(angle)])


@pytest.mark.parametrize("bearing_deg", [70.0, 90.0, 115.0])
@pytest.mark.parametrize("reach", [2.0, 4.0, 6.5])
def test_an_edge_is_found_where_it_is_though_first_taken_four_degrees_off(bearing_deg: float, reach: float) -> None:
    rng = np.random.default_rng(1)
    true = np.deg2rad(bearing_deg)
    ranges = to_edge(reach * unit(true)) + rng.normal(0, 0.002, len(TRACK_M))
    ranges[::9] += 0.15  # echoes of something else
    at, use = passing(ranges)
    way, sigma, edge = fit_edges(at, use, np.array([reach]), unit(true + np.deg2rad(4))[None])
    off = np.arccos(np.clip(way[0] @ unit(true), -1, 1))
    assert off < np.deg2rad(0.6)
    assert off < 4 * sigma[0]
    wall = fit_walls(at, use, np.array([reach]), unit(true + np.deg2rad(4))[None])
    assert edge[0] < wall[0]


@pytest.mark.parametrize(("angle_deg", "offset"), [(90.0, 2.0), (75.0, 4.0), (100.0, 6.0)])
def test_a_wall_is_told_from_an_edge(angle_deg: float, offset: float) -> None:
    angle = np.deg2rad(angle_deg)
    at, use = passing(to_wall(angle, offset))
    start = unit(angle + 0.05)[None]
    wall = fit_walls(at, use, np.array([offset]), start)
    _, _, edge = fit_edges(at, use, np.array([offset]), start)
    assert wall[0] < 1e-4
    assert edge[0] > 10 * wall[0]


def test_turning_everything_turns_the_answer() -> None:
    place = 5.0 * unit(1.4)
    at, use = passing(to_edge(place))
    way, sigma, scatter = fit_edges(at, use, np.array([5.0]), unit(1.45)[None])
    c, s = np.cos(0.7), np.sin(0.7)
    turn = np.array([[c, -s], [s, c]])
    at, use = passing(to_edge(turn @ place, 0.7), 0.7)
    turned, sigma_, scatter_ = fit_edges(at, use, np.array([5.0]), (turn @ unit(1.45))[None])
    np.testing.assert_allclose(turned[0], turn @ way[0], atol=1e-6)
    assert sigma_[0] == pytest.approx(sigma[0], rel=1e-4)
    assert scatter_[0] == pytest.approx(scatter[0], abs=1e-6)


def look_at(k: int, ranges: list[float]) -> SimpleNamespace:
    heard = SimpleNamespace(position=np.array([0.05 * k, 0.0, 1.0]), t_ns=k * 100_000_000, axes=np.eye(3))
    echoes = np.zeros((len(ranges), 6))
    echoes[:, 0], echoes[:, 5] = ranges, 1.0
    return SimpleNamespace(heard=heard, track=np.array([1.0, 0.0, 0.0]), echoes=echoes)


def test_runs_keep_to_their_reflector_where_ranges_cross() -> None:
    """Two edges, ahead and astern, are at the same range half way, where only one is heard, and a little off."""
    places, runs = np.array([[2.0, 2.0], [0.0, 2.0]]), EchoRuns()
    owners = []
    for k in range(41):
        here = np.array([0.05 * k, 0.0])
        away = np.linalg.norm(places - here, axis=1)
        order = np.argsort(away) if k % 2 else np.argsort(-away)
        cosine = (places[order, 0] - here[0]) / away[order]
        if k == 20:
            [alone] = runs.follow(
                "front", look_at(k, [away[1] + 0.015]), cosine[order == 1], np.full(1, 0.05), np.full(1, 0.9)
            )
            assert alone is owners[-1][1]
            continue
        look = look_at(k, list(away[order]))
        out = runs.follow("front", look, cosine, np.full(2, 0.05), np.full(2, 0.9))
        owners.append([out[list(order).index(n)] for n in (0, 1)])
    first, second = owners[0]
    assert first is not second
    assert all(pair[0] is first and pair[1] is second for pair in owners)
    np.testing.assert_allclose(
        [row[2] for row in first.rows], [np.hypot(2 - 0.05 * k, 2) for k in range(41) if k != 20]
    )


def test_a_run_ends_when_its_echo_is_gone_for_a_second() -> None:
    runs, one = EchoRuns(), np.ones(1)
    [early] = runs.follow("front", look_at(0, [3.0]), 0 * one, 0.05 * one, 0.9 * one)
    [soon] = runs.follow("front", look_at(1, [3.0]), 0 * one, 0.05 * one, 0.9 * one)
    [late] = runs.follow("front", look_at(20, [3.0]), 0 * one, 0.05 * one, 0.9 * one)
    assert soon is early
    assert late is not early
