"""What a pilot sees in the terminal: the right numbers at the right side, and the map the right way up."""

from __future__ import annotations

import io

import numpy as np
import pytest
from rich.console import Console

import ullage as ul
from ullage.data import Detections
from ullage.grids import Grid, OccupancyMap
from ullage.view import progress
from ullage.view.pilot_view import PilotView, side_of


def flown(x: float, y: float, z: float, yaw_deg: float = 0.0) -> ul.Trajectory:
    return ul.Trajectory.stationary(position_m=(x, y, z), yaw_deg=yaw_deg, n=2)


def plane(*occupied: tuple[int, int], shape: tuple[int, int] = (8, 12)) -> OccupancyMap:
    """A free plane of 1 m cells from (0, 0) on, with occupied cells (row from the south, column)."""
    percent = np.zeros(shape, np.int8)
    percent[:, -1] = -1
    for cell in occupied:
        percent[cell] = 100
    return OccupancyMap(Grid((0.0, 0.0, 1.0), 1.0, shape), percent)


def test_north_is_up_unknown_is_blank_and_the_arrow_shows_place_and_heading() -> None:
    view = PilotView(columns=12, rows=4)
    view.write(plane((7, 2), (0, 10)))
    view.write(flown(4.5, 2.5, 1.0, yaw_deg=90))
    state, *rows, legend = view.lines()
    assert state == "height 1.00 m   speed 0.00 m/s"
    assert rows == ["..#........", "...........", "....^......", "..........#"]
    assert "1 m wide, 2 m high" in legend


@pytest.mark.parametrize(("yaw_deg", "arrow"), [(0, ">"), (90, "^"), (180, "<"), (-90, "v"), (350, ">")])
def test_the_arrow_turns_with_the_vehicle(yaw_deg: float, arrow: str) -> None:
    view = PilotView(columns=12, rows=4)
    view.write(plane())
    view.write(flown(0.5, 7.5, 1.0, yaw_deg=yaw_deg))
    assert view.lines()[1][0] == arrow


def test_a_large_map_is_shown_whole_and_no_occupied_cell_is_lost() -> None:
    view = PilotView(columns=30, rows=10)
    view.write(plane((99, 0), (0, 298), (50, 150), shape=(100, 300)))
    rows = view.lines()[:-1]
    assert len(rows) <= 10
    assert max(map(len, rows)) <= 30
    assert [(r, row.index("#")) for r, row in enumerate(rows) if "#" in row] == [(0, 0), (len(rows) // 2, 15), (4, 29)]


def test_of_a_volume_the_cells_at_the_height_of_the_vehicle_are_shown() -> None:
    percent = np.zeros((10, 2, 2), np.int8)
    percent[2, 0, 0] = percent[7, 1, 1] = 100
    cells = OccupancyMap(Grid((0.0, 0.0, 0.0), 1.0, (10, 2, 2)), percent)
    shown = {}
    for height in (2.5, 7.5):
        view = PilotView(columns=2, rows=2)
        view.write(flown(-5, -5, height))
        view.write(cells)
        shown[height] = view.lines()[1:-1]
    assert shown == {2.5: ["#."], 7.5: [".#"]}


def test_the_nearest_echo_of_the_newest_frame_stands_at_the_side_of_its_radar_until_it_is_old() -> None:
    path = ul.Trajectory.line((0, 0, 0), (2, 0, 0), 0.5, 10.0)
    frames = ul.simulate(ul.scenes.room(size_m=(6, 4, 3)), path, ul.Rig.preset("thesis-4"), fidelity="thesis")
    assert isinstance(frames, dict)
    view = PilotView()
    view.write({name: part[:10] for name, part in frames.items()})
    t_ns = frames["left"].t_ns[[8, 9, 9]]
    nothing = np.full(3, np.nan)
    view.write(Detections(np.array([8, 9, 9]), t_ns, np.array([1.0, 2.5, 2.0]), nothing, nothing,
                          np.full((3, 3), np.nan), "left"))  # fmt: skip
    assert "front -   left 2.00   back -   right -" in view.lines()[0]
    view.write({name: part[30:] for name, part in frames.items()})
    assert "left -" in view.lines()[0]


def test_sides_follow_the_mount() -> None:
    turned = (
        {side_of(yaw, 0) for yaw in (0, 44, -44)},
        side_of(90, 0),
        side_of(-90, 0),
        side_of(180, 0),
        side_of(-180, 0),
    )
    assert turned == ({"front"}, "left", "right", "back", "back")
    assert (side_of(0, 90), side_of(0, -90)) == ("down", "up")


@pytest.mark.parametrize("terminal", [True, False])
def test_lines_stand_above_the_bar_of_a_terminal_only(monkeypatch: pytest.MonkeyPatch, terminal: bool) -> None:
    out = io.StringIO()
    monkeypatch.setattr(progress, "console", Console(file=out, force_terminal=terminal, width=80))
    with progress.progress_bar("flying", total=None, above=lambda: ["height 1 m"]) as bar:
        bar(1.0)
    assert ("height 1 m" in out.getvalue()) is terminal
    assert progress.shows_bars() is terminal
