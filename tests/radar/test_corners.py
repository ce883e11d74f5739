"""Corners of flat faces echo in any world, whatever larger faces there are, once and without jumps."""

from dataclasses import replace

import numpy as np
import pytest

import ullage as ul
from ullage.radar import multipath
from ullage.radar.context import antenna_pair, radar_context
from ullage.radar.corners import corners_of
from ullage.radar.physical import path_gain_cw
from ullage.radar.prepared import prepare
from ullage.world import shapes
from ullage.world.library import WORLDS
from ullage.world.moving import LiveMotion
from ullage.world.scene import Scene

RADAR = ul.RadarSpec.preset("x4m05", noise=None, antenna={"kind": "isotropic"})


def db(ratio):
    return 20 * np.log10(abs(ratio))


def moved(scene, shift):
    return Scene.of_mesh(scene.vertices + np.asarray(shift), scene.faces, name="reflector", made_of="pec")


def box(size, centre=(0, 0, 0), name="box"):
    vertices, faces = shapes.box(size)
    return Scene.of_mesh(vertices + np.asarray(centre), faces, name=name)


@pytest.fixture(scope="module")
def hold():
    return ul.load_scene(WORLDS["cargo-hold"].path)


@pytest.mark.parametrize("waves", [3, 5])
def test_a_corner_reflector_in_a_hold_echoes_as_it_does_alone(hold, waves):
    """More than a thousand faces are there, and dozens of these have a larger apparent size."""
    here, edge = np.array([0.3, 0.2, 6.0]), waves * RADAR.wavelength_m
    pose = ul.Trajectory.stationary(here)
    reflector = moved(ul.scenes.trihedral(edge, 2.0), here)
    alone = ul.simulate(reflector, pose, RADAR, max_bounces=3).samples[0]
    with_it, without = (ul.simulate(s, pose, RADAR, max_bounces=3).samples[0]
                        for s in (Scene.union([hold, reflector]), hold))  # fmt: skip
    place = abs(alone).argmax()
    assert db((with_it - without)[place] / alone[place]) == pytest.approx(0, abs=0.3)


@pytest.mark.parametrize("mirrors", [0, 2, 3])
def test_what_mirrors_and_corners_share_is_counted_once(monkeypatch, mirrors):
    """A trihedral's echo is the same whether its faces are among the largest mirrors, at the border, or not."""
    reflector, pose = ul.scenes.trihedral(0.2, 2.0), ul.Trajectory.stationary((0.0, 0.1, 0.2))
    whole = [path_gain_cw(reflector, pose, RADAR, max_bounces=order)[0] for order in (1, 2, 3)]
    monkeypatch.setattr(multipath, "MIRRORS", mirrors)
    shared = [path_gain_cw(reflector, pose, RADAR, max_bounces=order)[0] for order in (1, 2, 3)]
    assert db(whole[2] / whole[0]) > 20
    assert shared == pytest.approx(whole, rel=1e-6)


def test_the_choice_of_corners_changes_nothing_suddenly(monkeypatch):
    """Brackets of different sizes, of which one or two at a time are followed."""
    monkeypatch.setattr(multipath, "MIRRORS", 1)
    monkeypatch.setattr(multipath, "CORNERS", 3)
    brackets = [moved(ul.scenes.dihedral(0.2 + 0.05 * (k % 2), 0.0), (3.0 + 0.2 * (k % 2), 0.4 * k - 0.8, 0))
                for k in range(5)]  # fmt: skip
    scene = Scene.union(brackets)
    path = ul.Trajectory.line((0.0, -0.4, 0.0), (0.0, 0.4, 0.0), 0.5, 250)
    context = radar_context(scene, RADAR)
    planar, corners, sets = context.world.still.planar, corners_of(context.world.parts()), set()
    for place in path.position[::20]:
        antennas = antenna_pair(RADAR, place, np.eye(3))
        sizes = multipath.apparent_sizes(context, planar, antennas)
        beams = multipath.beams_of(context, planar, antennas, 2, sizes, corners)
        sets.add(tuple(sorted(set(beams.ends_on))))
    samples = ul.simulate(scene, path, RADAR, max_bounces=2).samples
    assert len(sets) > 1
    assert abs(np.diff(samples, axis=0)).max() < 0.05 * abs(samples).max()


def test_a_reflector_that_moves_keeps_its_echo(hold):
    """Its faces move as one body, so its corners stay corners."""
    here = np.array([0.3, 0.2, 6.0])
    still = Scene.union([hold, moved(ul.scenes.trihedral(0.15, 2.0), here)])
    motion = LiveMotion((0.0, 0.0, 0.0), (0.0, 0.0, 0.0, 1.0))
    for t_ns in (0, 10**9):
        motion.see(t_ns, (0.0, 1e-9 * t_ns, 0.0), (0.0, 0.0, 0.0, 1.0))
    moving = replace(still, objects=(*still.objects[:-1], replace(still.objects[-1], motion=motion)))
    track = ul.Trajectory.stationary(here, n=2, rate_hz=2)
    echo = path_gain_cw(moving, track[1:], RADAR, max_bounces=3)[0]
    there = Scene.union([hold, moved(ul.scenes.trihedral(0.15, 2.0), here + np.array([0, 0.5, 0]))])
    assert echo == pytest.approx(path_gain_cw(there, track[:1], RADAR, max_bounces=3)[0], rel=1e-4)


def test_closed_bodies_have_no_corners_inside():
    assert len(corners_of([prepare(box((0.5, 0.6, 0.7))).still])) == 0
    room = corners_of([prepare(ul.scenes.room((4, 3, 2))).still])
    assert (room.faces[:, 2] >= 0).sum() == 8 * 6  # eight corners, each in any order


@pytest.mark.parametrize(("gap", "many"), [(0.0, True), (0.01, True), (0.1, False)])
def test_a_box_on_a_floor_makes_a_corner_with_it(gap, many):
    """Feet of a centimetre part them by no more than an echo notices."""
    floor = ul.scenes.floor((4.0, 4.0), 0.0)
    scene = Scene.union([floor, box((0.4, 0.4, 0.4), (0, 0, 0.2 + gap))])
    found = corners_of([prepare(scene).still]).faces
    assert len(found) == (4 if many else 0)  # the floor mirrors, the side carries the integral


def test_plates_that_stand_apart_or_slanted_make_no_corner():
    bent = ul.scenes.dihedral(0.3, 2.0, opening_deg=120)
    assert len(corners_of([prepare(bent).still])) == 0
    assert len(corners_of([prepare(ul.scenes.dihedral(0.3, 2.0)).still])) == 2
