"""From wall to wall inside a round tank: lengths, images, reciprocity, gaps, meshes, no steps (and test_oracles.py)."""

from dataclasses import replace

import numpy as np
import pytest
from radar_worlds import at, db
from scipy.spatial.transform import Rotation

import ullage as ul
from studies.validation.rows import radar
from ullage.radar.context import antenna_pair, radar_context, radar_frame
from ullage.radar.prepared import prepare
from ullage.radar.quadrics import quadrics_of, smooth_surfaces_of, walls_of
from ullage.radar.walls import accumulate_walls
from ullage.world import scenes
from ullage.world.scene import Scene


def only(scene, kept):
    return replace(scene, faces=scene.faces[kept], face_object=scene.face_object[kept])


def wall(radius=1.5, height=2.0, strips=96, material="pec"):
    """A tank without its floor."""
    tank = scenes.tank(radius, height, material, strips=strips)
    return only(tank, tank.face_object == 1)


def walls(scene, pose, spec, bounces=2):
    """What `accumulate_walls` alone lays on the grids, at the carrier, and how much of it there is."""
    context = radar_context(scene, spec)
    antennas = antenna_pair(spec, pose.position[0], ul.geometry.quat_matrix(pose.quat_xyzw)[0])
    echoes = accumulate_walls(radar_frame(context, antennas, None, bounces))
    return sum((part.echo.sum() for part in echoes), 0j)


def test_the_two_kinds_of_path_have_their_lengths():
    """There and back over both ends of a diameter is two diameters; a triangle about the axis is a little more."""
    radius, away = prepare(wall()).quadrics[0].radius, 0.6
    turn = np.linspace(np.pi / 3, np.pi / 2, 200001)
    apex = -radius * np.cos(turn) / np.cos(2 * turn)  # the radar whose triangle has its other corners at +-turn
    turn = turn[abs(apex - away).argmin()]
    half = radius * np.sin(turn)
    triangle = 2 * half + 2 * np.hypot(half, radius * np.cos(turn) + away)
    told = ul.explain(wall(), at(away, 0, 1.0), radar(), 0, max_bounces=2, count=50)
    ranges = [c.range_m for c in told if c.via == ("wall",)][:2]
    assert sorted(ranges) == pytest.approx([2 * radius, triangle / 2], abs=0.01)
    assert all(c.bounces == 2 and c.object == "wall" for c in told if c.via == ("wall",))


def test_sending_and_receiving_may_be_exchanged():
    spec = radar().but(antenna_offset_m=0.8)
    for scene, bounces in ((wall(), 2), (scenes.tank(1.5, 2.0, "concrete", strips=96), 3)):
        one, other = (walls(scene, at(0.2, 0.3, 0.7, roll_deg=r), spec, bounces) for r in (35, 215))
        assert abs(one) > 1e-4
        assert one == pytest.approx(other, rel=1e-6)


def test_antennas_hardly_apart_are_antennas_in_one_place():
    together, apart = (walls(wall(), at(0.2, 0.3, 0.7), radar().but(antenna_offset_m=d)) for d in (0.0, 1e-6))
    assert together == pytest.approx(apart, rel=1e-4)


@pytest.mark.parametrize("place", [(0.0, 0.05, 1.0), (0.9, 0.2, 1.0)])
def test_how_many_strips_a_wall_has_is_no_matter(place):
    """Strips of 15 and 4 cm, the same in the mean; chords lie inside the round by 2 mm and less."""
    coarse, fine = (abs(ul.simulate(wall(1.5 / (1 - np.pi**2 / (3 * n**2)), strips=n), at(*place), radar(),
                                    max_bounces=2).samples[0])[52:].max() for n in (64, 256))  # fmt: skip
    assert db(coarse / fine) == pytest.approx(0, abs=1.0)


def test_wide_strips_mirror_each_other_instead():
    """Facets of 1 m that meet at 15 deg are done as flat mirrors, and then not by this."""
    assert walls(wall(4.0, strips=24), at(1.0, 0.3, 1.0), radar()) == 0
    assert walls(wall(4.0, strips=96), at(1.0, 0.3, 1.0), radar()) != 0


@pytest.mark.parametrize("middle", [0.0, 0.5])  # the axis; where the far wall has the image of the radar on it
def test_nothing_jumps_along_a_track(middle):
    """Millimetre by millimetre over the axis and the focus: no step is more than what 2 k of path turn allows."""
    spec = radar()
    x = middle + np.arange(-8, 9) * 1e-3
    found = np.array([walls(wall(), at(here, 0.0, 0.8), spec) for here in x])
    assert (abs(np.diff(found)) < 0.25 * abs(found).max()).all()
    assert (abs(found[:-2] - 2 * found[1:-1] + found[2:]) < 0.05 * abs(found).max()).all()


def test_no_more_comes_back_than_was_sent():
    for place in ((0.0, 0.0, 1.0), (0.0, 1e-4, 1.0), (1.0, 0.0, 0.1), (1.49, 0.0, 1.0)):
        assert abs(walls(wall(), at(*place), radar(), 3)) < 0.1


def test_a_lying_tank_is_an_upright_one_turned():
    """Tank and radar tipped over together, by an odd angle: nothing changes but what the wall's own axes are called."""
    tank, place, spec = scenes.tank(1.5, 2.0, "pec", strips=96), np.array([0.5, 0.2, 0.7]), radar()
    turn = Rotation.from_rotvec([0.3, 1.4, 0.2])
    tipped = replace(tank, vertices=turn.apply(tank.vertices))
    lying = replace(ul.Trajectory.stationary(turn.apply(place)), quat_xyzw=turn.as_quat()[None])
    upright = walls(tank, at(*place), spec, 3)
    assert abs(upright) > 1e-4
    assert walls(tipped, lying, spec, 3) == pytest.approx(upright, rel=1e-3)


def test_a_floor_turns_the_climb_back():
    """Over a floor the receiver is heard at its image, in a wall as high again below; upright fields stay."""
    spec, deep = radar(), wall(1.5, 4.0)
    deep = replace(deep, vertices=deep.vertices - [0, 0, 2.0])
    tank, rolled = scenes.tank(1.5, 2.0, "pec", strips=96), radar("horizontal").but(antenna_offset_m=1.2)
    with_floor, without = (walls(world, at(0.5, 0.2, 0.6), spec, 3) for world in (tank, wall()))
    apart = walls(deep, at(0.5, 0.2, 0.0, roll_deg=90), rolled)
    assert with_floor - without == pytest.approx(apart, rel=0.05)


def test_below_its_floor_a_wall_is_its_own_image():
    """However far it goes on behind the floor."""
    spec, rolled = radar(), radar("horizontal").but(antenna_offset_m=1.0)
    tank, image = scenes.tank(1.5, 2.0, "pec", strips=96), wall(1.5, 3.0)
    floor = only(tank, tank.face_object == 0)
    floor = replace(floor, vertices=floor.vertices + np.array([0, 0, 0.5]))
    image = replace(image, vertices=image.vertices - [0, 0, 1.0])
    with_floor, without = (walls(world, at(0.5, 0.2, 1.0), spec, 3) for world in (Scene.union([wall(), floor]), wall()))
    apart = walls(image, at(0.5, 0.2, 0.5, roll_deg=90), rolled)
    assert with_floor - without == pytest.approx(apart, rel=0.05)


def test_what_is_not_there_mirrors_nothing_and_what_stands_between_hides():
    """Iterated physical optics without the near end of the diameter, 1.2 m of it, keeps 12 dB less of a pulse."""
    scene, pose = wall(), at(0.5, 0.0, 1.0)
    middle = scene.corners().mean(1)
    ends = only(scene, abs(np.arctan2(middle[:, 1], middle[:, 0])) > 0.4)
    fence = Scene.of_mesh(np.array([[-0.9, -0.3, 0], [-0.9, 0.3, 0], [-0.9, 0.3, 2], [-0.9, -0.3, 2.0]]),
                          np.array([[0, 1, 2], [0, 2, 3]]), name="fence", made_of="pec")  # fmt: skip

    def heard(world, away):
        told = ul.explain(world, pose, radar(), 0, max_bounces=2, count=100)
        return max(c.path_gain_db for c in told if c.via == ("wall",) and abs(c.range_m - away) < 0.05)

    for cut in (ends, Scene.union([scene, fence])):
        assert heard(cut, 3.0) < heard(scene, 3.0) - 8
        assert heard(cut, 3.15) == pytest.approx(heard(scene, 3.15), abs=1.0)  # the triangle keeps clear of both


def test_outside_of_a_drum_and_in_a_room_there_is_none():
    drum = scenes.cylinder(0.5, 1.0, 2.0)
    assert len(prepare(drum).quadrics) == 1
    assert walls(drum, at(0, 0, 0), radar()) == 0
    assert prepare(scenes.room((4, 3, 2))).quadrics == ()


def test_which_surfaces_are_round_walls():
    def found(scene):
        surfaces = smooth_surfaces_of(scene, np.ones(len(scene.faces), bool))
        return quadrics_of(surfaces, walls_of(surfaces))

    lying = scenes.cylinder(1.3, 3.0, 0.5, tilt_deg=70, edge_m=0.1)
    (one,) = found(lying)
    lean = np.deg2rad(70)
    assert abs(one.axes[2] @ [0, -np.sin(lean), np.cos(lean)]) == pytest.approx(1, abs=1e-9)
    assert one.radius == pytest.approx(1.3, abs=1.5e-3)
    assert one.high - one.low == pytest.approx(3.0)
    assert one.local(np.array([0.5, 0, 0]))[:2] == pytest.approx([0, 0], abs=1e-6)
    (ball,) = found(scenes.sphere(0.5, 0.0))
    assert ball.is_sphere
    for other in (scenes.cylinder(0.05, 1.0, 0.0), scenes.room((4, 3, 2))):
        assert found(other) == ()
    squeezed = replace(lying, vertices=lying.vertices * [1.0, 0.9, 1.0])
    assert found(squeezed) == ()
