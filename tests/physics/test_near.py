"""A radar nearer to things than a wave: nothing passive returns more than it was sent, wherever the radar is."""

from dataclasses import replace

import numpy as np
import pytest

import ullage as ul
from ullage.kernels import near
from ullage.radar.physical import echoes, path_gain_cw

pytestmark = pytest.mark.filterwarnings("ignore::ullage.errors.UllageWarning")

ISOTROPIC = ul.RadarSpec.preset("x4m05", antenna={"kind": "isotropic"}, noise=None)
PATCHES = ul.RadarSpec.preset("x4m05", noise=None)
WAVE = ISOTROPIC.wavelength_m
ROOM = (6.0, 4.0, 3.0)
DISTANCES = np.concatenate([[0.0], 10.0 ** np.arange(-12, -4), 1e-4 * 2.0 ** np.arange(14)])


def still(places):
    """One frame at each place (n, 3), looking along x."""
    count = len(places)
    turn = np.tile([0.0, 0, 0, 1], (count, 1))
    rest = np.zeros((count, 3))
    return ul.Trajectory(np.arange(count) * 10**7, np.asarray(places, float), turn, rest, rest)


def gains_db(scene, places, radar=ISOTROPIC, bounces=1):
    gain = path_gain_cw(scene, still(places), radar, max_bounces=bounces)
    assert np.isfinite(gain).all()
    return 20 * np.log10(np.maximum(abs(gain), 1e-30))


def toward(point, way):
    return np.asarray(point) - DISTANCES[:, None] * np.asarray(way, float)


THINGS = {
    "plate": (lambda: ul.scenes.plate(width_m=1, height_m=1, distance_m=3, material="pec"), (3, 0, 0), (1, 0, 0)),
    "wire": (lambda: ul.scenes.wire(radius_m=0.002, length_m=1, distance_m=3), (2.998, 0, 0), (1, 0, 0)),
    "ball": (lambda: ul.scenes.sphere(radius_m=0.3, distance_m=3), (2.7, 0, 0), (1, 0, 0)),
    "pole": (lambda: ul.scenes.cylinder(radius_m=0.1, height_m=1, distance_m=3), (2.9, 0, 0), (1, 0, 0)),
    "wall": (lambda: ul.scenes.room(ROOM, material="pec"), (3, 0.3, 0.2), (1, 0, 0)),
    "corner": (lambda: ul.scenes.room(ROOM, material="pec"), (3, 2, 1.5), (1, 1, 1)),
}


@pytest.mark.parametrize("name", THINGS)
def test_nothing_returns_more_than_it_was_sent_and_less_from_farther_off(name):
    scene, point, way = THINGS[name]
    level = gains_db(scene(), toward(point, way))
    assert (level <= 0).all()
    assert level[DISTANCES < 1e-3].min() > -15  # in touch with a conductor much comes back
    beyond = level[(DISTANCES > WAVE / 8) & (DISTANCES < 0.5)]
    assert (np.diff(beyond) < 0).all()
    steps = np.diff(level[DISTANCES < 1e-3])
    assert abs(steps).max() < 1.5  # and no step on the way into it


def test_a_plate_is_the_exact_law_of_a_point_source_before_a_mirror_but_for_its_standing_wave():
    """A source of sound before a hard wall: with z = j e^{-jx} / x, x = 2 k d, its port reflects z / (2 - z)."""
    scene = THINGS["plate"][0]()
    distance = np.geomspace(1e-4, 2 * WAVE, 25)
    x = 4 * np.pi * distance / WAVE
    exact = -10 * np.log10(1 + 4 * x * x - 4 * x * np.sin(x))
    ours = gains_db(scene, np.array([3.0, 0, 0]) - distance[:, None] * np.array([1.0, 0, 0]))
    assert abs(ours - exact).max() < 4.5
    assert abs(ours - exact)[distance > WAVE].max() < 0.6


def test_a_wave_off_spreading_is_friis():
    wave = 2 * np.pi / WAVE
    for path in (WAVE, 2 * WAVE, 1.0, 10.0):
        for loss in (near.spread.py_func(wave, path) * path, near.eased.py_func(wave, path)):
            assert abs(20 * np.log10(loss)) < (1e-4 if path > WAVE else 1e-3)
    assert near.spread.py_func(wave, 0.0) == pytest.approx(2 * wave)
    assert WAVE / (4 * np.pi) * near.spread.py_func(wave, 0.0) == pytest.approx(1)


@pytest.mark.parametrize(
    "radar", [ISOTROPIC, PATCHES, ISOTROPIC.but(antenna_offset_m=0.06)], ids=["isotropic", "patches", "apart"]
)
def test_anywhere_close_to_the_faces_edges_and_corners_of_a_room(radar):
    rng = np.random.default_rng(5)
    half = np.array(ROOM) / 2
    places = rng.uniform(-half, half, (200, 3))
    sides = rng.choice([-1.0, 1.0], (200, 3))
    close = rng.permuted(np.arange(200)[:, None] % 3 >= np.arange(3), axis=1)  # to one, two or three walls
    gaps = rng.choice([0.0, 1e-9, 1e-6, 1e-4, 1e-3, 1e-2, 5e-2], (200, 3)) * rng.uniform(0.5, 1, (200, 3))
    places = np.where(close, sides * (half - gaps), places)
    frames = echoes(ul.scenes.room(ROOM, material="pec"), still(places), radar, max_bounces=3)
    assert np.isfinite(frames).all()
    assert abs(frames).max() <= 1
    assert abs(frames).max(1).min() > 1e-4


def test_exactly_on_edges_vertices_and_axes():
    plate, wire = THINGS["plate"][0](), THINGS["wire"][0]()
    box = ul.scenes.room(ROOM, plate={"width_m": 0.5, "height_m": 0.5, "distance_m": 2.0}, material="pec")
    for scene, places in (
        (plate, [(3, 0.5, 0), (3, 0.5, 0.5), (3, 0.51, 0), (3, 0.5 + 1e-12, 0)]),
        (wire, [(3, 0, 0), (3, 0, 0.5), (3, 0, 0.7), (2.998, 0, 0)]),
        (box, [(2, 0.25, 0), (2, 0.25, 0.25), (2, 0, 0), (3, 2, 0), (3, 2, 1.5), (2, 0.3, 0)]),
    ):
        level = gains_db(scene, places, bounces=3)
        assert (level <= 0).all()


@pytest.mark.parametrize("rms", [0.0, 0.0015])
def test_touching_what_is_no_conductor(rms):
    room = ul.scenes.room(ROOM, material="concrete")
    objects = tuple(replace(o, material=o.material.model_copy(update={"roughness_m": rms})) for o in room.objects)
    level = gains_db(replace(room, objects=objects), toward((3, 0.3, 0.2), (1, 0, 0)))
    assert (level < -3).all()
    assert level[DISTANCES < WAVE / 100].min() > -15
