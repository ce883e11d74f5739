"""Transmitter and receiver change places, near to each other or metres apart: the echo is the same [Balanis2012]."""

import numpy as np
import pytest

import ullage as ul
from ullage.radar import physical
from ullage.radar.context import AntennaPair, antenna_pair, radar_context, radar_frame
from ullage.radar.multipath import accumulate_bounces
from ullage.world.library import WORLDS

RADAR = ul.RadarSpec.preset("x4m05", antenna={"kind": "isotropic"}, noise=None).but(
    bins=2000, range_start_m=0.0, prf_div=255
)


def sent(one, other):
    still = antenna_pair(RADAR, one, np.eye(3))
    return AntennaPair(np.stack([one, other]), still.frames, still.fields)


def apart(rng, low, high, distance):
    """Two random places in a box at a distance from each other [m]."""
    while True:
        one, way = rng.uniform(low, high), rng.normal(size=3)
        other = one + distance * way / np.linalg.norm(way)
        if (other > low).all() and (other < high).all():
            return one, other


def differ(scene, low, high, bounces, distances, seed=3):
    """Largest difference of any place of the delay grids over the largest of them, places changed."""
    ready, rng, worst = radar_context(scene, RADAR), np.random.default_rng(seed), 0.0
    for distance in distances:
        one, other = apart(rng, low, high, distance)
        there, back = (radar_frame(ready, sent(*ends), None, bounces) for ends in ((one, other), (other, one)))
        for frame in (there, back):
            physical.accumulate(frame)
        worst = max(worst, abs(there.grids - back.grids).max() / abs(there.grids).max())
    return worst


DISTANCES = (0.05, 0.3, 1.0, 3.0)


@pytest.mark.parametrize("bounces", [1, 3, 6])
def test_random_dihedrals_and_rooms(bounces):
    rng = np.random.default_rng(17)
    for _ in range(3):
        edge = float(rng.uniform(0.3, 1.2))
        corner = ul.scenes.dihedral(edge_m=edge, distance_m=2.0)
        assert differ(corner, [-1.5, -1.5, -1], [1.5, 1.5, 1], bounces, DISTANCES) < 1e-3
        size = rng.uniform([4, 3, 2.4], [9, 6, 3.5])
        plate = {"width_m": 0.5, "height_m": 0.7, "distance_m": 1.6}
        room = ul.scenes.room(tuple(size), material="concrete", plate=plate)
        assert differ(room, -0.47 * size, 0.47 * size, bounces, DISTANCES) < 1e-3


@pytest.mark.parametrize("world", ["cluttered-room", "cargo-hold"])
def test_worlds_of_balls_wires_edges_and_frames(world):
    scene = ul.load_scene(WORLDS[world].path)
    middle, span = scene.bounds.mean(0), np.ptp(scene.bounds, axis=0)
    assert differ(scene, middle - 0.3 * span, middle + 0.3 * span, 3, DISTANCES) < 1e-3


@pytest.mark.parametrize("size", [(8.0, 5.0, 2.4), (4.0, 3.5, 3.0)])
def test_two_walls_give_the_wave_of_their_one_image_wherever_the_antennas_are(size):
    """Over a large wall and a small one, in either order, it is lambda / (4 pi L) of the image in both."""
    ready, rng = (
        radar_context(ul.scenes.room(size, material="pec"), RADAR, edges=False),
        np.random.default_rng(4),
    )
    half = np.array(size) / 2
    for distance in DISTANCES:
        one, other = apart(rng, -0.8 * half, 0.8 * half, distance)
        laid = accumulate_bounces(radar_frame(ready, sent(one, other), None, 2))
        delay = np.concatenate([part.delay_s for part in laid])
        for signs in ((1, 1), (1, -1), (-1, 1), (-1, -1)):  # the four upright corners
            image = one.copy()
            image[:2] = 2 * half[:2] * signs - one[:2]
            length = np.linalg.norm(image - other)
            echo = np.concatenate([part.echo for part in laid])[abs(delay * 299792458 - length) < 1e-5].sum()
            assert abs(20 * np.log10(abs(echo) * 4 * np.pi * length / RADAR.wavelength_m)) < 0.2
