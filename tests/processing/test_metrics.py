from dataclasses import replace

import numpy as np
import pytest

import ullage as ul
from ullage.data import Frames, Trajectory
from ullage.grids import AMBIGUOUS, UNKNOWN, OccupancyMap
from ullage.processing.truth import MOST_POINTS, surface_of
from ullage.world.scene import Scene

SPEC = ul.RadarSpec.preset("x4m05")
GRID = ul.Grid.covering([[-4, -3, -2], [4, 3, 2]], 0.1, z_m=0.0)


def flight(yaws=(0, 90, 180, -90), *, unit="path_gain"):
    out = {}
    for yaw in yaws:
        path = Trajectory.line((-2, 0.03, 0), (2, 0.03, 0), rate_hz=5, yaw_deg=yaw)
        samples = np.zeros((len(path), SPEC.bins), np.complex64)
        out[str(yaw)] = Frames(
            samples, SPEC.range_m, path.t_ns, SPEC, poses=path, truth=path, sensor=str(yaw), unit=unit
        )
    return out


ROOM = ul.scenes.room((6.0, 4.0, 3.0))


def perfect():
    x, y = np.meshgrid(GRID.x_m, GRID.y_m)
    percent = np.full(GRID.shape, UNKNOWN, np.int8)
    percent[(abs(x) < 3) & (abs(y) < 2)] = 1
    wall = (abs(abs(x) - 3.05) < 0.02) & (abs(y) < 2.1) | (abs(abs(y) - 2.05) < 0.02) & (abs(x) < 3.1)
    percent[wall] = 99
    return percent


def score(percent, frames=None, scene=ROOM):
    got = ul.metrics.map_quality(OccupancyMap(GRID, percent), scene, frames or flight())
    assert all(name == m.name for name, m in got.items())
    return {name: m.value for name, m in got.items()}


def test_a_perfect_map_scores_one():
    got = score(perfect())
    assert got["f1"] == got["precision"] == got["recall"] == 1.0
    assert got["recall_half_cell"] == 1.0
    assert got["precision_half_cell"] > 0.97  # all but the four cells that only touch a corner of the room
    assert got["accuracy_median"] == pytest.approx(0.05, abs=3e-3)
    assert got["surface_declared_free"] < 0.01
    assert got["known_behind"] == 0
    assert got["false_occupied"] == 0
    assert got["corridor_falsely_blocked"] == got["corridor_falsely_clear"] == 0
    assert got["free_found"] == 1.0
    assert got["log_likelihood"] > -0.03
    assert got["ece"] < 0.02


@pytest.mark.parametrize("dims", [2, 3])
def test_walls_on_the_border_of_the_grid_are_on_it(dims):
    grid = ul.Grid.covering(ROOM.bounds, 0.1, dims=dims)
    near_wall = np.ones(grid.shape, bool)
    near_wall[(slice(1, -1),) * dims] = False
    percent = np.where(near_wall, 99, 1).astype(np.int8)
    got = {n: m.value for n, m in ul.metrics.map_quality(OccupancyMap(grid, percent), ROOM, flight()).items()}
    assert got["precision"] == got["recall"] == 1.0
    assert got["surface_declared_free"] == 0.0
    percent[..., :, -1] = 1  # the wall ahead, on the upper border, is lost
    got = {n: m.value for n, m in ul.metrics.map_quality(OccupancyMap(grid, percent), ROOM, flight()).items()}
    assert got["recall"] < 0.9
    assert got["surface_declared_free"] > 0.05


def test_an_unknown_map_scores_nothing_and_is_not_punished_as_wrong():
    got = score(np.full(GRID.shape, UNKNOWN, np.int8))
    assert got["f1"] == got["precision"] == got["recall"] == got["free_found"] == 0.0
    assert got["surface_declared_free"] == got["false_occupied"] == got["known_behind"] == 0.0
    assert got["log_likelihood"] == pytest.approx(np.log(0.5))
    assert got["brier"] == pytest.approx(0.25)


def test_shifted_walls_lose_half_a_cell_score_first_and_give_their_shift():
    shifted = np.full(GRID.shape, UNKNOWN, np.int8)
    shifted[:, 10:] = np.where(perfect() == 99, 99, UNKNOWN)[:, :-10][:, : shifted.shape[1] - 10]
    got = score(shifted)
    assert got["precision"] < 0.9
    assert got["accuracy_p90"] == pytest.approx(0.95, abs=0.06)
    assert got["f1_half_cell"] <= got["f1"]


def test_a_wall_one_cell_off_counts_within_15_cm_but_not_within_half_a_cell():
    x, y = np.meshgrid(GRID.x_m, GRID.y_m)
    wall = (abs(abs(x) - 3.15) < 0.02) & (abs(y) < 2.2) | (abs(abs(y) - 2.15) < 0.02) & (abs(x) < 3.2)
    percent = np.where(wall, 99, UNKNOWN).astype(np.int8)
    got = {
        n: m.value for n, m in ul.metrics.map_quality(OccupancyMap(GRID, percent), ROOM, flight(), match_m=0.16).items()
    }
    assert got["precision"] > 0.9  # all but those about the corners
    assert got["precision_half_cell"] == got["recall_half_cell"] == 0.0


def test_free_walls_free_space_behind_them_and_false_obstacles_are_counted():
    everything_free = np.full(GRID.shape, 0, np.int8)
    got = score(everything_free)
    assert got["surface_declared_free"] == got["surface_missed_and_free"] == 1.0
    x, y = np.meshgrid(GRID.x_m, GRID.y_m)
    assert got["known_behind"] == pytest.approx(np.mean(np.maximum(abs(x) - 3, abs(y) - 2) > 0.3), abs=0.03)
    assert got["corridor_falsely_clear"] == 1.0
    ghost = perfect()
    ghost[30:32, 40:42] = 90
    got = score(ghost)
    assert got["false_occupied"] == 4
    assert got["false_occupied_per_100m2"] == pytest.approx(400 / 24, rel=0.05)
    assert 0 < got["corridor_falsely_blocked"] < 0.2


def test_smooth_walls_are_observable_only_near_their_normal_and_rough_thesis_rays_see_more():
    got = score(perfect())
    physical = ul.metrics.map_quality(OccupancyMap(GRID, perfect()), ROOM, flight())
    thesis = ul.metrics.map_quality(OccupancyMap(GRID, perfect()), ROOM, flight(unit="thesis"))
    assert physical["surface_observable"].value < thesis["surface_observable"].value
    assert got["surface_observable"] + got["surface_specular_invisible"] + got["surface_hidden"] == pytest.approx(1.0)
    ahead_only = score(perfect(), flight((0,)))
    # From y = 0.03 the east wall is within 10 deg of its normal for |y| < tan(10 deg) x 5 m at most: 1.76 of 20 m.
    assert ahead_only["surface_observable"] == pytest.approx(1.76 / 20, abs=0.012)


def test_what_is_hidden_is_not_asked_for():
    plate = ul.scenes.room((6.0, 4.0, 3.0), plate={"width_m": 1.0, "height_m": 3.0, "distance_m": 2.5})
    frames = flight((0,))
    seen = surface_of(plate, GRID, frames)
    wall = seen.object_id == plate.object("wall_east")
    behind = wall & (abs(seen.points[:, 1]) < 0.4)
    assert behind.any()
    assert not seen.seen[behind].any()
    assert seen.seen[wall & (abs(seen.points[:, 1]) > 1.2)].any()


def test_wires_and_poles_are_asked_for_by_name():
    pole = Scene.of_wires((1.0, 1.0, -1.5), (1.0, 1.0, 1.5), 0.005, name="pole")
    scene = Scene.union([ROOM, pole])
    assert score(perfect(), scene=scene)["found:pole"] == 0.0
    with_pole = perfect()
    with_pole[tuple(GRID.index([[1.0, 1.0, 0.0]])[0][0])] = 80
    got = score(with_pole, scene=scene)
    assert got["found:pole"] == 1.0
    assert got["false_occupied"] == 0


def test_ambiguous_is_neither_occupied_nor_known():
    vague = np.where(perfect() == 99, AMBIGUOUS, perfect()).astype(np.int8)
    got = score(vague)
    assert got["f1"] == 0.0
    assert got["surface_declared_free"] < 0.01


def test_chances_that_come_true_have_no_calibration_error():
    rng = np.random.default_rng(0)
    solid = perfect() == 99
    percent = np.where(solid, 100, 0).astype(np.int8)
    assert score(percent)["ece"] < 0.011
    wrong = np.where(rng.random(solid.shape) < 0.5, percent, 100 - percent).astype(np.int8)
    assert score(wrong)["ece"] > 0.4


def test_reliability_counts_what_came_true():
    percent = perfect()
    rows = ul.metrics.reliability(OccupancyMap(GRID, percent), ROOM, flight())
    assert [(row.low, row.high, row.held) for row in rows] == [(0, 1, 0.0), (95, 100, 1.0)]
    assert sum(row.cells for row in rows) <= (percent >= 0).sum()
    doubt = np.where(percent == 99, 70, percent).astype(np.int8)
    doubt[:12] = np.where(doubt[:12] == 1, 70, doubt[:12])  # free cells beside the wall
    row = ul.metrics.reliability(OccupancyMap(GRID, doubt), ROOM, flight())[1]
    assert (row.low, row.said) == (65, pytest.approx(0.7))
    assert 0.1 < row.held < 0.9


def test_hover_change_is_the_difference():
    before, after = perfect(), perfect()
    after[30, 40:45] = 90
    change = ul.metrics.hover_change(OccupancyMap(GRID, before), OccupancyMap(GRID, after), ROOM, flight())
    assert change["hover_false_occupied"].value == 5
    assert change["hover_f1"].value < 0


@pytest.mark.slow
def test_volume_maps_are_judged_over_all_surfaces():
    grid = ul.Grid.covering([[-3.2, -2.2, -1.7], [3.2, 2.2, 1.7]], 0.15, dims=3)
    z, y, x = np.meshgrid(grid.z_m, grid.y_m, grid.x_m, indexing="ij")
    outside = np.maximum.reduce([abs(x) - 3, abs(y) - 2, abs(z) - 1.5])
    percent = np.where(abs(outside) <= 0.08, 99, np.where(outside < 0, 0, UNKNOWN)).astype(np.int8)
    got = {n: m.value for n, m in ul.metrics.map_quality(OccupancyMap(grid, percent), ROOM, flight()).items()}
    assert got["precision"] == 1.0
    assert got["recall"] == 1.0
    assert got["known_behind"] == 0.0
    assert got["free_found"] > 0.99


def hall_with_pipes():
    """A room whose six walls have few triangles, and thin pipes of very many, with 2 % of its area or less."""
    named = []
    for k in range(4):
        pipe = ul.scenes.cylinder(radius_m=0.02, height_m=2.9, distance_m=2.0 + 0.2 * k)
        named.append(replace(pipe, objects=tuple(replace(one, name=f"pipe{k}") for one in pipe.objects)))
    return Scene.union([ROOM, *named])


@pytest.mark.parametrize("spacing_m", [0.05, 0.2])
def test_surfaces_of_a_volume_are_sampled_by_their_area(spacing_m):
    scene = hall_with_pipes()
    corners = scene.corners()
    area = np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1) / 2
    grid = ul.Grid.covering(scene.bounds, 0.1, dims=3)
    surface = surface_of(scene, grid, flight(), spacing_m=spacing_m)
    count = len(surface.points)
    assert count == pytest.approx(area.sum() / spacing_m**2, rel=0.02)
    for index in range(len(scene.objects)):
        share = area[scene.face_object == index].sum() / area.sum()
        assert np.mean(surface.object_id == index) == pytest.approx(share, abs=1.5 / count)
    again = surface_of(scene, grid, flight(), spacing_m=spacing_m)
    np.testing.assert_array_equal(surface.points, again.points)


def test_samples_of_one_face_are_spread_evenly_over_it():
    plate = ul.scenes.plate(2.0, 2.0, 2.5)
    grid = ul.Grid.covering([[0, -2, -2], [4, 2, 2]], 0.1, dims=3)
    surface = surface_of(plate, grid, flight(), spacing_m=0.05)
    cells = np.floor((surface.points[:, 1:] + 1.0) / 0.25).astype(int)
    counts = np.bincount(cells @ [8, 1], minlength=64)
    assert counts.mean() == pytest.approx(25, rel=0.05)
    assert counts.std() < 0.6 * np.sqrt(25)  # of independent draws it would be the root of the mean


def test_no_more_samples_are_taken_than_the_cap():
    grid = ul.Grid.covering(ROOM.bounds, 0.1, dims=3)
    surface = surface_of(ROOM, grid, flight((0,)), spacing_m=0.005)
    assert 0.99 * MOST_POINTS < len(surface.points) <= MOST_POINTS


def test_recall_in_view_counts_what_no_radar_echo_comes_from():
    """All four walls are in view of the flight; half of the map's walls are missing."""
    got = score(perfect())
    assert got["recall_in_view"] == got["recall"] == 1.0
    half = perfect()
    half[:, : half.shape[1] // 2][half[:, : half.shape[1] // 2] == 99] = UNKNOWN
    assert score(half)["recall_in_view"] == pytest.approx(0.5, abs=0.05)
    assert score(half, flight((0,)))["recall"] > 0.95, "what lies ahead is still there"


def test_flyable_space_is_what_a_ball_of_30_cm_fits_in():
    got = score(perfect())
    assert got["flyable_found"] == 1.0
    assert got["flyable_false"] == 0.0
    lost = perfect()
    lost[:, lost.shape[1] // 2 :] = UNKNOWN
    assert 0.4 < score(lost)["flyable_found"] < 0.5  # and none within 0.3 m of what is unknown
    wide = np.full(GRID.shape, 0, np.int8)  # all free, to the border of the grid
    inside = np.mean([(abs(x) < 2.7) & (abs(y) < 1.7) for x in GRID.x_m for y in GRID.y_m])
    offered = np.mean([(abs(x) < 3.7) & (abs(y) < 2.7) for x in GRID.x_m for y in GRID.y_m])
    assert score(wide)["flyable_false"] == pytest.approx(1 - inside / offered, abs=0.01)


def test_a_grid_beside_the_scene_is_refused():
    grid = ul.Grid.covering([[50, 50, 0], [52, 52, 1]], 0.1)
    with pytest.raises(ul.InputError, match="no surface of the scene lies on the grid"):
        ul.metrics.map_quality(OccupancyMap(grid, np.zeros(grid.shape, np.int8)), ROOM, flight())


def test_size_and_cost_are_measured():
    size = ul.metrics.map_size(OccupancyMap(GRID, perfect()))
    assert size["ram"].value == OccupancyMap(GRID, perfect()).nbytes < GRID.size
    assert size["file"].value < 600
    from ullage.processing.occupancy import Mapper

    cost = ul.metrics.map_cost(Mapper(GRID, method="elfes"), {k: f[:3] for k, f in flight().items()})
    assert cost["cpu_p99"].value >= cost["cpu_median"].value >= 0


def test_the_worst_moment_is_that_of_the_worst_map_and_not_of_the_last():
    false, free = perfect(), perfect()
    false[20:23, 20:24] = 99  # twelve cells in the middle of the room
    free[free == 99] = 1
    maps = [(float(at), OccupancyMap(GRID, percent)) for at, percent in enumerate((perfect(), false, free, perfect()))]
    got = {name: m.value for name, m in ul.metrics.worst_moment(maps, ROOM, flight()).items()}
    assert got["worst_false_occupied"] == 12
    assert got["worst_false_occupied_at"] == 1.0
    assert got["worst_surface_declared_free"] > 0.9
    assert got["worst_surface_declared_free_at"] == 2.0
    assert ul.metrics.worst_moment([], ROOM, flight()) == {}
