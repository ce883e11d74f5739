"""The likelihood mapper of volumes: laws first, on echoes whose ranges are known in closed form."""

from dataclasses import replace

import mirror_world as world
import numpy as np
import pytest

import ullage as ul
from ullage.data import Trajectory
from ullage.kernels.volume_cells import Box, SpatialViews, find_hidden
from ullage.processing.likelihood.spec import LikelihoodSpec
from ullage.processing.occupancy import Mapper
from ullage.world import shapes
from ullage.world.scene import Scene

LOW, HIGH = np.array([-2.0, -1.7, 0.0]), np.array([2.2, 1.9, 2.6])  # of the room
GRID = ul.Grid.covering([LOW, HIGH], 0.1, dims=3, margin_m=0.5)


def climbing(count=90, *, climb_m=0.9):
    """A round of 7 m that rises and sinks."""
    turn = np.linspace(0, 2 * np.pi, count)
    place = np.stack([1.1 * np.cos(turn), 0.9 * np.sin(turn), 1.2 + climb_m / 2 * np.sin(1.5 * turn)], axis=1)
    return Trajectory(np.arange(count) * 120_000_000, place, np.tile([0, 0, 0, 1.0], (count, 1)))


def crossing(count=70):
    """A winding flight across the room, which rises and sinks."""
    s = np.linspace(-1, 1, count)
    place = np.stack([1.5 * s, 0.7 * np.sin(2.5 * s), 1.2 + 0.4 * np.cos(3 * s)], axis=1)
    return Trajectory(np.arange(count) * 120_000_000, place, np.tile([0, 0, 0, 1.0], (count, 1)))


def flown(path, *reflectors, seed=0):
    return world.reflected(path, reflectors, axes=3, seed=seed)


def plane(unit, distance_m, *, strength=0.5):
    unit = np.asarray(unit, float) / np.linalg.norm(unit)
    return lambda at: (distance_m - at @ unit, np.tile(unit, (len(at), 1)), strength)


def tank(centre, radius_m):
    """The nearest place of an upright round wall, from inside."""

    def echo(at):
        ray = (at - np.asarray(centre)) * [1, 1, 0]
        far = np.linalg.norm(ray, axis=1)
        return radius_m - far, ray / far[:, None], 0.5

    return echo


def box_room():
    return [plane(sign * np.eye(3)[k], sign * side[k]) for k in range(3) for sign, side in ((1, HIGH), (-1, LOW))]


def mapped(frames):
    mapper = Mapper(GRID, method="likelihood")
    mapper.update(frames)
    mapper.finish()
    return mapper


def centres(mask):
    i, j, k = np.nonzero(mask)
    return np.stack([GRID.x_m[k], GRID.y_m[j], GRID.z_m[i]], axis=1)


def away_from_room(points):
    """Distance (n) of points to the nearest face of the room."""
    return np.abs(np.concatenate([points - LOW, points - HIGH], axis=1)).min(axis=1)


@pytest.fixture(scope="module")
def room():
    frames = flown(climbing(), *box_room())
    return frames, mapped(frames).map()


def test_all_six_faces_of_a_room_are_found_by_a_climbing_flight(room):
    occupied = centres(room[1].occupied)
    assert np.mean(away_from_room(occupied) < 0.15) > 0.98
    for axis in range(3):
        for side in (LOW, HIGH):
            assert (np.abs(occupied[:, axis] - side[axis]) < 0.1).sum() > 50, (axis, side)


def test_the_room_is_free_and_nothing_beyond_it(room):
    free = centres(room[1].free)
    assert np.all((free > LOW + 0.05) & (free < HIGH - 0.05))
    inside = (GRID.z_m[:, None, None] > 0.75) & (GRID.z_m[:, None, None] < 1.65)  # the heights of the flight
    inside = inside & (np.abs(GRID.y_m)[:, None] < 1.0) & (np.abs(GRID.x_m) < 1.2)
    assert room[1].free[inside].mean() > 0.9


def test_echoes_that_the_search_leaves_out_are_no_silence(room):
    """With one echo a keyframe, the other walls are heard all the same."""
    mapper = Mapper(GRID, method="likelihood", spec=LikelihoodSpec(most_echoes=1))
    mapper.update(room[0])
    mapper.finish()
    free = centres(mapper.map().free)
    assert np.all((free > LOW + 0.1) & (free < HIGH - 0.1))


def test_a_slanting_ceiling_keeps_its_normal():
    unit = np.array([0.3, -0.2, 0.93]) / np.linalg.norm([0.3, -0.2, 0.93])
    mapper = mapped(flown(climbing(), plane(unit, 2.3)))
    occupied = centres(mapper.map().occupied)
    assert len(occupied) > 100
    assert np.mean(np.abs(occupied @ unit - 2.3) < 0.15) > 0.8


def test_a_round_wall_keeps_its_axis_and_radius():
    centre, radius_m = np.array([0.4, -0.3, 0.0]), 2.4
    grid = ul.Grid.covering([[-3, -3, 0], [3, 3, 2.6]], 0.1, dims=3)
    mapper = Mapper(grid, method="likelihood")
    mapper.update(flown(crossing(), tank(centre, radius_m)))
    mapper.finish()
    _, j, k = np.nonzero(mapper.map().occupied)
    away = np.hypot(grid.x_m[k] - centre[0], grid.y_m[j] - centre[1]) - radius_m
    assert len(away) > 300
    assert np.mean(np.abs(away) < 0.15) > 0.97


def beside(count=80):
    """A winding flight that stays on one side of a column at the origin."""
    s = np.linspace(-1, 1, count)
    place = np.stack([-2.4 + 0.2 * np.cos(3 * s), 1.3 * s, 1.2 + 0.4 * np.cos(3 * s)], axis=1)
    return Trajectory(np.arange(count) * 120_000_000, place, np.tile([0, 0, 0, 1.0], (count, 1)))


def upright(side, radius_m, strength):
    """A round body about the origin, seen from outside (-1), or the wall of a tank seen across its middle (1)."""

    def echo(at):
        far = np.linalg.norm(at[:, :2], axis=1)
        return far + side * radius_m, -at * [1, 1, 0] / far[:, None], strength

    return echo


def test_the_wall_of_a_tank_is_shown_across_a_column():
    """Around a column of this width both ways comes an echo of -18 dB."""
    grid = ul.Grid.covering([[-4.5, -4.5, 0], [4.5, 4.5, 2.6]], 0.1, dims=3)
    mapper = Mapper(grid, method="likelihood")
    column, far_wall = upright(-1, 0.2, 0.28), upright(1, 4.0, 10 ** (-22 / 20))
    mapper.update(flown(beside(), column, far_wall, tank((0, 0, 0), 4.0)))
    mapper.finish()
    _, j, k = np.nonzero(mapper.map().occupied)
    away, east = np.hypot(grid.x_m[k], grid.y_m[j]), grid.x_m[k] > 2.5
    assert (away < 0.4).sum() > 10
    for side in (east, grid.x_m[k] < -2.5):
        assert ((np.abs(away - 4.0) < 0.15) & side).sum() > 50


@pytest.mark.parametrize(("half_m", "alive"), [(0.0, True), (0.2, True), (0.45, False), (2.0, False)])
def test_an_obstacle_hides_an_echo_where_it_is_wider_than_the_way_around(half_m, alive):
    """The ray itself is blocked in each case; the way around is 0.3 m wide in the middle of the path."""
    box, far, wide = Box(0.0, -3.0, -3.0, 0.1, 60, 60, 80), 6.0, 0.3 / np.sqrt(1.5)
    views = SpatialViews(
        np.full((1, 3), 0.01), np.eye(3)[:1], np.eye(3)[None, 1:], np.array([far]), np.full((1, 2), 0.1),
        np.zeros((1, 2)), np.array([0.5]), np.ones(1),
    )  # fmt: skip
    evidence, level = np.zeros((2, 60, 60, 80))
    aside = np.abs(-2.95 + 0.1 * np.arange(60)) < max(half_m, 0.06)
    evidence[np.ix_(aside, aside, [30])], level[:] = 10.0, 1.0
    got = np.ones(1, bool)
    find_hidden(box, views, evidence.ravel(), level.ravel(), 1.5, np.array([wide]), got)
    assert got[0] == alive


@pytest.mark.parametrize("sign", [-1, 1])
def test_a_level_straight_flight_leaves_up_and_down_ambiguous(sign):
    path = Trajectory.line((-1.2, 0, 1.2), (1.2, 0, 1.2), 0.5, 8.0)
    unit = np.array([0.0, 0.77, 0.64 * sign])
    omap = mapped(flown(path, plane(unit, 1.4 + 1.2 * 0.64 * sign))).map()
    assert not omap.occupied.any()
    open_z = centres(omap.ambiguous)[:, 2]
    assert (open_z > 1.6).sum() > 10
    assert (open_z < 0.8).sum() > 10


def test_pieces_of_any_size_give_the_volume_of_the_whole():
    """Also where the map was asked for in between, as what keyframes see is kept: there and back over its places."""
    there = climbing(40)
    path = Trajectory(
        np.arange(80) * 120_000_000, np.concatenate([there.position, there.position[::-1] + 0.03]),
        np.tile([0, 0, 0, 1.0], (80, 1)),
    )  # fmt: skip
    frames = flown(path, *box_room())
    late = {name: part if name == "front" else part[20:] for name, part in frames.items()}  # sensors that join later
    whole = mapped(late).map()
    assert whole.occupied.any()
    assert whole.free.any()
    mapper = Mapper(GRID, method="likelihood")
    for start in range(80):
        for part in late.values():
            now = (part.t_ns >= path.t_ns[start]) & (part.t_ns < path.t_ns[start] + 120_000_000)
            if now.any():
                mapper.update(part[np.flatnonzero(now)])
        if start % 5 == 4:
            assert mapper.changed() or start < 20
    mapper.finish()
    assert np.array_equal(mapper.map().percent, whole.percent)
    mapper.changed()
    assert not mapper.changed(), "nothing new"


def test_wrong_frames_are_refused_in_one_line():
    frames = flown(climbing(12), plane([0, 1, 0], 2.0))
    mixed = {**frames, "left": replace(frames["left"], samples=frames["left"].amplitude)}
    with pytest.raises(ul.InputError, match=r"left: its samples have no phase, but another sensor's have"):
        mapped(mixed)
    with pytest.raises(ul.InputError, match="does not hold the flight"):
        ul.map_occupancy(frames, ul.Grid.covering([[5, 5, 0], [6, 6, 1]], 0.1, dims=3), method="likelihood")
    with pytest.raises(ul.InputError, match="floor_z_m"):
        Mapper(GRID, method="likelihood", floor_z_m=np.nan)


def test_surfaces_of_a_room_hold_its_faces(room):
    shown = [one for one in room[1].surfaces if one.on_map]
    for axis in range(3):
        for sign, side in ((1, HIGH), (-1, LOW)):
            unit = sign * np.eye(3)[axis]
            face = max((one for one in shown if one.state[1:4] @ unit > 0.98), key=lambda one: one.log_odds)
            assert face.kind == "plane"
            far = face.state[0] + face.position @ face.state[1:4]
            assert abs(far - sign * side[axis]) < 3 * np.sqrt(face.covariance[0, 0]) + 0.02
            assert np.all(np.abs(face.points[:, axis] - side[axis]) < 0.05)
            assert np.all(face.normals @ -unit > 0.98)
            assert len(face.points) == len(face.normals) == face.seen
            assert np.linalg.eigvalsh(face.covariance).min() > -1e-12


def test_lines_of_a_surface_lie_in_it(room):
    wall = max(room[1].surfaces, key=lambda one: one.log_odds)
    lines = wall.lines(0.3, 99.0)
    assert lines.shape == (2 * wall.seen, 2, 3)
    along = lines[:, 1] - lines[:, 0]
    assert np.allclose(np.linalg.norm(along, axis=1), 0.3)
    assert np.allclose(np.sum(along * np.tile(wall.normals, (2, 1)), axis=1), 0, atol=1e-9)
    assert np.allclose(lines.mean(axis=1), np.tile(wall.points, (2, 1)))
    assert np.allclose(np.sum(along[: wall.seen] * along[wall.seen :], axis=1), 0, atol=1e-9)


def test_a_pole_is_an_edge_and_a_tank_a_cylinder():
    def pole(at):
        ray = (np.array([0.9, 1.7, 0]) - at) * [1, 1, 0]
        far = np.linalg.norm(ray, axis=1)
        return far, ray / far[:, None], 0.2

    kinds = {}
    for name, echo in (("pole", pole), ("tank", tank((0.4, -0.3, 0.0), 2.4))):
        best = max(mapped(flown(crossing(), echo)).surfaces(), key=lambda one: one.log_odds)
        kinds[name] = best.kind
    assert kinds == {"pole": "edge", "tank": "cylinder"}


def test_amplitudes_without_phase_show_the_faces_of_a_room(room):
    frames = {name: replace(part, samples=part.amplitude) for name, part in room[0].items()}
    omap = mapped(frames).map()
    occupied = centres(omap.occupied)
    assert np.mean(away_from_room(occupied) < 0.2) > 0.9
    assert len(occupied) > 0.4 * room[1].occupied.sum()


def test_a_known_floor_takes_its_echo_and_is_drawn_where_it_shows():
    """From a level straight flight nothing else says whether the echo comes from above or below."""
    path = Trajectory.line((-1.2, 0, 1.2), (1.2, 0, 1.2), 0.5, 8.0)
    frames = flown(path, plane([0, 0, -1.0], 0.0))
    unknown, known = (ul.map_occupancy(frames, GRID, method="likelihood", floor_z_m=z) for z in (None, 0.0))
    assert not unknown.occupied.any()
    cells = centres(known.occupied)
    assert len(cells) > 20
    assert np.all(np.abs(cells[:, 2]) < 0.1)


@pytest.mark.parametrize("sigma_m", [0.0, 0.003])
def test_white_errors_of_the_poses_are_estimated_in_a_volume(sigma_m):
    some = slice(0, 60)
    frames = {name: part[some] for name, part in flown(climbing(250), *box_room()).items()}
    mapper = mapped(world.shaken(frames, sigma_m, seed=5))
    assert mapper.pose_sigma_m == pytest.approx(sigma_m, rel=0.35, abs=3e-4)
    occupied = centres(mapper.map().occupied)
    assert len(occupied) > 100
    assert np.mean(away_from_room(occupied) < 0.15) > 0.9


@pytest.mark.slow
def test_a_room_is_mapped_with_errors_of_3_mm(room):
    mapper = mapped(world.shaken(flown(climbing(150), *box_room()), 0.003, seed=5))
    assert mapper.pose_sigma_m > 0.002
    occupied = centres(mapper.map().occupied)
    assert np.mean(away_from_room(occupied) < 0.15) > 0.9
    assert len(occupied) > 0.5 * room[1].occupied.sum()


def test_before_any_frame_a_volume_is_unknown():
    omap = Mapper(GRID, method="likelihood").map()
    assert not omap.occupied.any()
    assert not omap.free.any()


def test_what_nothing_would_have_received_is_not_free():
    """A partition that the flight passes inside the blind range, and a box below the flight with its top unseen."""
    partition, crate = np.array([[-3.5, 0.5, -1.3], [0.0, 0.55, 1.3]]), np.array([[0.6, -1.4, -1.3], [1.6, -0.6, -0.5]])
    scene = ul.scenes.room((7.0, 5.0, 2.6))
    for name, (low, high), material in (("partition", partition, "concrete"), ("crate", crate, "steel")):
        scene = scene.add(Scene.of_mesh(*shapes.box(high - low), name=name, made_of=material), at=(low + high) / 2)
    s = np.linspace(0, 1, 140)
    place = np.stack([2.6 - 5.2 * s, 0.1 + 0.05 * np.sin(9 * s), 0.1 + 0.3 * np.sin(5 * s)], axis=1)
    path = Trajectory(np.arange(len(s)) * 60_000_000, place, np.tile([0, 0, 0, 1.0], (len(s), 1)))
    frames = ul.simulate(scene, path, ul.Rig.preset("thesis-4"), max_bounces=1, seed=2)
    grid = ul.Grid.covering(scene.bounds, 0.1, dims=3, margin_m=0.3)
    free = ul.map_occupancy(frames, grid, method="likelihood").free
    k, j, i = np.nonzero(free)
    cells = np.stack([grid.x_m[i], grid.y_m[j], grid.z_m[k]], axis=1)
    assert len(cells) > 500
    for low, high in (partition, crate):
        assert not np.all((cells > low - 0.02) & (cells < high + 0.02), axis=1).any()
