"""explain: what echoes come from, with both ways to call it, and what comes through a sheet."""

import itertools
from dataclasses import replace

import numpy as np
import pytest

import ullage as ul

RADAR = ul.RadarSpec.preset("x4m05", antenna={"kind": "isotropic"}, noise=None)
HERE = ul.Trajectory.stationary()


def test_both_calls_agree():
    scene = ul.scenes.room((6, 4, 3), plate={"width_m": 0.5, "height_m": 0.5, "distance_m": 2.0})
    ours = ul.explain(scene, HERE, RADAR, i=0, max_bounces=2)
    frames = ul.simulate(scene, HERE, RADAR, max_bounces=2)
    assert [str(c) for c in ul.explain(frames, 0, scene=scene, max_bounces=2)] == [str(c) for c in ours]
    assert ours[0].object == "plate"
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
