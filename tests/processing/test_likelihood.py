"""The likelihood mapper: laws first, on echoes whose ranges are known in closed form."""

from dataclasses import replace

import mirror_world as world
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

import ullage as ul
from ullage.data import Frames, Trajectory
from ullage.grids import UNKNOWN
from ullage.kernels.matched_sums import Aperture
from ullage.processing.likelihood.cells import _percentiles
from ullage.processing.likelihood.direction_sums import DirectionSums
from ullage.processing.likelihood.echoes import gains_of
from ullage.processing.likelihood.mapper import LikelihoodMapper
from ullage.processing.likelihood.poses import AperturePoses
from ullage.processing.likelihood.spec import LikelihoodSpec
from ullage.processing.likelihood.surfaces import smoothed
from ullage.processing.occupancy import Mapper

RIG = ul.Rig.preset("thesis-4").sensors
GRID = ul.Grid.covering([[-5, -4, -1], [5, 4, 1]], 0.1, z_m=0.0)


def curve(*, spacing=0.06, turns=0.35):
    """A bent track of 2.5 m through the middle."""
    angle = np.arange(-turns, turns, spacing / 3.5) * np.pi
    xy = np.stack([0.9 * np.sin(angle * 2.4), 0.5 * np.cos(angle * 2.4) - 0.5], axis=1)
    quat = np.tile([0, 0, 0, 1.0], (len(xy), 1))
    return Trajectory(np.arange(len(xy)) * 120_000_000, np.column_stack([xy, 0 * angle]), quat)


def flown(path, *reflectors, seed=0, spec=None):
    return world.reflected(path, reflectors, axes=2, seed=seed, spec=spec)


def wall(bearing_deg, distance_m, *, strength=0.5, folded_m=0.0):
    """A flat wall with its normal at a bearing; beyond the unambiguous range it folds back."""
    unit = np.array([np.cos(np.radians(bearing_deg)), np.sin(np.radians(bearing_deg))])
    return lambda at: (distance_m - at @ unit - folded_m, np.tile(unit, (len(at), 1)), strength)


def pillar(centre, radius_m, *, strength=0.3):
    def echo(at):
        ray = np.asarray(centre) - at
        far = np.linalg.norm(ray, axis=1)
        return far - radius_m, ray / far[:, None], strength

    return echo


def tank(centre, radius_m):
    """The nearest place of a round wall, from inside."""

    def echo(at):
        ray = at - np.asarray(centre)
        far = np.linalg.norm(ray, axis=1)
        return radius_m - far, ray / far[:, None], 0.5

    return echo


def slope(bearing_deg, distance_m, elevation_deg):
    """A plane whose normal leaves the plane of flight, at its distance from the origin."""
    unit = np.array([np.cos(np.radians(bearing_deg)), np.sin(np.radians(bearing_deg))]) * np.cos(
        np.radians(elevation_deg)
    )
    return lambda at: (distance_m - at @ unit, np.tile(unit, (len(at), 1)), 0.4)


def pipe(distance_m, above_m, *, strength):
    """A level pipe along x, above the plane of flight."""

    def echo(at):
        across = distance_m - at[:, 1]
        return np.hypot(across, above_m), np.tile([0.0, 1.0], (len(at), 1)), strength

    return echo


def mapped(frames, **spec):
    mapper = LikelihoodMapper(GRID, spec=LikelihoodSpec(**spec))
    mapper.update(frames)
    mapper.finish()
    return mapper


def delayed(part, rows):
    """Frames in another order of rows, at even times."""
    t_ns = np.arange(len(rows)) * 120_000_000
    poses = Trajectory(t_ns, part.poses.position[rows], part.poses.quat_xyzw[rows])
    return Frames(part.samples[rows], part.range_m, t_ns, part.spec, poses, sensor=part.sensor)


def centres(omap):
    row, column = np.nonzero(omap.occupied)
    return np.stack([omap.grid.x_m[column], omap.grid.y_m[row]], axis=1)


def test_the_default_is_likelihood_on_a_plane_and_in_a_volume():
    frames = {name: part[:12] for name, part in flown(curve(), wall(90, 2.4)).items()}
    volume = ul.Grid.covering([[-5, -4, -1], [5, 4, 1]], 0.2, dims=3)
    for grid in (GRID, volume):
        assert ul.map_occupancy(frames, grid).method == "likelihood"


def test_an_empty_world_stays_empty():
    mapper = mapped(flown(curve()))
    omap = mapper.map()
    assert omap.method == "likelihood"
    assert mapper.surfaces() == []
    assert not omap.occupied.any()
    flight, _ = GRID.index(curve().position)
    assert omap.free[tuple(flight.T)].all()
    row, column = np.nonzero(omap.free)
    cells = np.stack([GRID.x_m[column], GRID.y_m[row]], axis=1)
    away = np.linalg.norm(cells[:, None] - curve().position[None, :, :2], axis=2).min(axis=1)
    assert away.max() < 0.5, "only where the body was"


@pytest.mark.parametrize("bearing_deg", [73, 180])
def test_one_wall_is_one_surface_at_its_distance(bearing_deg):
    mapper = mapped(flown(curve(), wall(bearing_deg, 2.6)))
    unit = np.array([np.cos(np.radians(bearing_deg)), np.sin(np.radians(bearing_deg))])
    strongest = max(mapper.surfaces(), key=lambda one: one.log_odds)
    away = strongest.state[0] + strongest.position @ unit
    assert away == pytest.approx(2.6, abs=0.015)
    assert np.cos(strongest.state[1] - np.radians(bearing_deg)) > np.cos(np.radians(1.0))
    assert abs(strongest.state[2]) < 0.1
    occupied = centres(mapper.map())
    assert len(occupied) >= 4
    assert np.abs(occupied @ unit - 2.6).max() < 0.15


@pytest.mark.parametrize(
    ("echo", "centre", "radius_m"),
    [
        (pillar((0.3, 2.4), 0.5), (0.3, 2.4), 0.5),
        (pillar((0.3, -2.6), 0.0), (0.3, -2.6), 0.0),
        (tank((-0.2, -1.6), 3.2), (-0.2, -1.6), 3.2),
    ],
)
def test_round_surfaces_keep_their_centre_and_radius(echo, centre, radius_m):
    mapper = mapped(flown(curve(), echo))
    strongest = max(mapper.surfaces(), key=lambda one: one.log_odds)
    _, bearing, curvature, cosine = strongest.state
    assert cosine == 1.0
    found = strongest.position + np.array([np.cos(bearing), np.sin(bearing)]) / curvature
    assert np.linalg.norm(found - centre) < 0.2
    occupied = centres(mapper.map())
    assert len(occupied)
    assert np.abs(np.linalg.norm(occupied - centre, axis=1) - radius_m).max() < 0.15


def test_what_lies_behind_a_stronger_wall_is_hidden():
    mapper = mapped(flown(curve(), wall(90, 2.0), wall(90, 2.6, strength=0.1)))
    behind = [one for one in mapper.surfaces() if abs(one.state[0] + one.position[1] - 2.6) < 0.05]
    assert behind
    assert not any(one.on_map for one in behind)
    assert centres(mapper.map())[:, 1].max() < 2.2


@pytest.mark.parametrize("elevation_deg", [30, -50])
def test_a_slope_is_one_surface_of_its_elevation_and_no_wall(elevation_deg):
    mapper = mapped(flown(curve(), slope(90, 2.0, elevation_deg)))
    (found,) = mapper.surfaces()
    assert found.kind == "slope"
    cosine = np.cos(np.radians(elevation_deg))
    range_m, bearing, curvature, share = found.state
    assert share == pytest.approx(cosine, abs=0.01)
    assert abs(share - cosine) < 4 * np.sqrt(found.covariance[3, 3])
    assert range_m == pytest.approx(2.0 - cosine * found.position[1], abs=0.015)
    assert abs(bearing - np.pi / 2) < np.radians(1.0)
    assert abs(curvature) < 0.1
    assert not found.on_map
    omap = mapper.map()
    assert not omap.occupied.any()
    beyond, _ = GRID.index(np.array([[0.0, 2.0 / cosine, 0.0]]))
    assert not omap.free[tuple(beyond.T)].any()


def free_beside(omap, y):
    return omap.free[tuple(GRID.index(np.column_stack([0 * y, y, 0 * y]))[0].T)]


def test_an_echo_that_one_radar_hears_on_a_straight_track_shows_no_slope():
    path = Trajectory.line((-1.5, 0, 0), (1.5, 0, 0), speed_m_s=0.5, rate_hz=8)
    omap = mapped(flown(path, slope(90, 1.7, 30), wall(90, 2.5))).map()
    assert not free_beside(omap, np.arange(1.65, 2.5, 0.1)).any(), "it may be a wall at its range"
    assert free_beside(omap, np.arange(0.85, 1.5, 0.1)).all()


def test_the_echo_of_a_wall_frees_nothing_beyond_a_slope_that_may_cut_the_plane():
    omap = mapped(flown(curve(), slope(90, 1.6, 40), wall(90, 2.6))).map()
    cut_m = 1.6 / np.cos(np.radians(40))
    assert not free_beside(omap, np.arange(cut_m + 0.05, 2.6, 0.1)).any()
    assert free_beside(omap, np.arange(0.85, 1.3, 0.1)).all(), "it may bend, but stands nowhere before its range"


@pytest.mark.parametrize("above_m", [0.2, 0.6])
def test_a_pipe_above_the_flight_is_not_occupied_where_a_stronger_wall_shows_behind_it(above_m):
    path = Trajectory.line((-1.0, 0, 0), (1.0, 0.1, 0), 0.5, 8.0)
    range_m = np.hypot(1.6, above_m)
    cells, _ = GRID.index(np.array([[0.0, range_m + 0.05, 0], [0.0, 2.15, 0]]))
    alone = mapped(flown(path, pipe(1.6, above_m, strength=0.1))).map()
    assert alone.occupied[tuple(cells[0])], "alone it may be a wall"
    both = mapped(flown(path, pipe(1.6, above_m, strength=0.1), wall(90, 2.5))).map()
    assert (both.percent[tuple(cells.T)] == UNKNOWN).all(), "what is seen through may be a box, with faint far sides"
    assert np.abs(centres(both)[np.abs(centres(both)[:, 0]) < 0.5, 1] - 2.5).max() < 0.11


def test_one_sensor_on_a_straight_track_takes_no_floor_for_a_wall():
    """All directions across the track have the same ranges. Only a mirror's level separates them."""

    def floor(at):
        return np.full(len(at), 0.9), np.zeros((len(at), 2)), 1.0  # straight down

    path = Trajectory.line((-1.5, 0, 0), (1.5, 0, 0), speed_m_s=0.5, rate_hz=25)
    left = flown(path, wall(90, 2.5), floor)["left"]
    shown = centres(mapped({"left": left}).map())
    assert len(shown) > 20
    np.testing.assert_allclose(shown[:, 1], 2.5, atol=0.15)  # neither at 0.9 m, nor to the other side


def test_what_was_seen_often_is_surer_than_what_was_seen_once():
    omap = mapped(flown(Trajectory.line((-1.5, 0, 0), (1.5, 0.1, 0), 0.5, 20.0), wall(90, 2.0), wall(0, 3.0))).map()
    row = omap.percent[abs(GRID.y_m - 2.0) < 0.16].max(axis=0)
    seen = np.flatnonzero((row >= 50) & (abs(GRID.x_m) < 2.5))
    middle, ends = row[seen[len(seen) // 2]], row[seen[[0, -1]]]
    assert ends.max() <= middle - 3
    assert middle > 85
    assert 0 <= omap.percent[omap.free].max() <= 1
    assert (
        mapped(envelopes(flown(curve(), wall(90, 2.0)))).map().percent[GRID.index(np.zeros((1, 3)))[0][0][0]].min() < 2
    )


@pytest.mark.slow
@pytest.mark.parametrize("kind", ["polygon", "pillars"])
def test_percents_come_true_in_worlds_that_they_were_not_fitted_to(kind):
    scene, path = ul.worlds.random(kind, 3), ul.worlds.flight(kind, 3)
    path = path[: int(14 / np.linalg.norm(path.position[1] - path.position[0]))]
    frames = ul.simulate(scene, path, ul.worlds.rig(kind, 3), max_bounces=1, seed=3)
    omap = ul.map_occupancy(frames, GRID.covering(scene.bounds, 0.1, margin_m=0.5))
    rows = ul.metrics.reliability(omap, scene, frames)
    assert rows[0].high == 1
    assert rows[0].held < 0.005, "of the cells that are free with 99 %"
    solid = [row for row in rows if row.low >= 65]
    said, held = (
        np.average([getattr(row, name) for row in solid], weights=[row.cells for row in solid])
        for name in ("said", "held")
    )
    assert abs(said - held) < 0.12


@pytest.mark.parametrize(("ripple", "least_m", "most_m"), [(0.0, 0.4, 0.7), (0.3, 0.1, 0.35)])
def test_a_wall_of_steady_level_goes_on_beyond_its_last_specular_point(ripple, least_m, most_m):
    """An edge nearby would let the level ripple, so a level that ripples shows one Fresnel zone only."""
    path = Trajectory.line((-1.0, 0, 0), (1.0, 0, 0), 0.5, 8.0)

    def seen(at):
        return 2.5 - at[:, 1], np.tile([0.0, 1.0], (len(at), 1)), 0.5 * (1 + ripple * np.sin(6 * at[:, 0]))

    shown = centres(mapped(flown(path, seen)).map())
    beyond_m = np.abs(shown[np.abs(shown[:, 1] - 2.5) < 0.1, 0]).max() - 1.0
    assert least_m < beyond_m < most_m  # the first Fresnel zone has a radius of 0.23 m, the largest that counts 0.65 m


def test_echoes_of_a_slope_free_nothing_as_they_leave_the_plane():
    omap = mapped(flown(curve(), slope(90, 1.6, 40)), silence=1e6).map()  # by echoes alone
    assert not ((omap.percent > 0) & (omap.percent < 50)).any()


def test_an_echo_that_something_weakens_frees_nothing():
    path = Trajectory.line((-2, 0, 0), (2, 0.2, 0), 0.5, 8.0)

    def screened(at):
        return 2.5 - at[:, 1], np.tile([0.0, 1.0], (len(at), 1)), np.where(np.abs(at[:, 0]) < 0.7, 0.15, 0.5)

    omap = mapped(flown(path, screened), silence=1e6).map()  # by echoes alone
    cells, _ = GRID.index(np.array([[-1.4, 1.4, 0], [1.4, 1.4, 0], [0.0, 1.4, 0]]))
    assert omap.free[tuple(cells.T)].tolist() == [True, True, False]


def test_a_cell_is_free_only_where_echoes_came_through_all_of_it():
    """The tubes of the wall's echoes graze the cells beside its track; cells half within are not free."""
    path = Trajectory.line((-1.02, 0, 0), (1.02, 0, 0), 0.5, 8.0)
    omap = mapped(flown(path, wall(90, 2.5)), silence=1e6).map()  # by echoes alone
    free = omap.free[GRID.index(np.array([[0.0, 1.45, 0.0]]))[0][0, 0]]
    x = GRID.x_m[free]
    assert x.min() > -1.1
    assert x.max() < 1.1
    assert len(x) >= 18


def around(centre=(0.0, 0.0), radius_m=1.2):
    """A round trip."""
    angle = np.linspace(0, 2 * np.pi, 130)
    xy = np.asarray(centre) + radius_m * np.stack([np.cos(angle), np.sin(angle)], axis=1)
    quat = np.tile([0, 0, 0, 1.0], (len(xy), 1))
    return Trajectory(np.arange(len(xy)) * 120_000_000, np.column_stack([xy, 0 * angle]), quat)


@pytest.mark.parametrize(("height_m", "shown"), [(0.0, False), (-0.2, False), (-2.0, True)])
def test_a_flight_removes_what_it_flies_through_at_its_height_only(height_m, shown):
    """Below a pipe that ends in the plane of the map a vehicle may land."""
    before = flown(around(), pillar((0.0, 0.0), 0.1))
    line = Trajectory.line((-1.2, 0, height_m), (1.2, 0, height_m), speed_m_s=0.5, rate_hz=8)
    mapper = LikelihoodMapper(GRID)
    mapper.update(before)
    mapper.update(flown(replace(line, t_ns=line.t_ns + before["left"].t_ns[-1] + 10**9)))
    mapper.finish()
    assert (np.linalg.norm(centres(mapper.map()), axis=1) < 0.25).any() == shown


def test_silence_frees_what_surfaces_cannot_reach_without_an_echo():
    """No echo came through the middle of a round trip below a wall, on which only the wall is received.

    Outside, a surface is seen square or ends, and its end would be received. Behind the wall nothing is known.
    """
    omap = mapped(flown(around(), wall(90, 3.0))).map()
    places = np.array([[0.0, 0.0], [0.05, -0.35], [0.45, -1.65], [0.0, -3.6], [0.0, 3.4], [2.0, 3.4]])
    cells, _ = GRID.index(np.column_stack([places, 0 * places[:, 0]]))
    assert omap.free[tuple(cells.T)].tolist() == [True, True, True, True, False, False]


def test_silence_frees_no_round_wall_that_was_not_seen_square():
    """Most of a tank is as far away as what is seen, but its normals miss the track."""
    centre = np.array([-0.2, -1.6])
    omap = mapped(flown(curve(), tank(centre, 3.2))).map()
    angle = np.arange(0, 2 * np.pi, 0.01)
    points = centre + 3.2 * np.stack([np.cos(angle), np.sin(angle)], axis=1)
    cells, inside = GRID.index(np.column_stack([points, 0 * angle]))
    assert not omap.free[tuple(cells[inside].T)].any()
    assert omap.free.sum() > 1500


def test_an_echo_is_no_silence_where_its_surface_is_not_sure():
    """One sensor on a straight track leaves open from which side the weak pillar echoes. The wall's echo passes it."""
    path = Trajectory.line((-1.5, 0, 0), (1.5, 0, 0), speed_m_s=0.5, rate_hz=25)
    left = flown(path, wall(90, 2.5), pillar((0.0, 1.3), 0.02, strength=0.03))["left"]
    mapper = mapped({"left": left})
    assert not any(abs(one.points[:, 1] - 1.3).min() < 0.1 for one in mapper.surfaces()), "no surface is sure there"
    cells, _ = GRID.index(np.array([[0.0, 1.3, 0], [1.0, 1.3, 0]]))
    assert mapper.map().free[tuple(cells.T)].tolist() == [False, True]


def test_space_behind_a_surface_is_not_freed_by_echoes_past_it():
    """The weaker echoes of the wall pass the pillar on both sides; no ray of their tubes goes on behind it."""
    path = Trajectory.line((-1.0, -1.5, 0), (1.0, -1.4, 0), 0.5, 8.0)
    omap = mapped(flown(path, pillar((0.0, 0.5), 0.15, strength=0.6), wall(90, 3.0)), tube=1.5).map()
    cells, _ = GRID.index(np.array([[0.0, 0.36, 0], [0.0, 0.75, 0], [-0.8, 0.75, 0], [0.8, 0.75, 0]]))
    assert omap.occupied[tuple(cells[:1].T)].all()
    assert omap.free[tuple(cells[1:].T)].tolist() == [False, True, True]


def test_a_wall_that_folds_back_is_one_wall():
    """Flying towards it, its echo folds to a short range first, and is seen directly later."""
    fold_m = RIG["front"].unambiguous_range_m
    path = Trajectory.line((-4.2, 0.2, 0), (4.2, 0.4, 0), 0.5, 8.0)
    frames = flown(path, wall(0, 4.9 + 2.5), wall(0, 4.9 + 2.5, folded_m=fold_m))
    mapper = LikelihoodMapper(ul.Grid.covering([[-5, -2, 0], [9, 2, 0]], 0.1, z_m=0.0))
    mapper.update({name: part[: len(part)] for name, part in frames.items()})
    mapper.finish()
    occupied = centres(mapper.map())
    assert len(occupied)
    assert np.abs(occupied[:, 0] - 7.4).max() < 0.15


def test_a_folded_echo_shows_its_wall_and_frees_its_whole_path():
    """One leg sees the wall directly, the other one beyond the unambiguous range."""
    fold_m = RIG["front"].unambiguous_range_m
    x = np.linspace(-2.5, 2.5, 80)
    legs = np.concatenate([np.stack([x, 0 * x - 1.0], 1), np.stack([-x, 0 * x - 4.0], 1)])
    path = Trajectory(
        np.arange(160) * 120_000_000, np.column_stack([legs, np.zeros(160)]), np.tile([0, 0, 0, 1.0], (160, 1))
    )
    near, far = flown(path[:80], wall(90, 7.0)), flown(path[80:], wall(90, 7.0, folded_m=fold_m))
    mapper = LikelihoodMapper(ul.Grid.covering([[-4, -5, 0], [4, 8, 0]], 0.1, z_m=0.0))
    for part in (near, far):
        mapper.update(part)
    mapper.finish()
    omap = mapper.map()
    occupied = centres(omap)
    assert len(occupied)
    assert np.abs(occupied[:, 1] - 7.0).max() < 0.15
    between, _ = omap.grid.index(np.array([[x, -2.5, 0.0] for x in (-1.5, -0.5, 0.5, 1.5)]))
    assert omap.free[tuple(between.T)].all(), "only the folded echoes passed here"


def test_standing_still_adds_nothing():
    """However long it hovers in the middle, sways by 2 mm and receives new noise."""
    frames, rng = flown(curve(), wall(40, 2.5)), np.random.default_rng(5)
    count = len(frames["front"])
    again = np.repeat(np.arange(count), np.where(np.arange(count) == count // 2, 200, 1))
    hovers = np.r_[False, again[1:] == again[:-1]]
    sway = np.where(hovers[:, None], rng.normal(0, 0.002, (len(again), 3)), 0.0)
    longer = {name: delayed(part, again) for name, part in frames.items()}
    for name, part in longer.items():
        noise = 5e-6 * (rng.normal(size=(*part.samples.shape, 2)) @ [1, 1j]) * hovers[:, None]
        poses = Trajectory(part.t_ns, part.poses.position + sway, part.poses.quat_xyzw)
        longer[name] = replace(part, samples=part.samples + noise, poses=poses)
    assert np.array_equal(mapped(frames).map().percent, mapped(longer).map().percent)


def test_a_hover_that_sways_is_mapped_while_it_lasts():
    """Its apertures do not wait for the vehicle to leave."""
    rng, sway = np.random.default_rng(0), np.zeros((600, 3))
    for k in range(1, 600):  # within 0.15 m, with a time constant of 2 s at 10 Hz
        sway[k] = 0.95 * sway[k - 1] + 0.31 * rng.normal(0, (0.04, 0.04, 0.01))
    assert np.linalg.norm(sway, axis=1).max() < LikelihoodSpec().window_m
    path = Trajectory(np.arange(600) * 100_000_000, sway, np.tile([0, 0, 0, 1.0], (600, 1)))
    mapper = Mapper(GRID, method="likelihood")
    mapper.update(flown(path, wall(40, 2.5)))
    place, unit = centres(mapper.map()), np.array([np.cos(np.radians(40)), np.sin(np.radians(40))])
    assert len(place) >= 3
    assert np.all(np.abs(place @ unit - 2.5) < 0.15)


def test_pieces_of_any_size_give_the_map_of_the_whole():
    """And what is said to have changed adds up to it."""
    frames = flown(curve(turns=0.25), wall(90, 2.4), pillar((1.4, -1.8), 0.2))
    whole = mapped(frames).map()
    assert whole.occupied.any()
    for size in (1, 7):
        mapper, patched = Mapper(GRID, method="likelihood"), np.full(GRID.shape, -1, np.int8)
        for start in range(0, len(frames["front"]), size):
            pieces = {name: part[start : start + size] for name, part in frames.items()}
            for piece in [pieces] if size > 1 else pieces.values():
                mapper.update(piece)
            if size > 1:
                for (row, column), values in mapper.changed():
                    patched[row : row + len(values), column : column + values.shape[1]] = values
                np.testing.assert_array_equal(patched, mapper.map().percent)
        mapper.finish()
        assert np.array_equal(mapper.map().percent, whole.percent)
        mapper.changed()
        assert not mapper.changed(), "nothing new"


def test_a_map_in_flight_holds_all_that_the_frames_so_far_show():
    """Work waits for the frames that follow, but a map does not wait for it."""
    frames = flown(curve(), wall(90, 2.4), pillar((1.4, -1.8), 0.2))
    for count in (17, 18):
        mapper = Mapper(GRID, method="likelihood")
        for k in range(count):
            mapper.update({name: part[k : k + 1] for name, part in frames.items()})
        whole = Mapper(GRID, method="likelihood")
        whole.update({name: part[:count] for name, part in frames.items()})
        assert np.array_equal(mapper.map().percent, whole.map().percent)


def test_laps_over_the_same_places_add_neither_evidence_nor_surfaces():
    """A longer flight through the same places costs as much a frame, and noise does not add up to a surface."""
    path = curve()
    count = len(path)
    reflectors = wall(90, 2.4), wall(-40, 3.0), pillar((1.4, -1.8), 0.2)
    mapper, seen, odds = LikelihoodMapper(GRID), [], []
    for lap in range(8):
        rows = np.arange(count)[:: (-1) ** lap]
        t_ns = (np.arange(count) + lap * count) * 120_000_000
        mapper.update(flown(Trajectory(t_ns, path.position[rows], path.quat_xyzw[rows]), *reflectors, seed=lap))
        if lap in (1, 6, 7):
            surfaces = mapper.surfaces()
            seen.append(sum(one.seen for one in surfaces))
            odds.append(max(one.log_odds for one in surfaces))
    assert seen[2] < 1.5 * seen[0]
    assert odds[2] < 1.02 * odds[1]  # all places count in full by then


@pytest.mark.parametrize("together", [1.0, 0.4, 0.0])
def test_directions_are_summed_as_the_definition_says(together):
    rng = np.random.default_rng(5)
    rows, bins = 24, 60
    samples = rng.normal(size=(rows, bins, 2)).astype(np.float32)
    offset, sensor = rng.normal(size=(rows, 3)) * 4, np.repeat(np.arange(3), 8)
    gains = np.linspace(1.0, 0.2, 2001) * np.array([[1.0], [0.8], [0.6]])
    axes, phase, moment = np.eye(3), 1.7, np.tile(np.arange(8), 3)
    aperture = Aperture(
        samples, offset, sensor, axes, gains, phase, moment, np.zeros((3, 3)), np.array([together]), np.zeros(len(axes))
    )
    directions = rng.normal(size=(70, 3))
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    sums = DirectionSums(directions)
    sums.begin(aperture)
    sums.sum(5, bins - 5)
    sums.sum(bins, 5)  # no bin
    energy = np.zeros((len(directions), bins))
    signal = samples[..., 0] + 1j * samples[..., 1]
    for d, unit in enumerate(directions):
        gain = gains_of(aperture, unit)
        gain = (gain / gain.max())[sensor]
        delay = -offset @ unit
        for k in range(5, bins - 5):
            at = k + delay
            whole = (np.floor(at) >= 0) & (np.floor(at) < bins - 1)
            value = [np.interp(x, np.arange(bins), row) for x, row in zip(at, signal, strict=True)]
            z = np.where(whole, gain * np.array(value) * np.exp(1j * phase * delay), 0).reshape(3, 8).sum(axis=1)
            explained = together * abs(z.sum()) ** 2 + (1 - together) * np.abs(z).sum() ** 2
            energy[d, k] = explained / np.sum(gain**2)
    best, d, k = sums.strongest(1.0, 5, bins - 5)
    assert (d, k) == np.unravel_index(np.argmax(energy), energy.shape)
    assert best == pytest.approx(energy.max(), rel=1e-4)
    low = sums.strongest(np.where(np.arange(bins) == k, 1e6, 1.0), 5, bins - 5)
    energy[:, k] = 0
    assert low[1:] == np.unravel_index(np.argmax(energy), energy.shape)


@pytest.mark.parametrize("turn", [0.0, 2 * np.pi / 3])
def test_radars_whose_phases_disagree_are_summed_by_size(turn):
    """Mounts that are off by more than a few millimetres turn the phases of their radars against each other."""
    frames = flown(curve(), wall(40, 2.4), wall(-130, 3.0))
    frames = {
        name: replace(part, samples=part.samples * np.exp(1j * turn * k))
        for k, (name, part) in enumerate(frames.items())
    }
    mapper = mapped(frames)
    assert mapper.mount_coherence < 0.1 if turn else mapper.mount_coherence > 0.9
    strongest = max(mapper.surfaces(), key=lambda one: one.log_odds)
    unit = np.array([np.cos(np.radians(40)), np.sin(np.radians(40))])
    assert np.cos(strongest.state[1] - np.radians(40)) > np.cos(np.radians(4.0))
    assert strongest.state[0] + strongest.position @ unit == pytest.approx(2.4, abs=0.03)


def test_without_echoes_the_stated_accuracy_of_the_mounts_counts():
    for sigma_m, coherence in ((0.0, 1.0), (0.001, 0.91), (0.01, 0.0)):
        spec = RIG["front"].but(mount=RIG["front"].mount.but(position_sigma_m=sigma_m))
        assert mapped(flown(curve(), spec=spec)).mount_coherence == pytest.approx(coherence, abs=0.01)


def envelopes(frames):
    return {name: replace(part, samples=part.amplitude) for name, part in frames.items()}


@pytest.mark.parametrize("bearing_deg", [40, 180])
def test_amplitudes_without_phase_show_a_wall(bearing_deg):
    frames = envelopes(flown(curve(spacing=0.03), wall(bearing_deg, 2.4)))
    mapper = mapped(frames)
    unit = np.array([np.cos(np.radians(bearing_deg)), np.sin(np.radians(bearing_deg))])
    strongest = max(mapper.surfaces(), key=lambda one: one.log_odds)
    assert np.cos(strongest.state[1] - np.radians(bearing_deg)) > np.cos(np.radians(4.0))
    assert strongest.state[0] + strongest.position @ unit == pytest.approx(2.4, abs=0.03)
    occupied = centres(mapper.map())
    assert len(occupied) >= 4
    assert np.abs(occupied @ unit - 2.4).max() < 0.15
    again = LikelihoodMapper(GRID)
    for start in range(0, len(frames["front"]), 3):
        again.update({name: part[start : start + 3] for name, part in frames.items()})
    again.finish()
    assert np.array_equal(again.map().percent, mapper.map().percent)


def test_phases_of_amplitudes_are_never_used():
    """Phases that are lost from frame to frame and from sensor to sensor change nothing once they are dropped."""
    frames = flown(curve(), wall(40, 2.4))
    turned = {n: replace(f, samples=f.samples * np.exp(1j * np.arange(len(f)))[:, None]) for n, f in frames.items()}
    assert np.abs(mapped(envelopes(frames)).map().percent - mapped(envelopes(turned)).map().percent).max() == 0


def test_the_own_echo_in_amplitudes_shows_no_wall():
    """Without phase it cannot be subtracted, and its end must not ring into the ranges beyond it."""
    frames = envelopes(flown(curve(spacing=0.03)))
    for name, part in frames.items():
        near = part.range_m < part.spec.own_echo_m
        assert near.any()
        frames[name] = replace(part, samples=part.samples + np.float32(0.5) * near)
    assert mapped(frames).surfaces() == []


def test_places_that_a_hover_comes_back_to_add_nothing():
    """A hover goes round a circle of 2 cm: from the second round on, it looks from places that it has looked from."""
    way = curve(spacing=0.03)
    circle = np.linspace(0, 2 * np.pi, 24, endpoint=False)[:, None]
    once = way.position[-1] + 0.02 * np.concatenate([np.cos(circle) - 1, np.sin(circle), 0 * circle], axis=1)

    position = np.concatenate([way.position, *[once] * 20])
    t_ns = np.arange(len(position)) * 40_000_000
    frames = flown(Trajectory(t_ns, position, np.tile([0, 0, 0, 1.0], (len(position), 1))), wall(90, 2.4))
    first = len(way) + len(once)
    short, long = mapped({name: part[:first] for name, part in frames.items()}), mapped(frames)
    assert len(short.surfaces()) == len(long.surfaces()) >= 1
    for one, other in zip(short.surfaces(), long.surfaces(), strict=True):
        assert (one.log_odds, one.seen) == (other.log_odds, other.seen)
    assert np.array_equal(short.map().percent, long.map().percent)


def test_amplitudes_of_noise_show_nothing():
    mapper = mapped(envelopes(flown(curve(spacing=0.03))))
    assert mapper.surfaces() == []
    assert not mapper.map().occupied.any()


def test_amplitudes_of_the_ray_model_show_walls():
    path = Trajectory.line((-2.5, -1.0, 0), (2.5, -1.0, 0), 1.0, 20)
    scene = ul.scenes.room(size_m=(8, 6, 3), material="concrete")
    frames = ul.simulate(scene, path, ul.Rig.preset("thesis-4"), seed=7, fidelity="thesis")
    omap = ul.map_occupancy(frames, ul.Grid.covering(scene.bounds, 0.1, margin_m=0.5), method="likelihood")
    occupied = centres(omap)
    apart = np.minimum(np.abs(np.abs(occupied[:, 0]) - 4), np.abs(np.abs(occupied[:, 1]) - 3))
    assert len(occupied) > 10
    assert np.median(apart) < 0.3


def test_the_ball_of_the_vehicle_is_free():
    for radius in (0.25, 0.6):
        mapper = LikelihoodMapper(GRID, vehicle_radius_m=radius)
        mapper.update(flown(curve()))
        mapper.finish()
        y, x = np.nonzero(mapper.map().free)
        away = np.hypot(GRID.x_m[x][:, None] - curve().position[:, 0], GRID.y_m[y][:, None] - curve().position[:, 1])
        assert away.min(axis=1).max() == pytest.approx(radius, abs=0.16)


@pytest.mark.parametrize("sigma_m", [0.0, 0.002])
def test_white_errors_of_the_poses_are_estimated(sigma_m):
    frames = flown(curve(spacing=0.03), wall(90, 2.4), wall(-20, 3.1), pillar((-1.4, -1.8), 0.2))
    mapper = mapped(world.shaken(frames, sigma_m))
    assert mapper.pose_sigma_m == pytest.approx(sigma_m, rel=0.4, abs=2e-4)


def test_the_search_takes_amplitudes_where_the_poses_leave_no_phase():
    """At errors of a quarter wavelength phases are random, and only the pulse and the antennas show the bearing."""
    frames = flown(curve(spacing=0.04, turns=0.25), wall(40, 2.4))
    mapper = mapped(world.shaken(frames, 0.01))
    assert mapper.pose_sigma_m > 0.006
    strongest = max(mapper.surfaces(), key=lambda one: one.log_odds)
    unit = np.array([np.cos(np.radians(40)), np.sin(np.radians(40))])
    assert np.cos(strongest.state[1] - np.radians(40)) > np.cos(np.radians(4.0))
    assert strongest.state[0] + strongest.position @ unit == pytest.approx(2.4, abs=0.03)
    occupied = centres(mapper.map())
    assert len(occupied) >= 4
    assert np.mean(np.abs(occupied @ unit - 2.4) < 0.15) > 0.7


def twelve_moments():
    """An aperture of four sensors that see one echo from twelve places, and the moment (48) of each row."""
    moment = np.repeat(np.arange(12), 4)
    samples = np.zeros((48, 40, 2), np.float32)
    samples[:, 18:22, 0] = 1.0
    sensor, gains = np.arange(48) % 4, np.ones((4, 2001))
    spread, together = np.zeros((3, 3)), np.ones(1)
    return Aperture(
        samples, np.zeros((48, 3)), sensor, np.eye(4, 3), gains, 3.0, moment, spread, together, np.zeros(4)
    ), moment


def test_echoes_correct_the_positions_along_their_direction():
    aperture, moment = twelve_moments()
    error = np.random.default_rng(3).normal(size=(12, 3)) * 0.2
    aperture.offset[:] = error[moment]
    poses = AperturePoses(aperture)
    poses.expect(0.2)
    x, y = np.eye(3)[:2]
    before = poses.variance(y)
    poses.correct(x, poses.phases(x, np.ones(4), 0.0, 20.0))
    assert np.std(aperture.offset[:, 0]) < 0.1 * np.std(error[:, 0])
    assert np.array_equal(aperture.offset[:, 1:], error[moment, 1:])
    assert poses.variance(x) < 0.05 * before
    assert poses.variance(y) == before


def test_large_errors_correct_nothing():
    """A phase does not say how many half wavelengths a position is off."""
    aperture, moment = twelve_moments()
    aperture.offset[:, 0] = np.linspace(-0.5, 0.5, 12)[moment]
    given = aperture.offset.copy()
    poses = AperturePoses(aperture)
    poses.expect(3.0)
    x = np.array([1.0, 0, 0])
    poses.correct(x, poses.phases(x, np.ones(4), 0.0, 20.0))
    assert np.abs(aperture.offset - given).max() < 0.05
    assert poses.variance(x) > 0.9 * 81


def test_bad_input_is_refused_in_one_line():
    frames = flown(curve(), wall(90, 2.0))
    with pytest.raises(ul.InputError, match="maps a plane"):
        LikelihoodMapper(ul.Grid.covering([[-5, -4, -1], [5, 4, 1]], 0.2, dims=3))
    for name, has in (("left", "have no phase"), ("front", "have phase")):
        mixed = frames | {name: replace(frames[name], samples=frames[name].amplitude)}
        with pytest.raises(ul.InputError, match=rf"left: its samples {has}, .*allowed: .*amplitudes of all"):
            mapped(mixed)
    for name, value in (("floor_z_m", np.nan), ("vehicle_radius_m", 0.0), ("vehicle_radius_m", 11.0)):
        with pytest.raises(ul.InputError, match=name):
            Mapper(GRID, method="likelihood", **{name: value})
    other = flown(curve(), wall(90, 2.0), spec=RIG["front"].but(center_hz=8e9))
    with pytest.raises(ul.InputError, match="its carrier differs"):
        mapped({"front": frames["front"], "left": other["left"]})
    for name, value in (("window_m", 0.0), ("gate", np.nan), ("evidence", "much")):
        with pytest.raises(ul.InputError, match=rf"{name} is .*allowed: a number above 0"):
            LikelihoodSpec(**{name: value})


def test_a_map_holds_its_surfaces_with_kind_and_extent():
    frames = flown(curve(), wall(180, 2.6), pillar((0.3, 2.6), 0.0, strength=0.5), pillar((1.8, -2.9), 0.6))
    omap = ul.map_occupancy(frames, GRID, method="likelihood")
    flat = next(one for one in omap.surfaces if one.kind == "plane" and one.on_map)
    assert np.abs(flat.points[:, 0] + 2.6).max() < 0.05
    assert np.abs(flat.normals - [1.0, 0.0]).max() < 0.05
    assert len(flat.points) == flat.seen
    pole = next(one for one in omap.surfaces if one.kind == "edge")
    assert np.linalg.norm(pole.points - [0.3, 2.6], axis=1).max() < 0.15
    assert any(one.kind == "cylinder" for one in omap.surfaces)


def wall_cells(distance_m, half_m=1.0):
    """Cells of a wall ahead, at this distance along x."""
    points = np.array([[distance_m + 0.02, y, 0.0] for y in np.arange(-half_m, half_m, 0.05)])
    return tuple(GRID.index(points)[0].T)


def test_silence_vouches_for_no_wall_in_a_direction_in_which_no_radar_looks():
    """The wall ahead echoes 70 dB below a mirror, as if the radars that look there were gone."""
    frames = flown(curve(), wall(90, 2.5), wall(0, 3.0, strength=1e-3))
    sides = mapped({name: frames[name] for name in ("left", "right")}).map()
    assert not sides.free[wall_cells(3.0)].any()
    assert not sides.free[wall_cells(1.5, 0.3)].any()
    assert mapped(frames).map().free[wall_cells(1.5, 0.3)].all(), "the radars ahead hear that far"


def test_echoes_within_the_own_echo_count_and_silence_there_does_not():
    frames = flown(curve(), wall(90, 2.0))
    stated = {name: replace(part, spec=part.spec.but(own_echo_m=2.5)) for name, part in frames.items()}
    plain, blind = mapped(frames).map(), mapped(stated).map()
    np.testing.assert_array_equal(blind.occupied, plain.occupied)
    assert blind.occupied.any()
    assert not (blind.free & ~plain.free).any()
    assert blind.free.sum() < 0.7 * plain.free.sum()


@pytest.mark.parametrize("spacing_m", [0.05, 0.085])
def test_one_radar_maps_with_few_frames_or_says_why_not(spacing_m):
    left = flown(Trajectory.line((-2, 0, 0), (2, 0.2, 0), 0.5, 0.5 / spacing_m), wall(90, 2.0))["left"]
    omap = mapped({"left": left}).map()
    assert omap.occupied.sum() > 20
    with pytest.warns(ul.errors.UllageWarning, match="most places have fewer than 4 frames within 0.44 m"):
        assert not mapped({"left": left[::5]}).map().occupied.any()


def test_another_radar_leads_where_the_frames_of_the_first_one_end():
    frames = flown(curve(), wall(90, 2.0))
    first = next(iter(frames))
    ended = mapped(frames | {first: frames[first][:20]}).map()
    without = mapped({name: part for name, part in frames.items() if name != first}).map()
    assert ended.occupied.sum() > 0.8 * without.occupied.sum()


@pytest.mark.parametrize("pauses", [1, 3])
def test_a_flight_that_hovers_while_all_radars_pause_goes_on(pauses: int) -> None:
    times = np.concatenate([k * 3.0 + 0.05 * np.arange(20) for k in range(pauses + 1)])
    x = np.concatenate([[0.0], 0.05 * (1 + np.arange(len(times) - 1) % 2)])  # it sways, less than a keyframe's step
    path = ul.Trajectory(np.round(times * 1e9).astype(np.int64), np.stack([x, 0 * x, 0 * x], 1),
                         np.tile([0.0, 0, 0, 1], (len(x), 1)))  # fmt: skip
    frames = ul.simulate(ul.scenes.room(size_m=(6, 4, 3)), path, ul.Rig.preset("thesis-4"), fidelity="thesis")
    assert mapped(frames).map().free.any()


@given(
    values=st.lists(st.tuples(st.integers(0, 4), st.floats(0, 1)), min_size=1, max_size=40), percent=st.floats(1, 99)
)
def test_percentiles_of_groups_are_those_of_numpy(values: list[tuple[int, float]], percent: float) -> None:
    _, group = np.unique([name for name, _ in values], return_inverse=True)
    levels = np.array([level for _, level in values])
    one_by_one = [np.percentile(levels[group == name], percent) for name in range(group.max() + 1)]
    assert _percentiles(levels, group, percent).tolist() == one_by_one


def test_a_sighting_that_its_surface_does_not_predict_keeps_the_doubt_of_its_time():
    tracker = mapped(flown(curve(), wall(90, 2.0)))._tracker
    surface = max(tracker.confirmed(), key=lambda one: len(one.sightings))
    key, *_ = surface.sightings
    then = replace(surface.sightings[key], state=(3.5, 1.0, 0.0, 1.0), bearing_sigma=0.3)
    surface.sightings[key] = then
    state, (_, bearing_sigma) = smoothed(surface)
    assert bearing_sigma[0] == 0.3
    assert (bearing_sigma[1:] == np.sqrt(surface.covariance[1, 1])).all()
    assert state[0].tolist() == list(then.state)
