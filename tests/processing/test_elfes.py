import dataclasses
import itertools
import warnings

import numpy as np
import pytest

import ullage as ul
from ullage.data import Frames, Trajectory
from ullage.processing.occupancy import Mapper

SPEC = ul.RadarSpec.preset("x4m05")
GRID = ul.Grid.covering([[-6, -4, -1], [6, 8, 1]], 0.1)


def echoes(path, ranges, *, height=0.1):
    axis = SPEC.range_m
    profile = height * np.exp(-0.5 * ((axis[None] - np.asarray(ranges, float)[:, None]) / 0.08) ** 2)
    return Frames(profile.astype(np.float32), axis, path.t_ns, SPEC, poses=path, unit="thesis")


def twin(empty, occupied, grid, x, y, yaw, near, reach, spread, half):
    """Elfes' formulas, cell by cell, as in his paper."""
    cells = {}
    for row in range(grid.shape[0]):
        for column in range(grid.shape[1]):
            dx, dy = grid.x_m[column] - x, grid.y_m[row] - y
            d, angle = np.hypot(dx, dy), (np.arctan2(dy, dx) - yaw + np.pi) % (2 * np.pi) - np.pi
            if abs(angle) > half:
                continue
            across = 1 - (angle / half) ** 2
            if near <= d < reach - spread:
                weight = (1 - ((d - near) / (reach - spread - near)) ** 2) * across
                empty[row, column] = empty[row, column] + weight - empty[row, column] * weight
            elif abs(d - reach) < spread:
                cells[row, column] = (1 - ((d - reach) / spread) ** 2) * across
    cells = {k: v * (1 - empty[k]) for k, v in cells.items()}
    total = sum(cells.values())
    for k, v in cells.items():
        occupied[k] = occupied[k] + v / total - occupied[k] * v / total


def test_kernel_equals_its_slow_twin():
    from ullage.kernels.elfes import Cells, Lobe, Reading, insert_reading

    grid = ul.Grid((-2.0, -1.0, 0.0), 0.2, (25, 30))
    rng = np.random.default_rng(1)
    fast = np.zeros((2, *grid.shape)), np.zeros((2, *grid.shape))
    for _ in range(4):
        x, y, yaw, reach = rng.uniform(-1, 2), rng.uniform(0, 2), rng.uniform(-3, 3), rng.uniform(1, 3)
        reading, lobe = Reading(x, y, yaw, 0.2, reach, True), Lobe(0.6, 0.2)
        insert_reading(fast[0][0], fast[0][1], Cells(-2.0, -1.0, 0.2), reading, lobe, np.zeros(4, int))
        twin(fast[1][0], fast[1][1], grid, x, y, yaw, 0.2, reach, 0.2, 0.6)
    np.testing.assert_allclose(fast[0], fast[1], atol=1e-6)
    assert fast[0][1].max() > 0.1


def test_a_wall_is_mapped_where_it_stands():
    path = Trajectory.line((-2, 0, 0), (2, 0, 0), rate_hz=10, yaw_deg=90)
    omap = ul.map_occupancy(echoes(path, np.full(len(path), 3.0)), GRID, method="elfes")
    rows, columns = np.nonzero(omap.occupied)
    assert len(rows) > 20
    assert abs(np.median(GRID.y_m[rows]) - 3.0) < 0.1
    inside = (abs(GRID.x_m[columns]) < 1.8) & (abs(GRID.y_m[rows] - 3) < 0.3)
    assert inside.mean() > 0.8
    assert omap.percent[np.searchsorted(GRID.y_m, 1.5), np.searchsorted(GRID.x_m, 0.0)] <= 5
    assert omap.unknown[0].all(), "behind the drone nothing is known"
    assert omap.percent.max() <= 100
    assert omap.percent.min() == -1


def test_hovering_makes_ghosts_along_the_arc_as_the_thesis_reports():
    still = Trajectory.stationary(yaw_deg=90, n=300)
    short = ul.map_occupancy(echoes(still[:1], [3.0]), GRID, method="elfes")
    long = ul.map_occupancy(echoes(still, np.full(300, 3.0)), GRID, method="elfes")
    assert short.occupied.sum() == 0
    rows, columns = np.nonzero(long.occupied)
    assert np.ptp(GRID.x_m[columns]) > 2.0
    np.testing.assert_allclose(np.hypot(GRID.x_m[columns], GRID.y_m[rows]), 3.0, atol=0.2)


def test_eight_bits_take_one_byte_a_cell_and_keep_the_wall():
    path = Trajectory.line((-2, 0, 0), (2, 0, 0), rate_hz=10, yaw_deg=90)
    frames = echoes(path, np.full(len(path), 3.0))
    small, large = (Mapper(GRID, method="elfes", bits=bits) for bits in (8, 32))
    for mapper in (small, large):
        mapper.update(frames)
    assert (small.nbytes, large.nbytes) == (GRID.size, 8 * GRID.size)
    rows, _ = np.nonzero(small.map().occupied)
    assert len(rows) > 20
    assert abs(np.median(GRID.y_m[rows]) - 3.0) < 0.1
    known = ~large.map().unknown & ~small.map().unknown
    differ = abs(small.map().percent[known].astype(int) - large.map().percent[known])
    assert np.median(differ) <= 2
    assert small.traversed == large.traversed


def test_one_byte_holds_what_the_formulas_give_where_all_readings_agree():
    still = Trajectory.stationary(yaw_deg=90, n=3)
    small, large = (ul.map_occupancy(echoes(still, np.full(3, 3.0)), GRID, method="elfes", bits=b) for b in (8, 32))
    free = abs(np.hypot(GRID.x_m[None, :], GRID.y_m[:, None]) - 1.5) < 1.0  # before the arc: emptiness only
    seen = free & ~small.unknown & ~large.unknown
    assert seen.sum() > 100
    assert np.max(abs(small.percent[seen].astype(int) - large.percent[seen])) <= 1


def test_one_byte_adds_up_echoes_against_what_was_seen_empty():
    still = Trajectory.stationary(yaw_deg=90, n=200)
    near = abs(np.hypot(GRID.x_m[None, :], GRID.y_m[:, None]) - 3.0) < 0.1
    narrow = {"method": "elfes", "bits": 8, "lobe_deg": 12.0}  # a short arc: each reading gives a cell percents
    mapper = Mapper(GRID, **narrow)
    mapper.update(echoes(still[:1], [6.0]))
    empty = (mapper.map().percent < 50) & near & ~mapper.map().unknown
    assert empty.any()
    mapper.update(echoes(still[1:], np.full(199, 3.0)))  # one reading alone is weaker than the emptiness
    assert mapper.map().occupied[empty].any()


def test_eight_bits_stop_growing_where_each_reading_is_weak():
    still = Trajectory.stationary(yaw_deg=90, n=2000)
    frames = echoes(still, np.full(2000, 3.0))
    small, large = (ul.map_occupancy(frames, GRID, method="elfes", bits=bits) for bits in (8, 32))
    assert large.percent.max() == 100
    assert small.percent.max() < 90


def test_a_limit_to_certainty_lets_what_comes_later_fill_a_cell_seen_empty():
    still = Trajectory.stationary(yaw_deg=90, n=1540, rate_hz=17)
    near = abs(np.hypot(GRID.x_m[None, :], GRID.y_m[:, None]) - 3.0) < 0.15
    grown = {}
    for certain in (1.0, 0.99):
        mapper = Mapper(GRID, method="elfes", certain=certain)
        mapper.update(echoes(still[:1200], np.full(1200, 5.0)))
        before = mapper.map().occupied[near].sum()
        mapper.update(echoes(still[1200:], np.full(340, 3.0)))  # something comes between
        grown[certain] = int(mapper.map().occupied[near].sum() - before)
    assert grown[0.99] > 2 * grown[1.0]
    with pytest.raises(ul.InputError, match=r"certain is 0\.2.*above 0\.5"):
        Mapper(GRID, method="elfes", certain=0.2)


def test_other_numbers_of_bits_are_refused():
    with pytest.raises(ul.InputError, match=r"bits is 16.*8 or 32"):
        Mapper(GRID, method="elfes", bits=16)


def test_no_echo_frees_to_the_end_of_the_range_axis():
    still = Trajectory.stationary(yaw_deg=90)
    omap = ul.map_occupancy(echoes(still, [3.0], height=0.0), GRID, method="elfes")
    assert omap.percent[np.searchsorted(GRID.y_m, 7.5), np.searchsorted(GRID.x_m, 0.0)] < 50
    assert not omap.occupied.any()


def test_pieces_give_the_map_of_the_whole_and_say_what_changed():
    path = Trajectory.line((-2, 0, 0), (2, 0, 0), rate_hz=10, yaw_deg=90)
    frames = echoes(path, np.full(len(path), 3.0))
    whole = ul.map_occupancy(frames, GRID, method="elfes")
    mapper = Mapper(ul.Grid.covering([[-6, -4, -1], [6, 8, 1]], 0.1, z_m=0.0), method="elfes")
    patched = np.full(GRID.shape, -1, np.int8)
    for piece in frames.chunks(7):
        mapper.update(piece)
        for (row, column), values in mapper.changed():
            patched[row : row + len(values), column : column + values.shape[1]] = values
        np.testing.assert_array_equal(patched, mapper.map().percent)
    np.testing.assert_array_equal(mapper.map().percent, whole.percent)
    assert not mapper.changed()


def test_roll_and_pitch_are_projected_to_the_plane():
    from ullage.geometry import rpy_quat

    n = 5
    tilted = Trajectory(
        np.arange(n) * 10**8, np.zeros((n, 3)), np.tile(rpy_quat(np.radians(20), np.radians(10), np.pi / 2), (n, 1))
    )
    flat = Trajectory.stationary(yaw_deg=90, n=n, rate_hz=10)
    a, b = (ul.map_occupancy(echoes(p, np.full(n, 3.0)), GRID, method="elfes").percent for p in (tilted, flat))
    np.testing.assert_array_equal(a, b)


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (lambda f: Frames(f.samples, f.range_m, f.t_ns, f.spec), "no poses"),
        (lambda f: Frames(np.where(np.arange(len(f))[:, None] == 3, np.nan, f.samples), f.range_m, f.t_ns, f.spec,
                          poses=f.poses), "frame 3 has a sample that is not finite"),
    ],
)  # fmt: skip
@pytest.mark.parametrize("method", ["elfes", "ullage"])
def test_bad_frames_are_refused(change, words, method):
    path = Trajectory.line((-2, 0, 0), (2, 0, 0), rate_hz=10, yaw_deg=90)
    with pytest.raises(ul.InputError, match=words):
        ul.map_occupancy(change(echoes(path, np.full(len(path), 3.0))), GRID, method=method)


@pytest.mark.parametrize("method", ["elfes", "ullage"])
def test_a_grid_that_does_not_hold_the_flight_is_refused(method):
    path = Trajectory.line((-2, 0, 0), (9, 0, 0), rate_hz=10, yaw_deg=90)
    with pytest.raises(ul.InputError, match="does not hold the flight: frame 160"):
        ul.map_occupancy(echoes(path, np.full(len(path), 3.0)), GRID, method=method)


def test_poses_that_jump_are_warned_about():
    a, b = Trajectory.stationary(n=3, rate_hz=10), Trajectory.stationary((3, 0, 0), n=3, rate_hz=10)
    path = Trajectory(np.arange(6) * 10**8, np.concatenate([a.position, b.position]), np.tile(a.quat_xyzw, (2, 1)))
    with pytest.warns(ul.UllageWarning, match="jump 1 times, first at frame 3"):
        omap = ul.map_occupancy(echoes(path, np.full(6, 2.0)), GRID, method="elfes")
    both, inside = GRID.index(np.array([[1.0, 0.0, 0.0], [4.0, 0.0, 0.0]]))
    assert inside.all()
    assert omap.free[tuple(both.T)].all()


def test_unknown_method_names_the_known_ones():
    with pytest.raises(ul.InputError, match="ullage, likelihood, elfes"):
        ul.map_occupancy(echoes(Trajectory.stationary(), [3.0]), GRID, method="magic")
    warnings.resetwarnings()


def test_the_map_does_not_hang_on_the_order_of_the_radars():
    path = Trajectory.line((-2, 0, 0), (2, 0, 0), rate_hz=5, yaw_deg=70)
    rng = np.random.default_rng(3)
    frames = {
        name: dataclasses.replace(echoes(path, 3 + 0.1 * rng.standard_normal(len(path))), sensor=name)
        for name in ("right", "front", "left")
    }
    live = Mapper(GRID, method="elfes")
    for k in range(len(path)):
        live.update({name: part[k : k + 1] for name, part in frames.items()})
    assert live.map().occupied.sum() > 20
    for names in itertools.permutations(frames):
        whole = ul.map_occupancy({name: frames[name] for name in names}, GRID, method="elfes", remove_own_echo=False)
        np.testing.assert_array_equal(whole.percent, live.map().percent)
