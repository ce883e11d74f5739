"""Over two round bodies and a flat face: what a mirrored world gives, reciprocity, edges of the face, names."""

from dataclasses import replace

import numpy as np
import pytest
from radar_worlds import at

import ullage as ul
from studies.validation.rows import radar
from ullage.geometry import quat_matrix
from ullage.radar.context import antenna_pair, radar_context, radar_frame
from ullage.radar.fermat import accumulate_fermat
from ullage.world import scenes
from ullage.world.scene import Scene


def body(kind, centre, name):
    made = {"ball": scenes.sphere(0.3, 0.0, edge_m=0.06), "drum": scenes.cylinder(0.3, 1.6, 0.0, edge_m=0.06)}[kind]
    made = replace(made, vertices=made.vertices + np.array(centre))
    return replace(made, objects=tuple(replace(o, name=name) for o in made.objects))


def side_wall(length=8.0, middle=0.0):
    """A wall along x at y = -1.2."""
    corners = [[-length / 2, -1.2, -2], [length / 2, -1.2, -2], [length / 2, -1.2, 2], [-length / 2, -1.2, 2]]
    return Scene.of_mesh(np.array(corners) + np.array([middle, 0, 0]), np.array([[0, 1, 2], [0, 2, 3]]), name="wall",
                         made_of="pec")  # fmt: skip


FIRST, LAST = (2.0, 0.6, 0.1), (2.5, -0.3, -0.1)


def world(kinds, *walls):
    return Scene.union([body(kind, place, name) for kind, place, name in zip(kinds, (FIRST, LAST), "ab", strict=False)]
                       + list(walls))  # fmt: skip


def heard(scene, pose, spec, bounces=3, antennas=None):
    """What `accumulate_fermat` alone lays on the grids in some number of bounces: each echo that is not 0."""
    context = radar_context(scene, spec)
    antennas = antennas or antenna_pair(spec, pose.position[0], quat_matrix(pose.quat_xyzw)[0])
    frame = radar_frame(context, antennas, None, 3)
    vars(frame)["sizes"] = frame.sizes * (frame.planar.widths.min(1, initial=9) > 1)
    echoes = accumulate_fermat(frame)
    return {
        (*(int(k) for k in part.via[i]), int(part.object_ids[i]), int(before)): part.echo[i]
        for part in echoes
        for i, before in enumerate(part.before)
        if part.echo[i] and (part.via[i] >= 0).sum() == bounces - 1
    }


@pytest.mark.parametrize("kinds", [("ball", "ball"), ("drum", "ball"), ("drum", "drum")])
def test_a_wall_is_the_world_mirrored_in_it(kinds):
    """Between: the second body is where its image is, heard at the radar's image. Fields upright keep their sign."""
    spec, pose = radar(), at(0, 0, 0)
    over = heard(world(kinds, side_wall()), pose, spec)
    image = body(kinds[1], np.array([2.5, -2.1, -0.1]), "b")
    antennas = antenna_pair(spec, np.zeros(3), np.eye(3))
    turned = replace(antennas, origins=np.array([[0, 0, 0], [0, -2.4, 0.0]]))
    free = heard(Scene.union([body(kinds[0], FIRST, "a"), image]), pose, spec, 2, turned)
    assert abs(free[0, -1, 1, 1]) > 1e-6
    assert over[0, 2, 1, 2] == pytest.approx(-2 * free[0, -1, 1, 1], rel=0.03)  # twice: both ways round


@pytest.mark.parametrize("kinds", [("ball",), ("drum",)])
def test_a_body_before_a_wall_has_its_own_image_for_the_other(kinds):
    """There over the body, the wall and back to it: once, and mirrored about the wall."""
    over = heard(world(kinds, side_wall()), at(0, 0, 0.1), radar())
    image = body(kinds[0], (2.0, -3.0, 0.1), "b")
    apart = np.array([[0, 0, 0.1], [0, -2.4, 0.1]])
    turned = replace(antenna_pair(radar(), apart[0], np.eye(3)), origins=apart)
    free = heard(Scene.union([body(kinds[0], FIRST, "a"), image]), at(0, 0, 0.1), radar(), 2, turned)
    assert over[0, 1, 0, 2] == pytest.approx(-free[0, -1, 1, 1], rel=0.03)


@pytest.mark.parametrize("kinds", [("ball", "ball"), ("drum", "ball")])
def test_sending_and_receiving_may_be_exchanged(kinds):
    spec, scene = radar().but(antenna_offset_m=0.4), world(kinds, side_wall())
    one, other = (sum(heard(scene, at(0, 0, 0, roll_deg=r), spec).values()) for r in (35, 215))
    assert abs(one) > 1e-5
    assert one == pytest.approx(other, rel=1e-6)
    together, hardly = (sum(heard(scene, at(0, 0, 0), radar().but(antenna_offset_m=d)).values()) for d in (0.0, 1e-6))
    assert together == pytest.approx(hardly, rel=1e-4)


def test_where_the_face_ends_there_is_no_mirror_and_what_stands_between_hides():
    whole = heard(world(("drum", "drum"), side_wall()), at(0, 0, 0), radar())
    assert {key[3] for key in whole if 2 in key[:2]} == {2}
    ended = heard(world(("drum", "drum"), side_wall(3.0, -4.0)), at(0, 0, 0), radar())
    assert all(2 not in key[:2] for key in ended)
    fence = Scene.of_mesh(np.array([[-1, -0.9, -2], [4, -0.9, -2], [4, -0.9, 2], [-1, -0.9, 2.0]]),
                          np.array([[0, 1, 2], [0, 2, 3]]), name="fence", made_of="pec")  # fmt: skip
    behind = heard(world(("drum", "drum"), side_wall(), fence), at(0, 0, 0), radar())
    assert all(2 not in key[:2] for key in behind)


def test_explain_names_all_three():
    told = ul.explain(world(("drum", "ball"), side_wall()), at(0, 0, 0), radar(), 0, max_bounces=3, count=None)
    assert any(set(c.path) == {"a", "b", "wall"} for c in told)
    apart = ul.explain(world(("drum", "ball"), side_wall()), at(0, 0, 0), radar().but(antenna_offset_m=0.4), 0,
                       max_bounces=3, count=None)  # fmt: skip
    assert {c.path[0] for c in apart if set(c.path) == {"a", "b", "wall"}} >= {"a", "wall"}
