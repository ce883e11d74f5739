"""The pixels of figures and of the viewer's pictures: titles whole, unknown clear, the floor visible."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from matplotlib.image import imread

import ullage as ul
from ullage.view import figures, viewer_plots
from ullage.view.report_figures import own_echo_figure

LONG = "A title that goes on and on, as those of scenarios that say where, how and with which radars one flies, do"


def some_frames() -> ul.Frames:
    path = ul.Trajectory.line((0, -0.5, 0), (0, 0.5, 0), 0.5, 17)
    frames = ul.simulate(ul.scenes.plate(width_m=1, height_m=1, distance_m=2), path, ul.RadarSpec.preset("x4m05"))
    assert isinstance(frames, ul.Frames)
    return frames


def assert_whole(picture: Path) -> None:
    """Nothing is drawn at the border of a picture, so nothing is cut off."""
    pixels = imread(picture)[..., :3]
    for edge in (pixels[:3], pixels[-3:], pixels[:, :3], pixels[:, -3:]):
        assert edge.min() == 1.0


def test_long_titles_are_not_cut_off(tmp_path: Path) -> None:
    frames = some_frames()
    image = ul.Image(ul.Grid((0, 0, 0.5), 0.1, (20, 20)), np.ones((20, 20), np.float32), None, "backprojection")
    walls = np.array([[[0.0, 0.0], [1.0, 1.0]]])
    omap = ul.OccupancyMap(image.grid, np.full((20, 20), 50, np.int8))
    picture = ("front", frames.t_ns * 1e-9, frames.range_m, frames.amplitude.astype(float))
    found = {"front": ul.own_echo(frames)}
    assert_whole(figures.snapshot_figure(tmp_path / "a.png", [frames], 3, threshold=None, title=LONG))
    assert_whole(figures.image_figure(tmp_path / "b.png", image, title=LONG, notes=[LONG, LONG], walls=walls))
    assert_whole(figures.map_figure(tmp_path / "c.png", omap, title=LONG, walls=walls))
    assert_whole(figures.range_time_figure(tmp_path / "d.png", [picture], unit="path_gain", title=LONG))
    assert_whole(own_echo_figure(tmp_path / "e.png", found, title=LONG))


def test_a_short_title_stays_on_one_line(tmp_path: Path) -> None:
    with figures.drawing(tmp_path / "a.png") as (figure, axes):
        axes.set_title("short")
    assert axes.get_title() == "short"
    with figures.drawing(tmp_path / "b.png") as (figure, axes):
        figure.suptitle(LONG)
    assert len(figure.get_suptitle().split("\n")) > 1
    assert figure.get_suptitle().replace("\n", " ") == LONG


def test_the_weaker_an_image_the_more_of_the_floor_is_seen() -> None:
    alpha = viewer_plots.image_colors(np.linspace(0, 1, 50))[:, 3].astype(int)
    assert alpha[0] == 0
    assert (np.diff(alpha) >= 0).all()
    assert alpha[10] < 60
    assert alpha[-1] > 200


def test_the_viewer_blends_planes_with_what_lies_behind(tmp_path: Path) -> None:
    """rerun draws a picture opaque, clear pixels black, unless its opacity is below 1."""
    rr = pytest.importorskip("rerun", reason="rerun-sdk is not installed: pip install 'ullage[view]'")
    path = tmp_path / "map.rrd"
    grid = ul.Grid((0, 0, 0), 1.0, (1, 4))
    with ul.sink(f"viewer:{path}") as viewer:
        viewer.write(ul.OccupancyMap(grid, np.array([[0, 100, -1, -2]], np.int8)))
        viewer.write(ul.Image(grid, np.array([[1, 0.5, 0.1, 0.01]], np.float32)))
    for entity in ("/world/map", "/world/image"):
        tables = [c.to_record_batch() for c in rr.chunk.RrdReader(path).stream() if c.entity_path == entity]
        values = [t.column(n).to_pylist() for t in tables for n in t.schema.names if n.endswith(":opacity")]
        assert values
        assert all(0.9 < v < 1 for rows in values for row in rows for v in row)
