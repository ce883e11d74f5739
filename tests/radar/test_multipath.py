"""Mirrors: how much they pass on, and how they are chosen."""

from dataclasses import replace

import numpy as np
import pytest

import ullage as ul
from ullage.kernels import bounces
from ullage.radar import multipath
from ullage.radar.context import antenna_pair, radar_context, radar_frame
from ullage.radar.multipath import between
from ullage.radar.physical import path_gain_cw
from ullage.radar.prepared import prepare
from ullage.world import shapes
from ullage.world.scene import Scene
from ullage.world.solids import flat


def covered(widths, before=4.0, after=6.0, wavelength=0.04):
    """Share that one facing mirror passes on, `before` metres away and `after` metres from the last face."""
    path = np.array([[[0, 0, 0], [0, 0, 0], [before, 0, 0], [before - after, 0, 0], [0, 0, 0]]], float)
    out = np.ones(1)
    chain = np.array([[0, -1]])
    bounces.cover(path, chain, np.array([[1.0, 0, 0]]), np.array([widths], float), wavelength, np.empty(3), out)
    return out[0]


def test_a_small_mirror_passes_on_the_area_kirchhoff_gives_it():
    size, before, after, wavelength = 0.03, 4.0, 6.0, 0.04
    kirchhoff = size**2 * (before + after) / (wavelength * before * after)
    assert covered((size, size), before, after, wavelength) == pytest.approx(kirchhoff, rel=1e-9)


def test_a_large_mirror_passes_on_everything_and_a_strip_its_width():
    assert covered((5.0, 5.0)) == 1.0
    zone = np.sqrt(0.04 * 4 * 6 / 10)
    assert covered((30.0, 0.1 * zone)) == pytest.approx(0.1)


def test_clutter_of_small_boxes_on_the_wall_does_not_change_the_third_order_of_a_room():
    radar = ul.RadarSpec.preset("x4m05", noise=None)
    room = ul.scenes.room((6, 4, 3), material="concrete")
    vertices, faces = shapes.box((0.06, 0.06, 0.06))
    spots = [(2.9, y, z) for y in (-1.5, -0.5, 0.5, 1.5) for z in (-1.0, 1.0)]
    boxes = [Scene.of_mesh(vertices + np.array(at), faces, name=f"box_{i}") for i, at in enumerate(spots)]
    path = ul.Trajectory.stationary(position_m=(0.3, 0.2, 0.1), yaw_deg=180)

    def third(scene):
        one = [ul.simulate(scene, path, radar, max_bounces=order).samples[0] for order in (1, 3)]
        return one[1] - one[0]

    empty, cluttered = third(room), third(Scene.union([room, *boxes]))
    assert abs(cluttered - empty).max() < 0.1 * abs(empty).max()


def test_a_wall_with_a_round_hole_takes_the_place_of_no_other_mirror():
    """Its convex parts are many, and as large as each other by the size of the wall."""
    shapely = pytest.importorskip("shapely")
    radar = ul.RadarSpec.preset("x4m05", noise=None)
    front = ul.scenes.plate(5, 2, 2.5, name="front")
    side = replace(ul.scenes.plate(5, 2, 2.5, name="side"), vertices=front.vertices[:, [1, 0, 2]])
    corner, path = Scene.union([front, side]), ul.Trajectory.stationary(position_m=(0.1, -0.2, 0.05), yaw_deg=45)

    def twice(hole):
        wall = flat(shapely.box(-2, -2, 2, 2) - hole, lambda uv: np.column_stack([np.full(len(uv), -1.0), uv]))
        scene = Scene.union([corner, Scene.of_mesh(*wall, name="wall")])
        one = [ul.simulate(scene, path, radar, max_bounces=order).samples[0] for order in (1, 2)]
        return (one[1] - one[0])[radar.range_m > 3.0]

    whole, holed = twice(shapely.Point(0, 0).buffer(0)), twice(shapely.Point(1.2, 1.2).buffer(0.4, quad_segs=24))
    assert abs(holed - whole).max() < 0.03 * abs(whole).max()


def test_the_choice_of_mirrors_changes_nothing_suddenly(monkeypatch):
    monkeypatch.setattr(multipath, "MIRRORS", 3)
    radar = ul.RadarSpec.preset("x4m05", noise=None, antenna={"kind": "isotropic"})
    room = ul.scenes.room((6, 4, 3), material="steel")
    path = ul.Trajectory.line((0.2, -0.04, 0.1), (0.2, 0.04, 0.1), 0.5, 1250)
    planar = prepare(room).still.planar
    context, sets = radar_context(room, radar), set()
    for place in path.position[::25]:
        sizes = radar_frame(context, antenna_pair(radar, place, np.eye(3))).sizes
        sets.add(tuple(multipath.choose_largest(sizes)[0]))
    both = [ul.simulate(room, path, radar, max_bounces=order).samples for order in (1, 2)]
    samples = both[1] - both[0]
    step = abs(np.diff(samples, axis=0)).max(1)
    assert len(planar) > 3
    assert len(sets) > 1
    assert step.max() < 0.15 * abs(samples).max()


def test_between_sees_walls_but_not_the_surfaces_at_its_ends():
    room = prepare(ul.scenes.room((6, 4, 3))).still
    a = np.array([[-3.0, 0, 0], [-3.5, 0, 0]])
    b = np.array([[3.0, 0, 0], [3.0, 0, 0]])
    np.testing.assert_array_equal(between([room], a, b), [True, False])


def test_paths_are_free_where_all_their_legs_are_and_only_wanted_ones_are_asked():
    plated = ul.scenes.room((6, 4, 3), plate={"width_m": 0.5, "height_m": 0.5, "distance_m": 2.0})
    parts = radar_context(plated, ul.RadarSpec.preset("x4m05", noise=None)).world.parts(None)
    a, left, right, behind = [-1.0, 0, 0], [1.0, 1.9, 0.2], [1.0, -1.9, 0.2], [2.8, 0.0, 0.0]  # the plate is before it
    paths = np.array(
        [
            [a, a, left, right, a],
            [a, left, right, left, a],
            [a, a, left, behind, a],
            [a, behind, left, right, a],
            [a, a, left, right, a],
        ]
    )
    assert multipath.clear(parts, paths, np.array([1.0, 0.3, 1, 1, 0])).tolist() == [True, True, False, False, False]


@pytest.mark.parametrize("height", [-0.31, 0.0, 0.42])
def test_a_face_that_a_beam_only_touches_passes_nothing_on(height):
    """Behind a ridge no wave goes from side to side, and none over the ridge as a mirror of no width."""
    ridge, left, right = np.array([2.1, 0.13, 0.0]), np.array([2.9, 1.33, 0.0]), np.array([3.3, -0.87, 0.0])
    low, high = np.array([0, 0, -1.37]), np.array([0, 0, 1.61])
    vertices = np.array([v + h for v in (ridge, left, right) for h in (low, high)])
    faces = np.array([[0, 2, 1], [1, 2, 3], [0, 1, 4], [4, 1, 5]])
    roof = Scene(vertices, faces, np.zeros(4, np.int32), ul.scenes.plate(1, 1, 1).objects[:1])
    scene = Scene.union([roof, ul.scenes.room((9, 8, 6))])
    planar = prepare(scene).still.planar
    radar = ul.RadarSpec.preset("x4m05", noise=None)
    antennas = antenna_pair(radar, np.array([0.3, 0.2, height]), np.eye(3))
    context = radar_context(scene, radar)
    beams = multipath.beams_of(radar_frame(context, antennas, None, 3), antennas)
    sides = np.flatnonzero(planar.object_ids == 0)
    assert len(sides) == 2
    assert np.isin(beams.chains, sides).any()
    assert not np.isin(beams.chains, sides).all(1).any()


@pytest.mark.parametrize(("polarization", "within"), [("vertical", 0.015), ("horizontal", 0.06)])
@pytest.mark.parametrize("name", ["concrete", "wet-ground", "water"])  # thick: their slabs have one face
def test_a_corner_of_dielectric_returns_the_square_of_fresnel_s_coefficient(name, polarization, within):
    """Two bounces at 45 deg; the field lies along both faces' edge (TE) or in the plane of incidence (TM)."""
    spec = ul.RadarSpec.preset("x4m05", noise=None, antenna={"kind": "isotropic", "polarization": polarization})

    def peak(material):
        corner = ul.scenes.dihedral(edge_m=0.3, distance_m=4.0, material=material)
        return abs(ul.simulate(corner, ul.Trajectory.stationary(), spec, max_bounces=2).samples[0]).max()

    corner = ul.scenes.dihedral(edge_m=0.3, distance_m=4.0, material=name)
    eps = corner.objects[0].material.permittivity(spec.center_hz)
    cosine, slant = np.cos(np.pi / 4), np.sqrt(eps - 0.5)
    te, tm = (cosine - slant) / (cosine + slant), (eps * cosine - slant) / (eps * cosine + slant)
    expected = abs(te if polarization == "vertical" else tm) ** 2
    assert peak(name) / peak("pec") == pytest.approx(expected, rel=within)


@pytest.mark.parametrize("waves", [2.0, 2.5, 3.0, 5.0])
def test_a_dihedral_of_any_size_has_its_radar_cross_section(waves):
    """On its axis 8 pi a^4 / lambda^2, down to faces of two wavelengths."""
    spec = ul.RadarSpec.preset("x4m05", noise=None, antenna={"kind": "isotropic", "polarization": "horizontal"})
    edge, away = waves * spec.wavelength_m, 5.0
    echo = path_gain_cw(ul.scenes.dihedral(edge, away), ul.Trajectory.stationary(), spec, max_bounces=2)[0]
    section = 8 * np.pi * edge**4 / spec.wavelength_m**2
    want = spec.wavelength_m * np.sqrt(section) / (4 * np.pi) ** 1.5 / away**2
    assert 20 * np.log10(abs(echo) / want) == pytest.approx(0, abs=0.4)


@pytest.mark.parametrize("waves", [2.0, 2.5, 3.0, 5.0])
def test_a_trihedral_of_square_plates_has_its_radar_cross_section(waves):
    """On its axis 12 pi a^4 / lambda^2."""
    spec = ul.RadarSpec.preset("x4m05", noise=None, antenna={"kind": "isotropic"})
    edge, away = waves * spec.wavelength_m, 5.0
    echo = path_gain_cw(square_trihedral(edge, away), ul.Trajectory.stationary(), spec, max_bounces=3)[0]
    section = 12 * np.pi * edge**4 / spec.wavelength_m**2
    want = spec.wavelength_m * np.sqrt(section) / (4 * np.pi) ** 1.5 / away**2
    assert 20 * np.log10(abs(echo) / want) == pytest.approx(0, abs=0.4)


def square_trihedral(edge, away):
    """Three square plates whose common corner lies `away` ahead on the axis of symmetry."""
    shape = ul.scenes.trihedral(edge, away)
    apex, (a, b, c) = shape.vertices[0], shape.vertices[1:4] - shape.vertices[0]
    vertices = apex + np.array([0 * a, a, b, c, a + b, b + c, c + a])
    faces = np.array([[0, 1, 4], [0, 4, 2], [0, 2, 5], [0, 5, 3], [0, 3, 6], [0, 6, 1]])
    return Scene(vertices, faces, np.zeros(6, np.int32), shape.objects)


def test_between_two_plates_each_order_is_the_mirror_at_its_image():
    """Exact for endless plates: odd orders have an image on either side, even ones the same image twice."""
    radar = ul.RadarSpec.preset("x4m05", noise=None, antenna={"kind": "isotropic"})
    apart, place = 1.3, 0.5
    vertices, faces = shapes.box((0.1, 12, 12))
    plates = [
        Scene.of_mesh(vertices + np.array([x, 0, 0]), faces, name="plate", material="pec")
        for x in (-0.05, apart + 0.05)
    ]
    frame = abs(
        ul.simulate(Scene.union(plates), ul.Trajectory.stationary((place, 0.1, 0.2)), radar, max_bounces=6).samples[0]
    )
    orders = {1: (place, apart - place), 2: (apart,), 3: (place + apart, 2 * apart - place), 4: (2 * apart,),
              5: (place + 2 * apart, 3 * apart - place), 6: (3 * apart,)}  # fmt: skip
    for order, ranges in orders.items():
        for range_m in ranges:
            at = abs(radar.range_m - range_m).argmin()
            want = radar.wavelength_m / (8 * np.pi * range_m) * (2 if order % 2 == 0 else 1)
            assert 20 * np.log10(frame[at - 3 : at + 4].max() / want) == pytest.approx(0, abs=0.7)
