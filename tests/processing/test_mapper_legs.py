"""Rings of different legs meet on the wall that made them, and stay open where geometry leaves them open."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest

from ullage.kernels.rolls import AHEAD, LEG, WIDE
from ullage.processing import mapper_legs
from ullage.processing.mapper_bows import Hollow, bow_of
from ullage.processing.mapper_echoes import Echo
from ullage.processing.mapper_hollows import Hollows, _by_place, _share_heard
from ullage.processing.mapper_legs import Legs, bends_of, bowed_row, stretch_of
from ullage.processing.mapper_rings import weigh

LEAST = float(np.cos(np.radians(50)))
ABEAM = np.array([0.0, 1.0, 0.0])


def leg(start, end) -> np.ndarray:
    start, end = np.asarray(start, float), np.asarray(end, float)
    count = int(np.linalg.norm(end - start) / 0.05)
    return start + np.linspace(0, 1, count)[:, None] * (end - start)


def heard(legs: Legs, path: np.ndarray, distance, rng, *, ahead=ABEAM, told=None) -> list:
    """Fly a leg that hears the surface at `distance` (of places), in stretches of thirteen echoes."""
    reach = distance(path) + rng.normal(0, 0.004, len(path))
    track = np.gradient(path, axis=0)
    track /= np.linalg.norm(track, axis=1)[:, None]
    out = [] if told is None else told
    for k in range(0, len(path) - 12, 13):
        echoes = [Echo(j, path[j], track[j], reach[j], 0.0, 1e-3, 0.02, 0.9) for j in range(k, min(k + 13, len(path)))]
        legs.add(echoes, echoes, ahead, LEAST, 2.0)
        out += legs.tell(2)
    return out


def plane(normal, distance: float):
    return lambda at: distance - at @ np.asarray(normal)


def told_ways(legs: Legs, told: list) -> np.ndarray:
    return np.array([ways.mean(axis=0) for _, ways, *_ in [*told, *legs.tell_all()]]).reshape(-1, 3)


@pytest.mark.parametrize("slope_deg", [-25, 0, 15])
def test_level_legs_at_three_heights_tell_how_a_wall_leans(slope_deg):
    rng, legs, told = np.random.default_rng(1), Legs(), []
    up = np.radians(slope_deg)
    normal = np.array([0.0, np.cos(up), np.sin(up)])
    for k, z in enumerate((-0.8, 0.0, 0.7)):
        heard(legs, leg((-2, 0.2 * k, z), (2, 0.2 * k, z)), plane(normal, 2.5), rng, told=told)
        if k == 0:
            assert not told, "one straight line leaves its ring open"
    ways = told_ways(legs, told)
    assert len(ways) >= 15, "echoes of the first legs are told by the later ones"
    assert (ways @ normal).min() > np.cos(np.radians(6))


def test_legs_in_one_plane_never_choose_between_a_wall_and_its_mirror_image():
    rng, legs, told = np.random.default_rng(2), Legs(), []
    normal = np.array([0.0, np.cos(0.6), np.sin(0.6)])
    for y in (-1.2, -0.6, 0.0, 0.5):
        heard(legs, leg((-2, y, 0), (2, y, 0)), plane(normal, 3.0), rng, told=told)
    for x in (-1.0, 0.5):
        heard(legs, leg((x, -1.2, 0), (x, 1.0, 0)), plane(normal, 3.0), rng, told=told)
    assert not len(told_ways(legs, told))


def test_one_leg_out_of_that_plane_decides_it():
    rng, legs, told = np.random.default_rng(3), Legs(), []
    normal = np.array([0.0, np.cos(0.6), np.sin(0.6)])
    for y, z in ((-1.2, 0), (-0.6, 0), (0.0, 0), (-0.3, 0.7)):
        heard(legs, leg((-2, y, z), (2, y, z)), plane(normal, 3.0), rng, told=told)
    ways = told_ways(legs, told)
    assert len(ways) >= 15
    assert (ways @ normal).min() > np.cos(np.radians(6))


def test_a_straight_climb_and_level_legs_tell_walls_on_all_sides():
    rng, legs, told = np.random.default_rng(4), Legs(), []
    corners = [(-1.5, -1, -0.8), (1.5, -1, -0.4), (1.5, 1, 0.0), (-1.5, 1, 0.4), (-1.5, -1, 0.8), (1.5, -1, 0.8)]
    right = 0
    for sign in (-1.0, 1.0):
        legs, told = Legs(), []
        for a, b in pairwise(corners):
            heard(legs, leg(a, b), plane((0, sign, 0), 2.2), rng, ahead=sign * ABEAM, told=told)
        ways = told_ways(legs, told)
        right += len(ways)
        assert (ways[:, 1] * sign).min() > np.cos(np.radians(8))
    assert right > 20


def fly_in_tank(legs: Legs, path: np.ndarray, side: float, rng) -> list:
    """Hear the wall of a round tank of 3.2 m on one side (1 out, -1 across) from stretches of a path."""
    track = np.gradient(path, axis=0)
    track /= np.linalg.norm(track, axis=1)[:, None]
    away = np.hypot(path[:, 0], path[:, 1])
    way = side * path * [1, 1, 0] / away[:, None]
    reach = 3.2 - side * away + rng.normal(0, 0.002, len(path))
    cosine = np.sum(way * track, axis=1) + rng.normal(0, 0.01, len(path))
    echoes = [Echo(j, path[j], track[j], reach[j], cosine[j], 1e-3, 0.02, 0.9) for j in range(len(path))]
    told = []
    for k in range(0, len(path) - 12, 13):
        legs.add(echoes[k : k + 13], echoes[max(k - 13, 0) : k + 13], way[k + 6], LEAST, 2.0)
        told += legs.tell(2)
    return told


def told_in_tank(told: list) -> np.ndarray:
    """Cosines between the ways that are told and the true ones."""
    out = []
    for echoes, ways, _, radius, post in told:
        assert post is None
        places = np.array([e.position for e in echoes]) * [1, 1, 0]
        out += (np.sum(ways * places, axis=1) / np.linalg.norm(places, axis=1)).tolist()
        assert radius == pytest.approx(3.2, abs=0.25)
    return np.array(out)


def test_rounds_at_three_heights_tell_the_wall_of_a_round_tank():
    rng, legs, told = np.random.default_rng(5), Legs(), []
    turn = np.linspace(0, 2 * np.pi, 160)
    for z in (-0.7, 0.0, 0.7):
        path = np.column_stack([1.3 * np.cos(turn), 1.3 * np.sin(turn), np.full(len(turn), z)])
        told += fly_in_tank(legs, path, 1.0, rng)
    right = told_in_tank([*told, *legs.tell_all()])
    assert len(right) >= 25 * 13
    assert right.min() > np.cos(np.radians(8))


@pytest.mark.parametrize("side", [1.0, -1.0])
def test_two_rounds_of_straight_climbing_legs_tell_a_tanks_wall_before_and_past_its_focus(side):
    rng, legs, told = np.random.default_rng(11), Legs(), []
    corners = [(-1.2, -1.2), (1.2, -1.2), (1.2, 1.2), (-1.2, 1.2)] * 2
    heights = [-0.8, -0.3, 0.1, 0.4, 0.8, 0.2, -0.2, -0.8]
    places = [np.array([*xy, z]) for xy, z in zip(corners, heights, strict=True)]
    for a, b in pairwise(places):
        told += fly_in_tank(legs, leg(a, b), side, rng)
    right = side * told_in_tank([*told, *legs.tell_all()])
    assert len(right) >= 11 * 13, "of some 24 stretches"
    assert right.min() > np.cos(np.radians(8))


def test_one_straight_climb_leaves_a_tanks_wall_open():
    rng, legs = np.random.default_rng(12), Legs()
    assert not fly_in_tank(legs, leg((-1.2, -1.2, -0.4), (1.2, -1.2, 0.4)), 1.0, rng)
    assert not list(legs.tell_all())


def test_one_place_of_another_leg_is_not_enough_for_a_tanks_wall():
    rng, legs = np.random.default_rng(12), Legs()
    assert not fly_in_tank(legs, leg((-1.2, -1.2, -0.4), (1.2, -1.2, 0.4)), 1.0, rng)
    assert not fly_in_tank(legs, leg((0.35, -1.2, 0.9), (-0.35, -1.2, 0.6)), 1.0, rng)
    assert not list(legs.tell_all())


def tank_stretch(at, way, number: int, more_m: float = 0.0) -> np.ndarray:
    """A level stretch (22) that hears the wall of a round tank of 3.2 m in some way, or what is so much farther off."""
    at = np.asarray(at) + np.linspace(-0.6, 0.6, 25)[:, None] * [1.0, 0, 0]
    reach = 3.2 + more_m - np.sign(way[1] * at[12, 1]) * np.hypot(at[:, 0], at[:, 1])
    echoes = [Echo(j, at[j], np.array([1.0, 0, 0]), reach[j], 0.0, 1e-3, 0.02, 0.9) for j in range(25)]
    row = stretch_of(echoes[8:17])
    row[LEG], row[AHEAD : AHEAD + 3], row[WIDE] = number, way, LEAST
    return bowed_row(row, bow_of(echoes))


def test_a_tanks_wall_is_borne_out_from_its_side_and_from_across_but_not_by_the_other_side():
    out = np.array([0.0, 1.0, 0.0])
    me = tank_stretch((0, 1.2, 0), out, 0)
    line = np.array([[0, 0, 1.0]]), np.array([-1.2]), np.array([0.02])
    for other, borne in (
        (tank_stretch((0.4, 1.0, 0.8), out, 1), 1),
        (tank_stretch((0.3, -1.1, -0.4), out, 1), 1),
        (tank_stretch((0.3, -1.1, -0.4), -out, 1), 0),
    ):
        assert weigh(me, other[None], out[None], *line)[1][0] == pytest.approx(borne, abs=0.1)


@pytest.mark.parametrize(("far_x", "share"), [(0.3, 1.0), (-0.5, 0.25)])
def test_a_place_hears_a_wall_though_what_else_is_heard_there_has_its_middle_elsewhere(far_x, share):
    """What comes by way of other walls makes places of its own, here three; they are silent only where the leg is."""
    out = np.array([0.0, 1.0, 0.0])
    me, wall = tank_stretch((0, 1.2, 0), out, 0), Hollow(np.zeros(3), np.array([0.0, 0, 1]), 3.2)
    beside = [tank_stretch((far_x, y, 0.8 + z), out, 1, 3.0) for y, z in ((1.25, 0.0), (1.0, 0.45), (1.25, 0.45))]
    places = _by_place(np.array([tank_stretch((0.1, 1.1, 0.8), out, 1), *beside]))
    heard = _share_heard(me, wall, out, places, 0.02)
    assert len(np.unique(places[:, LEG])) > 2
    assert heard == pytest.approx(share, abs=0.1)


def test_an_upright_edge_makes_no_wall():
    rng, legs, told = np.random.default_rng(6), Legs(), []
    for z in (-0.8, 0.0, 0.7):
        heard(legs, leg((-1.2, 0, z), (1.2, 0, z)), lambda p: np.hypot(p[:, 0], p[:, 1] - 1.2), rng, told=told)
    assert not len(told_ways(legs, told))


@pytest.mark.parametrize("slope_deg", [0, 40, 90])
def test_an_edge_flown_at_makes_no_wall_once_a_leg_hears_it_from_the_side(slope_deg):
    """Legs beside each other that fly at an edge hear what a wall would make; one that passes it does not."""
    rng, legs, told = np.random.default_rng(9), Legs(), []
    up = np.radians(slope_deg)
    edge, place = np.array([0.0, np.cos(up), np.sin(up)]), np.array([2.6, 0.0, 0.0])
    aside = np.cross([1.0, 0, 0], edge)

    def far(at: np.ndarray) -> np.ndarray:
        gap = at - place
        return np.linalg.norm(gap - (gap @ edge)[:, None] * edge, axis=1)

    for along in (-0.5, 0.1, 0.7):
        start = along * edge + [0.3, 0, 0]
        heard(legs, leg(start - 1.5 * aside, start + 1.5 * aside), far, rng, ahead=np.array([1.0, 0, 0]), told=told)
    for along in (-0.6, 0.0, 0.6):
        start = along * edge + 0.9 * aside + [0.6, 0, 0]
        heard(legs, leg(start - [1.6, 0, 0], start), far, rng, ahead=np.array([1.0, 0, 0]), told=told)
    assert not len(told_ways(legs, told))


def test_the_bend_of_an_edge_is_one_and_that_of_a_wall_nothing():
    at = leg((-0.4, 0, 0), (0.4, 0, 0.2))
    for reach, bend in ((1.5 - at[:, 1], 0.0), (np.hypot(at[:, 0], at[:, 1] - 1.5), 1.0)):
        echoes = [Echo(j, at[j], at[1] - at[0], reach[j], 0.0, 1e-3, 0.02, 0.9) for j in range(len(at))]
        assert bends_of(echoes, ABEAM[None], stretch_of(echoes))[0] == pytest.approx(bend, abs=0.08)


def test_what_scatters_or_is_not_believed_is_no_stretch():
    at = leg((-0.4, 0, 0), (0.4, 0, 0))
    rough = np.random.default_rng(7).normal(0, 0.05, len(at))
    for reach, trust in ((2.0 + rough, 0.9), (np.full(len(at), 2.0), 0.1)):
        assert stretch_of([Echo(j, at[j], at[1], reach[j], 0, 1e-3, 0.02, trust) for j in range(len(at))]) is None


@pytest.mark.parametrize(("known", "waits"), [(0, True), (6, True), (7, False)])
def test_a_stretch_of_which_less_than_half_is_known_waits_to_be_told(known, waits):
    path, legs = leg((-0.31, 0, 0), (0.31, 0, 0)), Legs()
    echoes = [Echo(j, at, np.array([1.0, 0, 0]), 2.0, 0.0, 1e-3, 0.02, 0.9, way=ABEAM if j < known else None)
              for j, at in enumerate(path)]  # fmt: skip
    assert len(echoes) == 12
    legs.add(echoes, echoes, ABEAM, LEAST, 2.0)
    assert bool(legs._waiting) == waits


def test_only_so_much_is_kept(monkeypatch):
    monkeypatch.setattr(mapper_legs, "MOST_STRETCHES", 17)
    rng, legs, told = np.random.default_rng(8), Legs(), []
    for z in (-0.8, 0.0, 0.7, -0.4, 0.4):
        heard(legs, leg((-2, 0, z), (2, 0, z)), plane(ABEAM, 2.5), rng, told=told)
    told += legs.tell_all()
    assert len(told) > 17, "what comes later still is told"


@pytest.mark.parametrize(("near_db", "near_slope", "hidden"), [(0.0, 0.0, True), (0.0, 0.5, False), (-40.0, 0.0, False),
                                                               (np.inf, 0.0, False)])  # fmt: skip
def test_what_is_heard_past_a_nearer_wall_came_by_that_wall(near_db, near_slope, hidden):
    """Two surfaces abeam of one stretch, 2 and 5 m off: loud or faint, in the same way or elsewhere."""
    path, legs = leg((-0.3, 0, 0), (0.3, 0, 0)), Legs()
    track = np.array([1.0, 0, 0])
    for reach, level, slope in ((2.0, near_db, near_slope), (5.0, 0.0, 0.0)):
        echoes = [Echo(j, at, track, reach - slope * at[0], slope, 1e-3, 0.02, 0.9, ABEAM, level_db=level)
                  for j, at in enumerate(path)]  # fmt: skip
        legs.add(echoes, echoes, ABEAM, LEAST, 2.0)
    assert not legs._behind(0, ABEAM), "the nearer one"
    assert legs._behind(1, ABEAM) == hidden
    assert not legs._behind(1, np.array([-0.5, 0.8, 0.3]))


@pytest.mark.parametrize(("wall_m", "bent"), [(1.6, False), (1.6, True), (2.4, False)])
def test_what_is_heard_from_where_floor_and_wall_meet_is_no_wall_behind_it(wall_m, bent):
    """A floor that is known 1.1 m below, a wall abeam and an echo off both in turn, on a leg that climbs."""
    path, legs, found = leg((-0.3, 0, -0.05), (0.3, 0, 0.05)), Legs(), []
    track = (path[-1] - path[0]) / np.linalg.norm(path[-1] - path[0])
    down = path[:, 2] + 1.1
    abeam = np.hypot(path[:, 0], wall_m) if bent else np.full(len(path), wall_m)
    floor = np.array([0.0, 0.0, -1.0])
    for reach in (down, np.full(len(path), 1.6), np.hypot(down, abeam)):
        fall = -np.gradient(reach) / np.linalg.norm(path[1] - path[0])
        echoes = [Echo(j, at, track, reach[j], fall[j], 1e-3, 0.02, 0.9, ABEAM, way=floor if reach is down else None)
                  for j, at in enumerate(path)]  # fmt: skip
        legs.add(echoes, echoes, ABEAM, LEAST, 2.0)
        found.append(legs._in_corner(len(found)))
    assert found == [False, False, wall_m == 1.6]


def test_a_floor_is_not_the_wall_of_its_own_corner():
    """On a level leg 1.1 m over a floor a wall at 1.1 m times the root of two is as a corner of two such floors."""
    path, legs, found = leg((-0.3, 0, 0), (0.3, 0, 0)), Legs(), []
    for reach, way in ((1.1, np.array([0.0, 0.0, -1.0])), (1.1 * np.sqrt(2), None)):
        echoes = [Echo(j, at, np.array([1.0, 0, 0]), reach, 0.0, 1e-3, 0.02, 0.9, ABEAM, way=way)
                  for j, at in enumerate(path)]  # fmt: skip
        legs.add(echoes, echoes, ABEAM, LEAST, 2.0)
        found.append(legs._in_corner(len(found)))
    assert found == [False, False]


@pytest.mark.parametrize(("turns_deg", "known"), [((0, 30, 60), True), ((0, 60), False)])
def test_a_bent_wall_is_known_on_round_from_where_it_was_last_known(turns_deg, known):

    hollows, up = Hollows(), np.array([0.0, 0.0, 1.0])
    hollows._keep(Hollow(np.zeros(3), up, 3.0), ABEAM, 3.0 * ABEAM)
    for turn in np.radians(turns_deg):
        way, track = np.array([-np.sin(turn), np.cos(turn), 0.0]), np.array([np.cos(turn), np.sin(turn), 0.0])
        places = 1.4 * way + np.linspace(-0.3, 0.3, 13)[:, None] * track
        away = np.linalg.norm(places, axis=1)
        fall = np.sum(places * track, axis=1) / away
        echoes = [Echo(j, places[j], track, 3.0 - away[j], fall[j], 1e-3, 0.02, 0.9, way) for j in range(13)]
        row = stretch_of(echoes)
        row[AHEAD : AHEAD + 3], row[WIDE] = way, LEAST
        found = hollows.known(row, echoes, lambda _: False)
    assert (found is not None) == known
