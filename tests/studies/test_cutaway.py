"""Pictures of worlds: what is nearer hides what is farther, cuts open the world, files are small PNGs."""

from __future__ import annotations

import numpy as np
import pytest

import ullage as ul
from studies.cutaway import world_picture
from ullage.world.scene import Scene

RED, GREEN, BLUE = "#ff0000", "#00ff00", "#0000ff"


def views(scene, **options):
    figure = world_picture(scene, width_px=150, **options)
    return [np.asarray(axes.images[0].get_array()) for axes in figure.axes]


def middle(picture):
    rows, columns, _ = picture.shape
    return picture[rows // 2, columns // 2]


def two_plates():
    near = ul.scenes.plate(1, 1, 2.0, name="near")
    return Scene.union([ul.scenes.plate(1, 1, 3.0, name="far"), near])


@pytest.mark.parametrize(("azimuth", "channel"), [(180, 1), (0, 0)])
def test_the_nearer_plate_hides_the_farther(azimuth, channel):
    view, _ = views(two_plates(), elevation_deg=0, azimuth_deg=azimuth, cut_side_m=0, colors=[RED, GREEN])
    seen = middle(view)
    assert seen.argmax() == channel
    assert seen[1 - channel] == pytest.approx(0)


def test_a_cut_takes_away_the_roof():
    room = ul.scenes.room((4, 4, 2))
    colors = [GREEN, RED, *[BLUE] * 4]  # floor, ceiling, walls
    whole, plan = views(room, elevation_deg=80, cut_side_m=0, colors=colors)
    assert middle(whole).argmax() == 0
    assert middle(plan).argmax() == 1
    opened, _ = views(room, elevation_deg=80, cut_side_m=0, cut_height_m=0.9, colors=colors)
    assert middle(opened).argmax() == 1


def test_a_cut_takes_away_the_near_walls():
    room = ul.scenes.room((4, 4, 2))
    colors = [GREEN, GREEN, BLUE, RED, BLUE, BLUE]  # the south wall is red
    shut, _ = views(room, elevation_deg=0, azimuth_deg=-90, cut_side_m=0, colors=colors)
    opened, _ = views(room, elevation_deg=0, azimuth_deg=-90, cut_side_m=0.3, colors=colors)
    assert middle(shut).argmax() == 0
    assert middle(opened).argmax() == 2


def test_glass_is_seen_through():
    pane = ul.scenes.plate(1, 1, 2.0, name="pane", material="glass")
    scene = Scene.union([pane, ul.scenes.plate(1, 1, 3.0, name="far")])
    view, _ = views(scene, elevation_deg=0, azimuth_deg=180, cut_side_m=0, colors=[BLUE, RED])
    seen = middle(view)
    assert seen[0] > seen[2] > 0.1


def test_file_is_a_small_png(tmp_path):
    from PIL import Image

    target = tmp_path / "deep" / "room.png"
    world_picture(
        ul.scenes.room(), target, width_px=150, cut_height_m=1.2, waypoints=[(0, 0, 0), (1, 1, 0)], title="room"
    )
    with Image.open(target) as picture:
        assert picture.format == "PNG"
        assert picture.size == (1100, 490)
    assert target.stat().st_size < 60_000
    assert list(target.parent.iterdir()) == [target]


def test_an_empty_world_is_refused():
    with pytest.raises(ul.InputError, match="nothing to draw"):
        world_picture(Scene.empty())


def test_a_wire_too_thin_for_a_pixel_is_drawn():
    scene = Scene.union([two_plates(), ul.scenes.wire(0.0005, 0.9, 1.0)])
    figure = world_picture(scene, width_px=150, elevation_deg=0, azimuth_deg=180, cut_side_m=0, plan_height_m=0.2)
    view, plan = figure.axes
    line = np.asarray(view.lines[0].get_xydata())
    assert np.isfinite(line).all()
    assert np.ptp(line[:, 1]) == pytest.approx(0.9)
    assert np.asarray(plan.lines[0].get_xydata())[0] == pytest.approx([1.0, 0.0])
    behind = Scene.union([two_plates(), ul.scenes.wire(0.0005, 0.9, 4.0)])
    view = world_picture(behind, width_px=150, elevation_deg=0, azimuth_deg=180, cut_side_m=0).axes[0]
    assert np.isnan(np.asarray(view.lines[0].get_xydata())).all()
