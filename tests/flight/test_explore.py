"""The view planner on maps drawn by hand: what it may cross, when it has to be home, and what draws it."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.ndimage import distance_transform_edt

from ullage.errors import InputError
from ullage.flight.explore import RESERVE_S, Leg, ViewPlanner, direction
from ullage.grids import AMBIGUOUS, UNKNOWN, Grid, OccupancyMap

STEP_M, CLEARANCE_M = 0.1, 0.4
GRID = Grid((0.0, 0.0, 1.0), STEP_M, (80, 100))


def drawn(*free: tuple[float, float, float, float]) -> OccupancyMap:
    """A map with free boxes (left, right, bottom, top) [m]."""
    percent = np.full(GRID.shape, UNKNOWN, np.int8)
    for left, right, bottom, top in free:
        x, y = (GRID.x_m > left) & (GRID.x_m < right), (GRID.y_m > bottom) & (GRID.y_m < top)
        percent[np.ix_(y, x)] = 5
    return OccupancyMap(GRID, percent)


def planner(home: tuple[float, float] = (1.0, 1.0), **options: float | None) -> ViewPlanner:
    return ViewPlanner(GRID, np.array(home), clearance_m=CLEARANCE_M, speed_m_s=0.5, **options)


def room_along(omap: OccupancyMap, leg: Leg, barred: np.ndarray | None = None) -> float:
    """Least distance from the path to a barred cell, by default one of a surface, or off the grid [m]."""
    gap = distance_transform_edt(np.pad(~(omap.occupied if barred is None else barred), 1))[1:-1, 1:-1] * STEP_M
    points = np.concatenate([np.linspace(a, b, 50) for a, b in zip(leg.path[:-1], leg.path[1:], strict=True)])
    cells, _ = GRID.index(points)
    return float(gap[cells[:, 0], cells[:, 1]].min())


BOX = st.tuples(st.floats(1.5, 6.0), st.floats(0.3, 3.0), st.floats(0.5, 5.0), st.floats(0.3, 3.0))


@settings(deadline=None, max_examples=30)
@given(solids=st.lists(BOX, max_size=3), left_s=st.floats(5.0, 120.0))
def test_a_path_keeps_its_clearance_and_the_way_home_fits_the_time(
    solids: list[tuple[float, float, float, float]], left_s: float
) -> None:
    percent = drawn((0.3, 9.0, 0.3, 7.0)).percent.copy()
    for x, width, y, height in solids:
        here = (GRID.x_m > x) & (GRID.x_m < x + width), (GRID.y_m > y) & (GRID.y_m < y + height)
        percent[np.ix_(here[1], here[0])] = 95
    omap, head = OccupancyMap(GRID, percent), planner()
    now = head.at(omap, np.array([1.0, 1.0]))
    leg = head.next_view(now, left_s)
    if leg is None:
        return
    assert room_along(omap, leg) >= CLEARANCE_M
    assert leg.travel_s + leg.home_s + RESERVE_S <= left_s
    assert leg.travel_s >= np.linalg.norm(np.diff(leg.path, axis=0), axis=1).sum() / head.speed_m_s
    back = head.home(head.at(omap, leg.goal))
    assert back is not None
    assert back.travel_s == pytest.approx(leg.home_s)
    assert room_along(omap, back) >= CLEARANCE_M


@settings(deadline=None, max_examples=30)
@given(
    gaps=st.lists(BOX, max_size=3),
    value=st.sampled_from([UNKNOWN, AMBIGUOUS, 12, 50, 95]),
    least=st.sampled_from([0.5, 0.9, 0.95]),
)
def test_a_path_through_free_space_only_keeps_its_clearance_from_every_other_cell(
    gaps: list[tuple[float, float, float, float]], value: int, least: float
) -> None:
    """There and home, along tracks that were flown too; a cell may be unknown, ambiguous, or not free enough."""
    percent = drawn((0.3, 9.0, 0.3, 7.0)).percent.copy()
    for x, width, y, height in gaps:
        here = (GRID.x_m > x) & (GRID.x_m < x + width), (GRID.y_m > y) & (GRID.y_m < y + height)
        percent[np.ix_(here[1], here[0])] = value
    omap, head = OccupancyMap(GRID, percent), planner(free_probability=least)
    barred = (percent < 0) | (percent > 100 * (1 - least) + 1e-9)
    leg = head.next_view(head.at(omap, np.array([1.0, 1.0])), math.inf)
    assert leg is not None
    back = head.home(head.at(omap, leg.goal))
    assert back is not None
    for one in (leg, back):
        assert room_along(omap, one, barred) >= CLEARANCE_M


def test_through_free_space_only_the_vehicle_needs_free_room_at_its_start() -> None:
    """On a map that knows the hull alone no path begins; where unknown space at the start is free, one does."""
    omap, here = drawn((0.7, 1.3, 0.7, 1.3)), np.array([1.0, 1.0])
    boxed = planner(free_probability=0.95)
    assert boxed.at(omap, here).narrow
    assert boxed.next_view(boxed.at(omap, here), math.inf) is None
    head = planner(free_probability=0.95, free_start_m=0.8)
    leg = head.next_view(head.at(omap, here), math.inf)
    assert leg is not None
    assert np.linalg.norm(leg.path - here, axis=1).max() <= 0.8 - CLEARANCE_M + STEP_M
    percent = omap.percent.copy()
    percent[GRID.y_m < 0.7] = 95  # a surface stays one, at the start too
    open_ = np.argwhere(head.at(OccupancyMap(GRID, percent), here).open)
    assert GRID.y_m[open_[:, 0]].min() >= here[1] - STEP_M


@pytest.mark.parametrize(("value", "least", "closes"), [(UNKNOWN, None, False), (12, 0.85, False), (12, 0.9, True),
                                                        (UNKNOWN, 0.85, True), (AMBIGUOUS, 0.5, True)])  # fmt: skip
def test_a_line_to_the_path_that_is_not_free_enough_is_closed(value: int, least: float | None, closes: bool) -> None:
    omap, place, path = drawn((0.3, 9.0, 0.3, 7.0)), np.array([1.0, 3.5]), np.array([[6.0, 3.5]])
    percent, head = omap.percent.copy(), planner(free_probability=least)
    percent[:, 40:42] = value
    assert head.is_open(head.at(omap, place), path)
    assert head.is_open(head.at(OccupancyMap(GRID, percent), place), path) != closes


def test_the_goal_lies_at_the_frontier_and_not_at_a_wall() -> None:
    """A corridor from west to east, 1.5 m wide: solid at its sides and its west end, unknown at its east end."""
    percent = np.full(GRID.shape, 95, np.int8)
    percent[5:20, 5:60], percent[5:20, 60:] = 5, UNKNOWN
    leg = planner().next_view(planner().at(OccupancyMap(GRID, percent), np.array([1.0, 1.2])), math.inf)
    assert leg is not None
    assert leg.goal[0] > 2.0
    assert leg.words.endswith("east")


def test_where_all_of_a_way_teaches_the_vehicle_does_not_stop_at_its_first_metre() -> None:
    """A free lane between unknown sides: each metre of it teaches as much as the first."""
    head = planner((1.0, 3.6))
    leg = head.next_view(head.at(drawn((0.3, 9.5, 3.0, 4.2)), np.array([1.0, 3.6])), math.inf)
    assert leg is not None
    assert leg.goal[0] > 3.0


def test_a_room_that_is_known_throughout_is_worth_no_flight() -> None:
    percent = np.full(GRID.shape, UNKNOWN, np.int8)
    percent[3:62, 3:82] = 95  # a wall of two cells, with nothing known behind
    percent[5:60, 5:80] = 5
    now = planner().at(OccupancyMap(GRID, percent), np.array([1.0, 1.2]))
    assert planner().next_view(now, math.inf) is None
    assert not now.narrow


def test_ambiguous_cells_draw_as_unknown_ones_do() -> None:
    percent = drawn((0.3, 9.0, 0.3, 7.0)).percent.copy()
    unsure = np.where(percent == UNKNOWN, AMBIGUOUS, percent).astype(np.int8)
    first, second = (
        planner().next_view(planner().at(OccupancyMap(GRID, cells), np.array([1.0, 1.0])), math.inf)
        for cells in (percent, unsure)
    )
    assert first is not None
    assert second is not None
    assert first.gain_m2 == second.gain_m2


def test_views_that_teach_nothing_are_given_up_in_the_end() -> None:
    """The map never changes, as where echoes go elsewhere: every view is worth less than the one before."""
    percent = np.full(GRID.shape, 95, np.int8)
    percent[3:30, 3:35], percent[3:30, 35:45] = 5, UNKNOWN
    omap, head, place, gains = OccupancyMap(GRID, percent), planner(), np.array([1.0, 1.0]), []
    for _ in range(400):
        leg = head.next_view(head.at(omap, place), math.inf)
        if leg is None:
            break
        gains.append(leg.gain_m2)
        for share in np.linspace(0, 1, 5):
            head.saw(omap, place + share * (leg.goal - place))
        place = leg.goal
    assert leg is None
    assert gains[-1] < 0.5 * gains[0]


def rooms(door_m: float) -> OccupancyMap:
    """A known room in the west and an unknown one in the east, with a free door of some width between them."""
    percent = np.full(GRID.shape, 95, np.int8)
    percent[5:65, 5:40], percent[5:65, 43:85] = 5, UNKNOWN
    half = round(door_m / STEP_M / 2)
    percent[35 - half : 35 + half, 40:46] = 5
    return OccupancyMap(GRID, percent)


def test_a_view_lies_behind_a_door_that_fits() -> None:
    head, omap = planner(), rooms(1.0)
    now = head.at(omap, np.array([2.0, 2.0]))
    leg = head.next_view(now, math.inf)
    assert leg is not None
    assert leg.goal[0] > 4.0
    assert room_along(omap, leg) >= CLEARANCE_M
    assert head.cut_off_m2(now) == 0.0


def test_no_path_leads_through_a_door_that_does_not_fit() -> None:
    percent = rooms(0.6).percent.copy()
    percent[5:65, 50:85] = 5
    head, omap = planner(), OccupancyMap(GRID, percent)
    now = head.at(omap, np.array([2.0, 2.0]))
    leg = head.next_view(now, math.inf)
    assert leg is None or leg.goal[0] < 4.0
    assert not np.isfinite(now.away_m[0][now.cells[:, 1] > 43]).any()
    assert head.cut_off_m2(now) == pytest.approx(6.0 * 3.5, rel=0.05)


def test_a_path_through_known_space_is_preferred_to_a_shorter_one_through_unknown_space() -> None:
    """A wall with two doors: the space behind the near one is unknown."""
    percent = np.full(GRID.shape, 5, np.int8)
    percent[:, 45:55] = 95
    percent[15:30, 45:55], percent[50:65, 45:55] = UNKNOWN, 5
    head, east = planner((8.0, 3.5)), np.array([2.0, 3.5])
    for known in (UNKNOWN, 5):
        percent[15:30, 45:55] = known
        leg = head.home(head.at(OccupancyMap(GRID, percent), east))
        assert leg is not None
        at_wall = leg.path[np.abs(leg.path[:, 0] - 5.0).argmin(), 1]
        assert (at_wall > 4.0) == (known == UNKNOWN)


def test_mapped_surfaces_bar_the_way_home_and_what_was_flown_through_is_one() -> None:
    percent = drawn((0.3, 9.0, 0.3, 7.0)).percent.copy()
    percent[:, 30:35] = 95
    omap, head, there = OccupancyMap(GRID, percent), planner(), np.array([5.5, 1.5])
    assert head.home(head.at(omap, there)) is None
    for x in np.arange(1.0, 5.5, 0.05):
        head.flew(np.array([x, 1.0 + 0.5 * (x - 1.0) / 4.5, 1.0]))
    leg = head.home(head.at(omap, there))
    assert leg is not None
    assert leg.goal == pytest.approx([1.0, 1.0], abs=STEP_M)


def test_a_path_goes_round_a_place_where_the_guard_stopped() -> None:
    omap, head, here = drawn((0.3, 9.0, 0.3, 7.0)), planner((8.0, 3.5)), np.array([1.0, 3.5])
    direct = head.home(head.at(omap, here))
    head.stopped(np.array([4.5, 3.5]), 0.4)
    around = head.home(head.at(omap, here))
    assert direct is not None
    assert around is not None
    assert np.abs(direct.path[:, 1] - 3.5).max() < 0.2
    assert np.abs(around.path[:, 1] - 3.5).max() > 0.4
    head.stopped(np.array([4.5, 3.5]), 9.0)  # everywhere: it costs more, and is not closed
    again = head.home(head.at(omap, here))
    assert again is not None
    assert again.travel_s > 2 * direct.travel_s


def test_a_place_among_surfaces_is_narrow() -> None:
    now = planner().at(OccupancyMap(GRID, np.full(GRID.shape, 95, np.int8)), np.array([1.0, 1.0]))
    assert now.narrow
    assert planner().next_view(now, math.inf) is None


def test_directions_are_in_words() -> None:
    assert direction(np.array([0.0, 4.2])) == "4 m north"
    assert direction(np.array([-3.0, -3.0, 9.0])) == "4 m southwest"


def test_a_home_off_the_map_and_no_clearance_are_refused() -> None:
    with pytest.raises(InputError, match=r"\(20.00, 1.00\) m is off the map"):
        planner((20.0, 1.0))
    with pytest.raises(InputError, match="clearance_m is 0"):
        ViewPlanner(GRID, np.array([1.0, 1.0]), clearance_m=0, speed_m_s=0.5)
    with pytest.raises(InputError, match=r"chance is 2.*0.5 to 1"):
        planner(free_probability=2.0).at(drawn(), np.array([1.0, 1.0]))
