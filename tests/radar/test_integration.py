"""A frame that is summed while things move: laws of the Doppler loss, and where nothing moves the same bits."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from radar_worlds import db

import ullage as ul
from ullage.data import joined
from ullage.geometry import rpy_quat
from ullage.radar.simulate import simulate_stream

INSTANT = ul.RadarSpec.preset("x4m05", noise=None)
SUMMED = INSTANT.but(integration_s=INSTANT.sweeps_s)
BLIND_M_S = INSTANT.wavelength_m / (2 * INSTANT.sweeps_s)
WALL = ul.scenes.plate(40, 40, 4.0)


def at_speed(velocity, spin=(0.0, 0.0, 0.0), turn=(0.0, 0.0, 0.0, 1.0)) -> ul.Trajectory:
    """One pose at the origin that moves."""
    return ul.Trajectory([0], np.zeros((1, 3)), [turn], np.array([velocity], float), np.array([spin], float))


def loss_db(scene: ul.Scene, path: ul.Trajectory, spec: ul.RadarSpec = SUMMED, **options: int) -> float:
    summed, instant = (ul.simulate(scene, path, one, **options).amplitude for one in (spec, INSTANT))
    return db(summed.max() / instant.max())


def moving(scene: ul.Scene, speed_m_s: float) -> ul.Scene:
    """The scene with all objects going along x."""
    track = ul.Trajectory.line((-speed_m_s, 0, 0), (speed_m_s, 0, 0), speed_m_s, 100.0)
    track = replace(track, t_ns=track.t_ns - 10**9)
    return replace(scene, objects=tuple(replace(o, motion=track) for o in scene.objects))


@pytest.mark.parametrize("fidelity", ["physical", "thesis"])
def test_a_radar_at_rest_has_the_same_bits(fidelity):
    room = ul.scenes.room(size_m=(6, 4, 3))
    path = ul.Trajectory.stationary((0.2, 0.1, 0), 20.0, n=3)
    noisy = ul.RadarSpec.preset("x4m05")
    once, summed = (ul.simulate(room, path, noisy.but(integration_s=t), fidelity=fidelity) for t in (0, 0.05))
    assert once.samples.tobytes() == summed.samples.tobytes()


@pytest.mark.parametrize("share", [0.1, 0.45, 0.7, 1.4, 5.3])
def test_an_echo_ahead_loses_a_sinc(share):
    speed = share * BLIND_M_S
    law = db(np.sinc(2 * speed * SUMMED.integration_s / SUMMED.wavelength_m))
    if share < 1:  # over a wide band the loss differs from that of the carrier
        assert loss_db(WALL, at_speed((speed, 0, 0))) == pytest.approx(law, abs=0.1)
        assert loss_db(moving(WALL, speed), ul.Trajectory.stationary()) == pytest.approx(law, abs=0.1)
    narrow = [one.but(bandwidth_hz=1e8, bins=400, prf_div=64) for one in (SUMMED, INSTANT)]
    summed, instant = (ul.simulate(WALL, at_speed((speed, 0, 0)), one).amplitude.max() for one in narrow)
    assert db(summed / instant) == pytest.approx(law, abs=0.1)


def test_an_echo_keeps_its_range():
    path = at_speed((0.45 * BLIND_M_S, 0, 0))
    ranges = []
    for spec in (SUMMED, INSTANT):
        power = ul.simulate(WALL, path, spec).amplitude[0] ** 2
        ranges.append(power @ spec.range_m / power.sum())
    assert ranges[0] == pytest.approx(ranges[1], abs=1e-3)


def compare_with_many_instants(spec: ul.RadarSpec, rate: float, share: float) -> None:
    """Compare a frame of a radar that goes and turns with the mean of 400 frames, within a share of its peak."""
    scene = ul.Scene.union([ul.scenes.trihedral(0.4, 2.0), ul.scenes.plate(2, 2, 3.0, name="wall")])
    velocity, time = np.array([0.5, -0.3, 0.2]), spec.integration_s
    got = ul.simulate(scene, at_speed(velocity, (0, 0, rate), rpy_quat(0, 0, 0.1)), spec, max_bounces=2).samples[0]
    after = (np.arange(400) + 0.5) / 400 * time - time / 2
    path = ul.Trajectory(np.rint((after + 1) * 1e9), after[:, None] * velocity, rpy_quat(0, 0, 0.1 + rate * after))
    want = ul.simulate(scene, path, spec.but(integration_s=0, stagger_div=None), max_bounces=2).samples.mean(0)
    assert abs(got - want).max() < share * abs(want).max()


@pytest.mark.parametrize("changes", [{}, {"output": "rf", "bins": 1500}])
def test_a_frame_is_the_mean_along_the_path_of_a_mounted_radar(changes):
    mount = ul.MountSpec(position_m=(0.1, 0.3, 0), yaw_deg=-10)
    # the radar goes straight on within a frame, not round the body's centre
    compare_with_many_instants(SUMMED.but(mount=mount, stagger_div=17, **changes), 1.5, 1e-2)


def test_a_frame_is_the_mean_over_the_headings_of_a_radar_that_turns():
    beam = {"kind": "cosine", "azimuth_deg": 20, "elevation_deg": 20}
    compare_with_many_instants(SUMMED.but(antenna=beam), 8.0, 3e-3)


def test_cutting_the_track_changes_no_bit():
    path = ul.Trajectory.line((0, 0, 0), (0.2, 0, 0), 0.5, 17.0)
    whole = ul.simulate(WALL, path, SUMMED)
    pieces = [part["radar"] for part in simulate_stream(WALL, path, SUMMED, chunk=2)]
    assert joined(pieces).samples.tobytes() == whole.samples.tobytes()
