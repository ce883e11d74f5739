"""Receivers of the other polarisation: laws of symmetry, of dihedrals and wires, and reciprocity."""

import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import ullage as ul
from ullage.radar import physical
from ullage.radar.context import AntennaPair, antenna_pair, radar_context, radar_frame
from ullage.radar.physical import echoes, path_gain_cw
from ullage.world.library import WORLDS

sys.path.insert(0, str(Path(__file__).parents[1] / "radar"))
from test_rotation import poses_in, turned

V, H = "vertical", "horizontal"


def radar(sent, received, **changes):
    antenna = {"kind": "isotropic", "polarization": sent, "receive_polarization": received}
    return ul.RadarSpec.preset("x4m05", noise=None, antenna=antenna, **changes)


def rolled(deg):
    """The sensor at the origin, turned about its boresight."""
    turn = Rotation.from_euler("x", deg, degrees=True).as_quat()
    return ul.Trajectory(np.array([0]), np.zeros((1, 3)), turn[None])


def level(scene, sent, received, *, roll=0.0, bounces=1, edges=True):
    """Complex path gain at the carrier."""
    return path_gain_cw(scene, rolled(roll), radar(sent, received), max_bounces=bounces, edges=edges)[0]


@pytest.mark.parametrize(
    "scene",
    [ul.scenes.plate(0.4, 0.4, 3.0), ul.scenes.plate(2, 2, 3.0, material="concrete"), ul.scenes.sphere(0.02, 3.0),
     ul.scenes.sphere(0.3, 3.0), ul.scenes.sphere(0.3, 3.0, "concrete", edge_m=0.03)],
)  # fmt: skip
@pytest.mark.parametrize("roll", [0, 30])
def test_a_crossed_receiver_receives_nothing_of_a_plate_ahead_or_a_ball(scene, roll):
    assert abs(level(scene, V, H, roll=roll)) < 1e-3 * abs(level(scene, V, None, roll=roll))


def test_a_dihedral_at_45_deg_turns_the_polarisation():
    """Its two reflections turn the field by twice the angle of its fold to it."""
    corner = ul.scenes.dihedral(0.5, 3.0)

    def double(sent, received, roll):
        once, both = (level(corner, sent, received, roll=roll, bounces=b, edges=False) for b in (1, 2))
        return abs(both - once)

    for sent, received in ((V, H), (H, V)):
        assert double(sent, received, 45) == pytest.approx(double(V, None, 0), rel=1e-3)
        assert double(sent, received, 0) < 1e-3 * double(V, None, 0)


@pytest.mark.parametrize("tilt", [20, 45, 60])
def test_a_thin_wire_returns_the_field_along_it(tilt):
    wire, along, t = ul.scenes.wire(1e-4, 0.3, 3.0, tilt), ul.scenes.wire(1e-4, 0.3, 3.0), np.radians(tilt)
    best = abs(level(along, V, None))
    assert abs(level(wire, V, None)) == pytest.approx(best * np.cos(t) ** 2, rel=0.01)
    assert abs(level(wire, V, H)) == pytest.approx(best * np.sin(t) * np.cos(t), rel=0.01)


@pytest.mark.parametrize(
    ("scene", "bounces"),
    [(ul.scenes.dihedral(0.5, 6.0, yaw_deg=20), 2), (ul.scenes.wire(0.02, 0.2, 6.0, 30), 1),
     (ul.scenes.plate(0.3, 0.2, 6.0, 30), 1), (ul.scenes.plate(0.3, 0.2, 6.0, 30, "concrete"), 1),
     (ul.scenes.cylinder(0.03, 0.3, 6.0), 1)],
)  # fmt: skip
def test_the_echoes_of_turned_polarisations_follow_from_those_of_two(scene, bounces):
    """The field is linear: a far echo is a symmetric matrix between both polarisations [Balanis2012, ch. 11]."""
    assert differ(lambda sent, received, roll: level(scene, sent, received, roll=roll, bounces=bounces)) < 0.01


def differ(received_level):
    """Largest difference of the echoes at a turned radar from those that follow from the upright one's."""
    pairs = ((V, V), (V, H), (H, V), (H, H))
    matrix = np.array([received_level(*pair, 0) for pair in pairs]).reshape(2, 2)
    worst = 0.0
    for roll in (25, 70):
        c, s = np.cos(np.radians(roll)), np.sin(np.radians(roll))
        turn = np.array([[c, -s], [s, c]])  # rows: the turned z and y by z and y
        found = np.array([received_level(*pair, roll) for pair in pairs]).reshape(2, 2)
        worst = max(worst, abs(found - turn @ matrix @ turn.T).max() / abs(matrix).max())
    return worst


@pytest.mark.parametrize("material", ["pec", "concrete"])
@pytest.mark.parametrize("above", [ul.scenes.wire(0.002, 0.2, 6.0, 30), ul.scenes.sphere(0.1, 6.0)])
def test_paths_over_a_floor_carry_turned_polarisations_too(above, material):
    """They leave the axis by 5 deg, where projections of the field on the wave front differ by 1 %."""
    flat = ul.scenes.plate(1, 1, 1, material=material, name="floor")
    corners = np.array([[-2, -5, -0.25], [8, -5, -0.25], [8, 5, -0.25], [-2, 5, -0.25]])
    world = ul.Scene.union([replace(flat, vertices=corners), above])

    def over(sent, received, roll):
        return np.subtract(*(level(world, sent, received, roll=roll, bounces=b) for b in (2, 1)))

    assert differ(over) < 0.03


@pytest.mark.parametrize(
    ("name", "count"),
    [("ntnu-plate", 4), ("cargo-hold", 4), ("cluttered-room", 3), ("lying-tank", 2), ("pipe-rack", 2)],
)
def test_exchanged_polarisations_and_turned_worlds_change_no_sample(name, count):
    scene = ul.load_scene(WORLDS[name].path)
    path = poses_in(scene, count)
    crossed, back = (echoes(scene, path, radar(*pair), max_bounces=3) for pair in ((V, H), (H, V)))
    after = echoes(*turned(scene, path, 1), radar(V, H), max_bounces=3)
    for other in (back, after):
        assert (abs(other - crossed).max(1) < 1e-3 * abs(crossed).max(1)).all()


@pytest.mark.parametrize("world", ["cluttered-room", "cargo-hold"])
def test_antennas_of_two_polarisations_exchange_places(world):
    scene = ul.load_scene(WORLDS[world].path)
    spec = radar(V, H, bins=2000, range_start_m=0.0, prf_div=255)
    ready, middle = radar_context(scene, spec), scene.bounds.mean(0)
    for gap in (0.05, 0.5):
        still = antenna_pair(spec, middle, np.eye(3))
        pair = AntennaPair(np.stack([middle, middle + np.array([0, gap, 0])]), still.frames, still.fields)
        there, back = (radar_frame(ready, one, None, 3) for one in (pair, pair.swapped()))
        for frame in (there, back):
            physical.accumulate(frame)
        assert abs(there.grids - back.grids).max() < 0.01 * abs(there.grids).max()


def test_the_ray_model_refuses_a_crossed_receiver():
    path = ul.Trajectory.line((0, 0, 0), (0.1, 0, 0), 1.0, 2)
    with pytest.raises(ul.InputError, match="the ray model has no polarisation"):
        ul.simulate(ul.scenes.plate(1, 1, 2.0), path, radar(V, H), fidelity="thesis")
