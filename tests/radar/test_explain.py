"""explain: what echoes come from, with both ways to call it, and what comes through a sheet."""

import itertools
from dataclasses import replace

import numpy as np
import pytest

import ullage as ul
from ullage.geometry import C0

RADAR = ul.RadarSpec.preset("x4m05", antenna={"kind": "isotropic"}, noise=None)
HERE = ul.Trajectory.stationary()


def test_both_calls_agree():
    scene = ul.scenes.room((6, 4, 3), plate={"width_m": 0.5, "height_m": 0.5, "distance_m": 2.0})
    ours = ul.explain(scene, HERE, RADAR, i=0, max_bounces=2)
    frames = ul.simulate(scene, HERE, RADAR, max_bounces=2)
    assert [str(c) for c in ul.explain(frames, 0, scene=scene, max_bounces=2)] == [str(c) for c in ours]
    assert ours[0].object == "plate"
    assert repr(ours[0]) == f"Contribution('plate', 1 bounce, 2.00 m, {ours[0].path_gain_db:.1f} dB)"
    assert ours[0].range_m == pytest.approx(2.0, abs=1e-3)
    assert ours[0].point == pytest.approx((2.0, 0, 0), abs=1e-6)
    assert all(a.path_gain_db >= b.path_gain_db for a, b in itertools.pairwise(ours))
    assert any(c.bounces == 2 and c.via for c in ours)


def test_simulated_frames_know_their_world():
    scene = ul.scenes.room((6, 4, 3), plate={"width_m": 0.5, "height_m": 0.5, "distance_m": 2.0})
    track = ul.Trajectory.line((0, 0, 0), (0, 1, 0), 0.5, 80)
    frames = ul.simulate(scene, track, RADAR, max_bounces=2, seed=4)  # in several chunks
    want = [str(c) for c in ul.explain(scene, track, RADAR, i=100, max_bounces=2, seed=4)]
    assert any("2 bounces" in line for line in want)
    assert [str(c) for c in ul.explain(frames, 100)] == want
    assert [str(c) for c in ul.explain(frames[60:120], 40)] == want  # a piece of them
    assert all(c.bounces == 1 for c in ul.explain(frames, 100, max_bounces=1))


def test_needs_a_scene():
    frames = replace(ul.simulate(ul.scenes.plate(0.5, 0.5, 3.0), HERE, RADAR), simulated=None)
    with pytest.raises(ul.InputError, match="frames cannot be explained without the scene"):
        ul.explain(frames, 0)
    with pytest.raises(ul.InputError, match="no frame 5"):
        ul.explain(ul.scenes.plate(0.5, 0.5, 3.0), HERE, RADAR, i=5)


def test_penetration_delay_and_loss():
    sheet, behind = ul.scenes.plate(6, 6, 2.0, material="plasterboard", name="board"), ul.scenes.plate(1, 1, 4.0)
    alone = ul.explain(behind, HERE, RADAR)[0]
    through = next(c for c in ul.explain(ul.Scene.union([sheet, behind]), HERE, RADAR) if c.object == "plate")
    eps = ul.scenes.plate(1, 1, 1, material="plasterboard").objects[0].material.permittivity(RADAR.center_hz)
    assert through.range_m - alone.range_m == pytest.approx((np.sqrt(eps).real - 1) * 0.0125, abs=3e-4)
    assert -4 < through.path_gain_db - alone.path_gain_db < -0.3
    steel = ul.scenes.plate(6, 6, 2.0, material="steel", name="board")
    assert all(c.object == "board" for c in ul.explain(ul.Scene.union([steel, behind]), HERE, RADAR))


def furnished(seed):
    """A concrete room with a steel plate, a ball, a wire, a glass sheet, and a box that moves, each somewhere."""
    rng = np.random.default_rng(seed)
    somewhere = lambda: tuple(rng.uniform((-2.5, -1.6, -1), (2.5, 1.6, 1)))  # noqa: E731
    times = np.array([0, 10**9])
    way = ul.Trajectory(times, np.array([somewhere(), somewhere()]), np.tile([0, 0, 0, 1.0], (2, 1)))
    box = ul.scenes.trihedral(0.3, distance_m=0.0)
    things = [ul.scenes.room((6, 4, 3)), ul.scenes.plate(0.5, 0.4, 1.6, yaw_deg=rng.uniform(-20, 20), name="plate"),
              ul.scenes.plate(1.5, 1.2, -1.7, material="glass", name="pane"),
              ul.scenes.sphere(0.2, -2.4, name="ball"),
              ul.scenes.wire(0.003, 1.5, 2.7, tilt_deg=rng.uniform(-40, 40), name="wire"),
              ul.Scene.of_mesh(box.vertices, box.faces, name="mover", made_of="steel", motion=way)]  # fmt: skip
    spot = tuple(rng.uniform((-1, -1.5, -1), (1, 1.5, 1)))
    return ul.Scene.union(things), ul.Trajectory.stationary(spot, yaw_deg=rng.uniform(0, 360))


@pytest.mark.parametrize(
    ("seed", "bounces", "apart"), [(1, 1, 0.0), (2, 2, 0.6), (3, 3, 0.0), (4, 3, 0.08), (5, 6, 0.08)]
)
def test_all_contributions_add_up_to_the_frame(seed, bounces, apart):
    scene, here = furnished(seed)
    spec = ul.RadarSpec.preset("x4m05", noise=None, antenna_offset_m=apart)
    frame = ul.simulate(scene, here, spec, max_bounces=bounces, seed=seed).samples[0]
    told = ul.explain(scene, here, spec, max_bounces=bounces, seed=seed, count=None)
    assert len({c.object for c in told}) > 6
    off = abs(sum(c.samples.astype(complex) for c in told) - frame).max() / abs(frame).max()
    assert off < 1e-4
    for c in told[:10]:  # what is told of an echo is what it makes in the frame, to what lies between two bins
        peak = abs(c.samples).argmax()
        assert abs(spec.range_m[peak] - c.seen_m) < 0.08
        assert 20 * np.log10(abs(c.samples[peak])) == pytest.approx(c.path_gain_db, abs=3.0)


@pytest.mark.parametrize("apart", [0.0, 0.3])
def test_echoes_between_round_things_add_up_too(apart):
    spec = RADAR.but(antenna_offset_m=apart)
    drum = ul.scenes.cylinder(0.3, 1.0, 2.0)
    drums = [replace(drum, vertices=drum.vertices + np.array([0.0, y, 0.7])) for y in (-0.6, 0.6)]
    here = ul.Trajectory.stationary((0.2, 0.1, 0.7))
    for scene, names in ((ul.scenes.tank(1.5, 2.0, strips=96), ("wall", "wall")), (ul.Scene.union(drums), None)):
        frame = ul.simulate(scene, here, spec, max_bounces=3).samples[0]
        told = ul.explain(scene, here, spec, max_bounces=3, count=None)
        assert abs(sum(c.samples.astype(complex) for c in told) - frame).max() < 1e-4 * abs(frame).max()
        assert any(c.path == names if names else len(c.path) == 2 for c in told)


def test_a_ball_is_one_echo_of_its_optical_strength():
    radius, away = 0.3, 3.0
    told = ul.explain(ul.scenes.sphere(radius, away), HERE, RADAR)
    want = RADAR.wavelength_m / (8 * np.pi) * radius / ((away - radius) * away)  # rays spread as from r a / (2 r + 2 a)
    assert told[0].path_gain_db == pytest.approx(20 * np.log10(want), abs=0.2)
    assert told[0].range_m == pytest.approx(away - radius, abs=2e-3)
    assert all(c.path_gain_db < told[0].path_gain_db - 30 for c in told[1:])


def test_a_plate_and_its_edges_are_one_echo_where_the_pulse_cannot_part_them():
    told = ul.explain(ul.scenes.plate(1.0, 1.0, 2.2, material="steel"), HERE, RADAR)
    assert all(c.path_gain_db < told[0].path_gain_db - 30 for c in told[1:])


def corner(sides=("north", "east")):
    walls = {"north": ((0, 2, 0), -90), "east": ((2, 0, 0), 180), "south": ((0, -2, 0), 90)}
    return ul.Scene.union([slab(name, *walls[name]) for name in sides])


def slab(name, centre, yaw_deg):
    turn = np.deg2rad(yaw_deg)
    side = np.array([-np.sin(turn), np.cos(turn), 0]) * 2
    up = np.array([0, 0, 2.0])
    points = np.array([centre + a * side + b * up for a, b in ((-1, -1), (1, -1), (1, 1), (-1, 1))])
    return ul.Scene.of_mesh(points, np.array([[0, 1, 2], [0, 2, 3]]), name=name, made_of="pec")


@pytest.mark.parametrize("apart", [0.0, 0.08, 0.6])
def test_a_corner_is_one_echo_however_far_the_antennas_are_apart(apart):
    """Images in faces at right angles commute: over both faces, in either order, is one echo, that of the image."""
    spec = RADAR.but(antenna_offset_m=apart)
    found = [c for c in ul.explain(corner(), HERE, spec, max_bounces=2) if c.bounces == 2]
    way = np.hypot(4, 4)  # from (0, d / 2) over both walls to (0, -d / 2): its image lies at (4, 4 - d / 2)
    assert found[0].range_m == pytest.approx(way / 2, abs=2e-3)
    want = spec.wavelength_m / (4 * np.pi * way)
    assert found[0].path_gain_db == pytest.approx(20 * np.log10(want), abs=0.3)
    assert all(c.path_gain_db < found[0].path_gain_db - 30 for c in found[1:])


def test_orders_that_arrive_apart_are_two_echoes():
    """Between walls 4 m apart, antennas d apart, one wave goes d less, the other d more than both ways across."""
    scene = corner(("north", "south"))
    for apart, ranges in ((0.0, [4.0]), (0.002, [4.0]), (0.02, [3.99, 4.01]), (0.6, [3.7, 4.3])):
        found = [c for c in ul.explain(scene, HERE, RADAR.but(antenna_offset_m=apart), max_bounces=2)
                 if c.bounces == 2 and c.path_gain_db > -75]  # fmt: skip
        assert sorted(c.range_m for c in found) == pytest.approx(ranges, abs=5e-3)
        assert len({c.path for c in found}) == len(ranges)
        one = 20 * np.log10(RADAR.wavelength_m / (4 * np.pi * 8))
        assert max(c.path_gain_db for c in found) == pytest.approx(one + (6.02 if len(ranges) == 1 else 0), abs=1.0)


def test_what_folds_is_told_once_and_where_it_lies():
    last = RADAR.range_m[-1] + 0.05  # before the frame's first bin, a pulse later, it lies farther off
    assert ul.explain(ul.scenes.plate(8, 8, last), HERE, RADAR)[0].seen_m == pytest.approx(last)
    near = ul.scenes.plate(1, 1, 0.06)
    assert ul.explain(near, HERE, RADAR)[0].path_gain_db == pytest.approx(
        ul.explain(near, HERE, RADAR.but(prf_div=40))[0].path_gain_db, abs=1e-6)  # fmt: skip
    far = ul.explain(ul.scenes.plate(8, 8, 13.0), HERE, RADAR)[0]
    assert far.range_m == pytest.approx(13.0)
    assert far.seen_m == pytest.approx(13.0 - C0 / 2 / RADAR.prf_hz)
    assert "folded to 3.13" in str(far)
    peak = abs(far.samples).argmax()
    assert np.angle(far.samples[peak] * np.exp(-1j * far.phase_rad)) == pytest.approx(0, abs=0.1)


def test_the_chain_is_told_as_the_wave_runs():
    small = slab("plate", (0, -1, 0), 90)
    small = replace(small, vertices=small.vertices * [0.1, 1, 0.1])
    told = ul.explain(ul.Scene.union([corner(("north",)), small]), HERE, RADAR.but(antenna_offset_m=0.6), max_bounces=2)
    found = {c.path: c for c in told if c.bounces == 2}
    assert found["north", "plate"].range_m == pytest.approx(2.7, abs=5e-3)
    assert found["plate", "north"].range_m == pytest.approx(3.3, abs=5e-3)
    assert {c.object for c in found.values()} == {"plate"}
    floor = ul.scenes.plate(8, 8, 2.0, name="wall", material="steel")
    told = ul.explain(ul.Scene.union([floor, ul.scenes.wire(0.005, 0.5, 1.0, name="wire")]), HERE, RADAR, max_bounces=3)
    assert any(c.path == ("wall", "wire", "wall") and c.object == "wire" for c in told)


def test_a_moving_target_turns_the_phase():
    times = np.arange(5) * 10_000_000
    quat = np.tile([0, 0, 0, 1.0], (5, 1))
    way = ul.Trajectory(times, np.stack([np.linspace(0, 0.004, 5), np.zeros(5), np.zeros(5)], 1), quat)
    still = ul.scenes.sphere(0.1, 3.0)
    moving = ul.Scene.of_mesh(still.vertices, still.faces, name="ball", made_of="pec", motion=way)
    track = ul.Trajectory(times, np.zeros((5, 3)), quat)
    frames = ul.simulate(moving, track, RADAR)
    peak = frames.samples[:, np.argmax(abs(frames.samples[0]))]
    turn = np.unwrap(np.angle(peak))
    assert turn[-1] - turn[0] == pytest.approx(-4 * np.pi * 0.004 / RADAR.wavelength_m, abs=0.03)


def test_refusals():
    with pytest.raises(ul.InputError, match=r"radius of 0.05 mm \(allowed: at least 0.1 mm\)|at least 0.1 mm"):
        ul.simulate(ul.scenes.wire(5e-5, 2.0, 3.0), HERE, RADAR)
    with pytest.raises(ul.InputError, match="the pulse is"):
        ul.simulate(ul.scenes.plate(1, 1, 3.0), HERE, RADAR.but(bandwidth_hz=1e7, bins=8))
    with pytest.raises(ul.InputError, match=r"no data at 7\.29 GHz"):
        ul.simulate(ul.scenes.plate(1, 1, 3.0, material="floorboard"), HERE, RADAR)
    inside = ul.simulate(ul.scenes.sphere(0.3, 0.1), HERE, RADAR)
    assert np.isfinite(inside.samples).all()
