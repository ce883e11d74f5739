"""Over a tank's wall and a ball or drum in it: second derivatives, exact series, integrals, reciprocity, floors."""

from dataclasses import replace

import numpy as np
import pytest
from radar_worlds import at, body, onto

import ullage as ul
from studies.validation.rows import radar
from studies.validation.validate import gain_over_wall
from ullage.radar.context import antenna_pair, radar_context, radar_frame
from ullage.radar.prepared import prepare
from ullage.radar.walls import TO_AND_FRO, WALL_FIRST, accumulate_walls, lines_over
from ullage.world import scenes
from ullage.world.scene import Scene

WALL = replace(body((0, 0, 0), 1.5, ball=False, object_id=0), axes=np.eye(3))


def tank(thing, height=3.0):
    """A ball or a drum in a tank of 1.5 m."""
    made = {"ball": scenes.sphere(0.3, 0.0, edge_m=0.06, name="thing"),
            "drum": scenes.cylinder(0.3, 1.6, 0.0, edge_m=0.06, name="thing")}[thing]  # fmt: skip
    made = replace(made, vertices=made.vertices + np.array([0.8, 0.0, 1.5]))
    return Scene.union([scenes.tank(1.5, height, "pec", strips=96), made])


def heard(scene, pose, spec, bounces):
    """What `accumulate_walls` lays on the grids over the thing in a tank, echo by echo."""
    context = radar_context(scene, spec)
    antennas = antenna_pair(spec, pose.position[0], ul.geometry.quat_matrix(pose.quat_xyzw)[0])
    return over_thing(scene, accumulate_walls(radar_frame(context, antennas, None, bounces)))


def over_thing(scene, echoes):
    thing = len(scene.objects) - 1
    return [part for part in echoes if (part.object_ids == thing).any() or (part.via == thing).any()]


def total(echoes):
    return sum((part.echo.sum() for part in echoes), 0j)


@pytest.mark.parametrize("walls", [WALL_FIRST, TO_AND_FRO])
@pytest.mark.parametrize("ball", [True, False])
def test_spread_and_slope_are_those_of_differences_of_the_path(ball, walls):
    """By steps along the line and over the body, which leans; each line's path is the shortest."""
    ends = np.array([[-0.5, 0.2, 0.1], [-0.4, 0.3, -0.2]])
    thing = body((0.8, 0.1, 0.3), 0.3, ball=ball, axis=(0, 0.2, 1), object_id=1)
    found = lines_over(WALL, thing, ends, walls)
    i = int(np.flatnonzero(found.spread)[found.spread.astype(bool).sum() // 3])
    corners, wall_at = found.corners[:, i], walls.index(True)
    moves = [np.array([[0, 0, 1.0]]) if wall else np.linalg.svd(found.normals[s, i][None])[2][1:]
             for s, wall in enumerate(walls)]  # fmt: skip
    starts = np.cumsum([0, *(len(m) for m in moves)])

    def length(step, turn=0.0):
        stops = [p + step[starts[s] : starts[s + 1]] @ moves[s] for s, p in enumerate(corners[1:-1])]
        stops = [p if wall else onto(thing, p) for wall, p in zip(walls, stops, strict=True)]
        cosine, sine = np.cos(turn), np.sin(turn)
        stops[wall_at] = np.array([[cosine, -sine, 0], [sine, cosine, 0], [0, 0, 1]]) @ stops[wall_at]
        return sum(np.linalg.norm(b - a) for a, b in zip((ends[0], *stops), (*stops, ends[1]), strict=True))

    tiny, axes = 1e-4, np.eye(starts[-1])
    slopes = [(length(tiny * a) - length(-tiny * a)) / (2 * tiny) for a in axes]
    bends = [[(length(tiny * (a + b)) - length(tiny * (a - b)) - length(tiny * (b - a)) + length(-tiny * (a + b)))
              / (4 * tiny**2) for a in axes] for b in axes]  # fmt: skip
    legs = np.diff(corners, axis=0)
    sizes = np.linalg.norm(legs, axis=1)
    cosines = [-legs[s] @ found.normals[s, i] / sizes[s] for s in range(len(walls))]
    out = legs[wall_at + 1] @ found.normals[wall_at, i] / sizes[wall_at + 1]
    cosines[wall_at] = (cosines[wall_at] + out) / 2
    assert found.length[i] == pytest.approx(length(np.zeros(starts[-1])), rel=1e-12)
    assert np.max(np.abs(slopes)) < 1e-6
    assert found.spread[i] == pytest.approx(np.prod(cosines) / np.prod(sizes) / np.sqrt(np.linalg.det(bends)), rel=1e-3)
    turned = (length(np.zeros(starts[-1]), tiny) - length(np.zeros(starts[-1]), -tiny)) / (2 * tiny * WALL.radius)
    assert found.slope[i] == pytest.approx(turned, abs=1e-6)


@pytest.mark.parametrize("thing", ["ball", "drum"])
def test_sending_and_receiving_may_be_exchanged(thing):
    spec = radar().but(antenna_offset_m=0.6)
    for bounces in (2, 3):
        one, other = (total(heard(tank(thing), at(-0.4, 0.2, 1.2, roll_deg=r), spec, bounces)) for r in (35, 215))
        assert abs(one) > 1e-4
        assert one == pytest.approx(other, rel=1e-6)


@pytest.mark.parametrize("thing", ["ball", "drum"])
def test_antennas_hardly_apart_are_antennas_in_one_place(thing):
    together, apart = (total(heard(tank(thing), at(-0.4, 0.2, 1.2), radar().but(antenna_offset_m=d), 3))
                       for d in (0.0, 1e-6))  # fmt: skip
    assert together == pytest.approx(apart, rel=1e-3)


AROUND = ((-0.4, 0.2, 1.2), (-0.3, 0.3, 1.1), (-0.6, 0.1, 1.3), (-0.4, -0.3, 1.0), (0.1, 0.6, 1.2))


def test_a_floor_is_the_image_of_what_it_mirrors():
    off = [off_the_image(np.array(place)) for place in AROUND]
    assert np.median(off) < 0.05
    assert max(off) < 0.15  # where its ways half cancel


def off_the_image(place):
    """Over it either antenna is heard from its image, in a wall as high again below; the drum ends in the air."""
    scene, spec = tank("ball"), radar()
    wall = scenes.tank(1.5, 6.0, "pec", strips=96)
    wall = replace(wall, faces=wall.faces[wall.face_object == 1], face_object=wall.face_object[wall.face_object == 1])
    ball = scenes.sphere(0.3, 0.0, edge_m=0.06, name="thing")
    ball = replace(ball, vertices=ball.vertices + np.array([0.8, 0.0, 1.5]))
    deep = Scene.union([replace(wall, vertices=wall.vertices - [0, 0, 3.0]), ball])
    context = radar_context(deep, spec)
    both = [place * [1, 1, -1], place]
    antennas = replace(antenna_pair(spec, place, np.eye(3)), origins=np.array(both))
    echoes = accumulate_walls(radar_frame(context, antennas, None, 2))
    want = total(over_thing(deep, echoes))  # both orders, image to radar; radar to image is as much
    floor = [part for part in heard(scene, at(*place), spec, 3) if ((part.via >= 0).sum(1) == 2).all()
             and (part.via[:, 0] != part.object_ids).all()]  # fmt: skip
    assert abs(want) > 1e-5
    return abs(total(floor) / (2 * want) - 1)


def test_what_stands_between_hides():
    scene, pose, spec = tank("drum"), at(-0.4, 0.2, 1.5), radar()
    fence = Scene.of_mesh(np.array([[0.3, -0.6, 0], [0.3, 0.6, 0], [0.3, 0.6, 3], [0.3, -0.6, 3.0]]),
                          np.array([[0, 1, 2], [0, 2, 3]]), name="fence", made_of="pec")  # fmt: skip
    assert abs(gain_over_wall(scene, pose, spec, 2)) > 1e-4
    hidden = gain_over_wall(Scene.union([scene, fence]), pose, spec, 2)
    assert abs(hidden) < 0.3 * abs(gain_over_wall(scene, pose, spec, 2))


@pytest.mark.parametrize("middle", [0.0, 0.4])
def test_nothing_jumps_along_a_track(middle):
    """Millimetre by millimetre: no step is more than what 2 k of path turn allows."""
    spec, scene = radar(), tank("drum")
    found = np.array([gain_over_wall(scene, at(middle + d, 0.5, 1.5), spec, 2) for d in np.arange(-8, 9) * 1e-3])
    assert (abs(np.diff(found)) < 0.35 * abs(found).max()).all()
    assert (abs(found[:-2] - 2 * found[1:-1] + found[2:]) < 0.15 * abs(found).max()).all()


def test_explain_tells_both_orders_and_there_and_back():
    told = ul.explain(tank("ball"), at(-0.4, 0.2, 1.2), radar(), 0, max_bounces=3, count=None)
    paths = {c.path for c in told}
    assert {("wall", "thing"), ("thing", "wall", "thing")} <= paths
    assert any(set(path) == {"wall", "thing", "floor"} for path in paths)
    spec = radar().but(antenna_offset_m=0.6)
    apart = {c.path for c in ul.explain(tank("ball"), at(-0.4, 0.2, 1.2), spec, 0, max_bounces=2, count=None)}
    assert {("wall", "thing"), ("thing", "wall")} <= apart


def test_outside_of_the_wall_or_without_one_there_is_none():
    scene = tank("ball")
    assert len(prepare(scene).quadrics) == 2
    assert heard(scene, at(-4.0, 0, 1.0), radar(), 3) == []
    assert heard(scene, at(0.8, 0, 1.5), radar(), 3) == []  # in the ball


@pytest.mark.parametrize("walls", [WALL_FIRST, TO_AND_FRO])
@pytest.mark.parametrize("near", ["radar", "body"])
def test_lines_along_the_wall_are_as_close_as_a_cubic_between_them_needs(near, walls):
    """Every second line, foretold by a cubic through its neighbours, is under a hundredth of a wave of 4 cm off.

    A cubic is off by the fourth power of the spacing, so at the true spacing it is 16 times better than here. What is
    far from the wall needs no more lines than the fewest.
    """
    counts = []
    for gap in (0.1, 0.2, 0.4, 0.6, 0.9):
        ends = np.array([[-1.5 + (gap if near == "radar" else 1.0), 0.0, 0.1]] * 2)
        thing = body((1.2 - gap if near == "body" else 0.2, 0.05, 0.1), 0.3, ball=True, object_id=1)
        length = lines_over(WALL, thing, ends, walls).length
        even, odd = length[: len(length) // 2 * 2 : 2], length[1::2]
        foretold = (-np.roll(even, 1) + 9 * even + 9 * np.roll(even, -1) - np.roll(even, -2)) / 16
        assert abs(foretold - odd)[2:-3].max() / 16 < 0.04 / 100
        counts.append(len(length))
    assert counts == sorted(counts, reverse=True)
    assert counts[0] > 2 * counts[-1]
    assert counts[-2] == counts[-1] <= 64
