"""Over balls, drums and planes in any order: second derivatives, dense integrals, images, reciprocity, shadow."""

from dataclasses import replace

import numpy as np
import pytest
import radar_worlds
from radar_worlds import body, db

import ullage as ul
from studies.validation.rows import gain_via, radar
from ullage.kernels.fermat import CYLINDER, SPHERE, Chains, Limits, Reflectors, may_be_strong
from ullage.radar.fermat import fermat_paths
from ullage.radar.prepared import prepare
from ullage.radar.reflectors import bodies_of, joined, plane_set, points_of
from ullage.world import scenes
from ullage.world.scene import Scene

WAVE = 2 * np.pi * 7.29e9 / 299792458


WALL_Y = -1.2


def wall():
    """A plane at y = -1.2 as a reflector."""
    return plane_set(np.array([[0.3, WALL_Y, 0.5]]), np.array([[0.0, 1.0, 0.0]]), np.full((1, 2), 9.0), np.array([0]))


def sequence(start, stop, *things):
    """Both points and bodies, or the wall where there is None, as reflectors; and their order."""
    surfaces = [wall() if thing is None else bodies_of((thing,)) for thing in things]
    surfaces = joined([points_of(np.array([start, stop], float)), *surfaces])
    return surfaces.surfaces, np.array([[0, *range(2, 2 + len(things)), 1]])


def paths_over(start, stop, *things):
    """The path from one point over bodies and walls to another."""
    return fermat_paths(*sequence(start, stop, *things))


def onto(one, point):
    """A point (3) brought to the surface of a body, or to the wall."""
    return np.array([point[0], WALL_Y, point[2]]) if one is None else radar_worlds.onto(one, point)


def named(scene, centre, name):
    moved = replace(scene, vertices=scene.vertices + np.array(centre) - [2.0, 0, 0])
    return replace(moved, objects=tuple(replace(o, name=name) for o in moved.objects))


def two(first, last):
    """A ball or a drum, 0.3 m in radius, at each of two places ahead."""
    made = {"ball": scenes.sphere(0.3, 2.0, edge_m=0.06), "drum": scenes.cylinder(0.3, 1.0, 2.0)}
    return Scene.union([named(made[first], (2, 0.5, 0), "a"), named(made[last], (2.4, -0.6, 0), "b")])


START, STOP = np.array([0, 0, 0.1]), np.array([0, 0.2, -0.1])
LEAN, TURN = (0, 0.1, 1), (0.2, 0, 1)
ORDERS = {
    "ball, ball": (body((2, 0.5, 0), 0.3, ball=True), body((2.4, -0.6, 0.2), 0.2, ball=True)),
    "ball, drum": (body((2, 0.5, 0), 0.3, ball=True), body((2.4, -0.6, 0.2), 0.2, ball=False, axis=TURN)),
    "drum, drum": (body((2, 0.5, 0), 0.3, ball=False, axis=LEAN), body((2.4, -0.6, 0.2), 0.2, ball=False, axis=TURN)),
    "far along drums": (body((2, 0.5, 0), 0.3, ball=False, axis=LEAN),
                        body((2.4, -0.6 + 3.6, 4.8), 0.2, ball=False, axis=(0, 0.6, 0.8))),
    "far along drums, over the wall": (body((2, 0.5, 0), 0.3, ball=False, axis=(0, 0.2, 1)), None,
                                       body((2.4, -0.6 + 1.2, 6.2), 0.2, ball=False, axis=(0, 0.2, 1))),
    "wall, ball": (None, body((2, 0.5, 0), 0.3, ball=True)),
    "wall, drum, ball": (None, body((2, 0.5, 0), 0.3, ball=False, axis=LEAN), body((2.4, -0.6, 0.2), 0.2, ball=True)),
    "drum, wall, drum": (body((2, 0.5, 0), 0.3, ball=False, axis=LEAN), None,
                         body((2.4, -0.6, 0.2), 0.2, ball=False, axis=TURN)),
    "ball, drum, wall": (body((2, 0.5, 0), 0.3, ball=True), body((2.4, -0.6, 0.2), 0.2, ball=False, axis=TURN), None),
    "three bodies": (body((2, 0.5, 0), 0.3, ball=False, axis=LEAN), body((2.4, -0.6, 0.2), 0.2, ball=True),
                     body((1.2, 0.9, -0.2), 0.15, ball=False, axis=TURN)),
}  # fmt: skip


@pytest.mark.parametrize("things", ORDERS.values(), ids=ORDERS)
def test_the_spread_is_that_of_the_paths_second_derivatives(things):
    """By differences of the path's length over points of all surfaces, drums leaning; the same from the other end."""
    found, many = paths_over(START, STOP, *things), len(things)
    frames = [np.linalg.svd(normal)[2][1:] for normal in found.normals]

    def length(step):
        ends = [onto(b, found.corners[1 + k, 0] + step[2 * k : 2 * k + 2] @ frames[k]) for k, b in enumerate(things)]
        return sum(np.linalg.norm(b - a) for a, b in zip((START, *ends), (*ends, STOP), strict=True))

    tiny, axes = 1e-4, np.eye(2 * many)
    slope = [(length(tiny * a) - length(-tiny * a)) / (2 * tiny) for a in axes]
    bend = [[(length(tiny * (a + b)) - length(tiny * (a - b)) - length(tiny * (b - a)) + length(-tiny * (a + b)))
             / (4 * tiny**2) for a in axes] for b in axes]  # fmt: skip
    legs = np.diff(found.corners, axis=0)[:, 0]
    sizes = np.linalg.norm(legs, axis=1)
    slopes = [-legs[k] @ found.normals[k, 0] / sizes[k] for k in range(many)]
    assert np.max(np.abs(slope)) < 1e-6
    assert found.lengths[0] == pytest.approx(length(np.zeros(2 * many)), rel=1e-12)
    assert found.spreads[0] == pytest.approx(np.prod(slopes) / np.prod(sizes) / np.sqrt(np.linalg.det(bend)), rel=1e-3)
    assert paths_over(STOP, START, *things[::-1]).spreads[0] == pytest.approx(found.spreads[0], rel=1e-7)
    for k, thing in enumerate(things):
        if thing is not None and not thing.is_sphere:  # the second derivative along a drum, all else at its best
            turned = np.stack([np.cross(thing.axes[2], found.normals[k, 0]), thing.axes[2]]) @ frames[k].T
            rows = np.eye(2 * many)
            rows[2 * k : 2 * k + 2, 2 * k : 2 * k + 2] = turned
            assert found.bends[k, 0] == pytest.approx(
                1 / np.linalg.inv(rows @ bend @ rows.T)[2 * k + 1, 2 * k + 1], rel=1e-3
            )


@pytest.mark.parametrize("things", [(body((2, 0, 0), 0.3, ball=True),), (body((2, 0.1, 0), 0.3, ball=False),), (None,)])
def test_what_stands_between_both_points_mirrors_nothing(things):
    assert paths_over((0, -1.0, 0), (4, -0.9, 0.1), *things).spreads[0] > 0
    assert paths_over((1.9, -2.0, 0), (2, 2.0, 0.1), *things).spreads[0] == 0


def test_from_either_end_the_same_paths_are_found():
    """Wherever a ball, an upright drum and both points lie: the search begins elsewhere from the other end."""
    rng, many = np.random.default_rng(2), 4000
    places, radii = (
        rng.uniform(-3, 3, (4, many, 3)),
        np.concatenate([np.zeros((2, many)), rng.uniform(0.1, 1, (2, many))]),
    )
    flat = places * [1, 1, 0]  # start, stop, ball, drum
    apart = [np.linalg.norm(one[a] - one[b], axis=1) - radii[a] - radii[b] > 0.05
             for one, a, b in ((places, 0, 2), (places, 1, 2), (flat, 0, 3), (flat, 1, 3), (flat, 2, 3))]  # fmt: skip
    kinds, axes = np.repeat([SPHERE, SPHERE, SPHERE, CYLINDER], many), np.tile(np.eye(3), (4 * many, 1, 1))
    surfaces = Reflectors(kinds, places.reshape(-1, 3), axes, radii.ravel(), np.zeros((4 * many, 2)))
    number = np.arange(many) + many * np.arange(4)[:, None]
    for order in ([0, 2, 3, 1], [0, 2, 3, 2, 1]):
        rows = number[order].T[np.all(apart, 0)]
        forth, back = fermat_paths(surfaces, rows), fermat_paths(surfaces, rows[:, ::-1].copy())
        assert (forth.spreads > 0).sum() > 1000
        assert ((forth.spreads > 0) != (back.spreads > 0)).sum() <= 2
        there = (forth.spreads > 0) & (back.spreads > 0)
        assert forth.lengths[there] == pytest.approx(back.lengths[there], abs=1e-7)
        assert forth.spreads[there] == pytest.approx(back.spreads[there], rel=1e-3)


def kept(things, gate, least, start=START, stop=STOP):
    surfaces, rows = sequence(start, stop, *things)
    return may_be_strong(surfaces, Chains(rows, np.ones(1)), Limits(gate, least), np.empty(1, np.int64))


@pytest.mark.parametrize("things", ORDERS.values(), ids=ORDERS)
def test_no_path_is_left_out_that_is_short_and_strong_enough(things):
    """Estimates before the search are bounds; tight ones but where two drums of 18 m lean and may meet."""
    places = np.random.default_rng(1).uniform((-1, -1, -1), (1, 0.2, 1), (50, 2, 3))
    found = [paths_over(*ends, *things) for ends in places]
    there = [(ends, one.lengths[0], one.spreads[0]) for ends, one in zip(places, found, strict=True) if one.spreads[0]]
    assert len(there) > 10
    assert all(kept(things, 1.001 * length, 0.999 * spread, *ends) for ends, length, spread in there)
    if sum(one is not None and not one.is_sphere for one in things) > 1 and len(things) - things.count(None) == 2:
        return
    assert not any(kept(things, 0.7 * length, 0.0, *ends) for ends, length, _ in there)
    assert not any(kept(things, np.inf, 15 * spread, *ends) for ends, _, spread in there)


@pytest.mark.parametrize("at", [0, 1, 2])
def test_a_plane_is_the_world_mirrored_in_it(at):
    """What follows the plane is where its image is: the same path over two bodies, without a plane."""
    things = [body((2, 0.5, 0), 0.3, ball=False, axis=LEAN), body((2.4, -0.6, 0.2), 0.2, ball=False, axis=TURN)]
    over = paths_over(START, STOP, *things[:at], None, *things[at:])
    flip = np.diag([1.0, -1, 1])

    def image(point):
        return flip @ np.array(point) + [0, 2 * WALL_Y, 0]

    mirrored_ = [replace(one, centre=image(one.centre), axes=one.axes @ flip) for one in things[at:]]
    free = paths_over(START, image(STOP), *things[:at], *mirrored_)
    assert free.spreads[0] > 0
    assert over.lengths[0] == pytest.approx(free.lengths[0], rel=1e-9)
    assert over.spreads[0] == pytest.approx(free.spreads[0], rel=1e-6)
    assert np.delete(over.bends[:, 0], at) == pytest.approx(free.bends[:, 0], rel=1e-6)


def test_a_ball_over_a_huge_ball_is_a_ball_over_a_floor():
    """The floor's image sees the ball by itself: spread by the path's second derivatives over the ball alone."""
    floor, small = body((0, 0, -1e5 - 1.0), 1e5, ball=True), body((2, 0, -0.4), 0.3, ball=True)
    found = paths_over(np.zeros(3), np.array([0, 0.5, 0.2]), floor, small)
    image = paths_over(np.array([0, 0, -2.0]), np.array([0, 0.5, 0.2]), body((0, 0, -1e5 - 1.0), 1e5, ball=True), small)
    assert image.spreads[0] == 0  # from beneath there is no way over the floor
    wide = body((0, 0, -1e3 - 1.0), 1e3, ball=True)
    near = paths_over(np.zeros(3), np.array([0, 0.5, 0.2]), wide, small)
    normal, spot = found.normals[1, 0], found.corners[2, 0]
    paths = [spot - np.array([0, 0, -2.0]), np.array([0, 0.5, 0.2]) - spot]
    legs = [np.linalg.norm(way) for way in paths]
    u, cosine = paths[0] / legs[0], -normal @ paths[0] / legs[0]
    flat = (1 / legs[0] + 1 / legs[1]) * (np.eye(3) - np.outer(u, u)) + 2 * cosine / 0.3 * np.eye(3)
    frame = np.linalg.svd(normal[None])[2][1:]
    want = cosine / legs[0] / legs[1] / np.sqrt(np.linalg.det(frame @ flat @ frame.T))
    assert found.lengths[0] == pytest.approx(sum(legs), abs=1e-4)
    assert found.spreads[0] == pytest.approx(want, rel=1e-3)
    assert near.spreads[0] == pytest.approx(want, rel=0.02)


@pytest.mark.parametrize(("one", "other"), [(((2, 0.5), 0.3), ((2.4, -0.6), 0.3)),
                                            (((2, 0.5), 0.15), ((2.0, -0.4), 0.3)),
                                            (((1.5, 0.7), 0.1), ((2.0, -0.8), 0.1))])  # fmt: skip
def test_two_drums_are_their_dense_double_integral(one, other):
    """Iterated physical optics across the axes, obliquity of an electric and a magnetic wall in the mean."""
    rings = []
    for centre, radius in (one, other):
        angle = np.arange(count := int(12 * WAVE * radius)) / count * 2 * np.pi
        normal = np.stack([np.cos(angle), np.sin(angle)], 1)
        rings.append((np.array(centre) + radius * normal, normal, 2 * np.pi * radius / count))
    (here, n, dh), (there, m, dt) = rings
    way, (sent, back) = there[None] - here[:, None], (np.linalg.norm(p, axis=1) for p in (here, there))
    size = np.linalg.norm(way, axis=2)
    slopes = [-(here * n).sum(1)[:, None] / sent[:, None], (way * n[:, None]).sum(2) / size,
              -(way * m[None]).sum(2) / size, -(there * m).sum(1) / back]  # fmt: skip
    path = sent[:, None] + size + back
    lit = (slopes[0] > 0) & (slopes[1] > 0) & (slopes[2] > 0) & (slopes[3] > 0)
    slope = (slopes[0] * slopes[2] + slopes[1] * slopes[3]) / 2
    each = slope * lit / np.sqrt(sent[:, None] * size * back * path) * np.exp(-1j * WAVE * path)
    want = 1j * WAVE / (2 * np.pi) * each.sum() * dh * dt
    found = paths_over(np.zeros(3), np.zeros(3), *(body((*c, 0), r, ball=False) for c, r in (one, other)))
    assert db(found.spreads[0] / want) == pytest.approx(0, abs=1.0)
    assert abs(np.angle(found.spreads[0] * np.exp(-1j * WAVE * found.lengths[0]) / want)) < 0.2


@pytest.mark.parametrize("drums", [(((2, 0.5), 0.3), ((1.0, -0.8), 0.3), ((2, 0.5), 0.3)),
                                   (((2, 0.5), 0.3), ((1.1, -0.7), 0.2), ((2.3, -0.5), 0.15))])  # fmt: skip
def test_three_drums_or_one_twice_are_their_dense_triple_integral(drums):
    """As with two: iterated physical optics, for each point of the second drum; the mean of both walls."""
    rings = []
    for centre, radius in drums:
        angle = np.arange(count := int(12 * WAVE * radius)) / count * 2 * np.pi
        normal = np.stack([np.cos(angle), np.sin(angle)], 1)
        rings.append((np.array(centre) + radius * normal, normal, 2 * np.pi * radius / count))
    (here, n, dh), (spots, m, dm), (there, o, dt) = rings
    sent, back = (np.linalg.norm(p, axis=1) for p in (here, there))
    up, down = -(here * n).sum(1) / sent, -(there * o).sum(1) / back
    want = 0j
    for spot, normal in zip(spots, m, strict=True):
        way, on = spot - here, there - spot
        leg, last = np.linalg.norm(way, axis=1), np.linalg.norm(on, axis=1)
        slopes = [up, (way * n).sum(1) / leg, -way @ normal / leg, on @ normal / last, -(on * o).sum(1) / last, down]
        a, b = (np.flatnonzero(np.all([one > 0 for one in half], 0)) for half in (slopes[:3], slopes[3:]))
        in_, out = [slopes[k][a][:, None] for k in range(3)], [slopes[k][b][None] for k in (3, 4, 5)]
        slope = (in_[0] * in_[2] * out[1] + in_[1] * out[0] * out[2]) / 2
        path = (sent + leg)[a][:, None] + (last + back)[b][None]
        legs = (sent * leg)[a][:, None] * (last * back)[b][None]
        want += (slope / np.sqrt(legs * path) * np.exp(-1j * WAVE * path)).sum()
    want *= (1j * WAVE / (2 * np.pi)) ** 1.5 * dh * dm * dt
    found = paths_over(np.zeros(3), np.zeros(3), *(body((*c, 0), r, ball=False) for c, r in drums))
    assert db(found.spreads[0] / want) == pytest.approx(0, abs=1.0)
    assert abs(np.angle(found.spreads[0] * np.exp(-1j * WAVE * found.lengths[0]) / want)) < 0.2


def test_with_three_bounces_bodies_send_waves_to_and_fro():
    told = {c.path: c.path_gain_db for c in ul.explain(two("drum", "drum"), ul.Trajectory.stationary(), radar(), 0,
                                                       max_bounces=3, count=None)}  # fmt: skip
    assert {("a", "b"), ("a", "b", "a"), ("b", "a", "b")} <= set(told)
    assert told["a", "b", "a"] < told["a", "b"]


def test_of_drums_their_ends_leave_what_a_fresnel_zone_has():
    """Drums of 1 m hold the zone of 0.25 m; cut at the radar's height they keep half the wave or a quarter."""
    pose, spec, tall = ul.Trajectory.stationary(), radar(), two("drum", "drum")
    whole, cut = (abs(gain_via(s, pose, spec, "b", ("a",))) for s in (tall, shifted(tall, -0.5)))
    first, last = (body((*c, 0), 0.3, ball=False) for c in ((2, 0.5), (2.4, -0.6)))
    free = 2 * spec.wavelength_m / (4 * np.pi) * paths_over(np.zeros(3), np.zeros(3), first, last).spreads[0]
    assert db(whole / free) == pytest.approx(0, abs=1.5)
    assert cut / free == pytest.approx(0.25, abs=0.05)


def test_where_the_origin_lies_along_drums_is_no_matter():
    """World and radar 5 m higher: drums are known by a point of their axis, which may be far below."""
    high, low = (gain_via(shifted(two("drum", "drum"), up), ul.Trajectory.stationary((0, 0, up)), radar(), "b", ("a",))
                 for up in (5.0, 0.0))  # fmt: skip
    assert abs(low) > 1e-4
    assert high == pytest.approx(low, rel=1e-4)


def shifted(scene, up):
    return replace(scene, vertices=scene.vertices + np.array([0, 0, up]))


@pytest.mark.parametrize("kinds", [("ball", "ball"), ("drum", "ball")])
def test_sending_and_receiving_may_be_exchanged(kinds):
    spec, found = radar().but(antenna_offset_m=0.4), []
    for roll in (0.0, np.pi):
        pose = replace(ul.Trajectory.stationary(), quat_xyzw=np.array([[np.sin(roll / 2), 0, 0, np.cos(roll / 2)]]))
        found.append(sum(gain_via(two(*kinds), pose, spec, a, (b,)) for a, b in ("ab", "ba")))
    assert abs(found[0]) > 0
    assert found[0] == pytest.approx(found[1], rel=1e-6)
    together, hardly = (gain_via(two(*kinds), ul.Trajectory.stationary(), radar().but(antenna_offset_m=d), "b", ("a",))
                        + gain_via(two(*kinds), ul.Trajectory.stationary(), radar().but(antenna_offset_m=d), "a",
                                   ("b",))
                        for d in (0.0, 1e-6))  # fmt: skip
    assert together == pytest.approx(hardly, rel=1e-4)


def test_a_fence_between_them_hides_one_from_the_other():
    pose, spec, open_ = ul.Trajectory.stationary(), radar(), two("drum", "drum")
    fence = Scene.of_mesh(np.array([[2.1, 0, -1.0], [2.6, 0, -1], [2.6, 0, 1], [2.1, 0, 1]]),
                          np.array([[0, 1, 2], [0, 2, 3]]), name="fence", made_of="pec")  # fmt: skip
    assert abs(gain_via(open_, pose, spec, "b", ("a",))) > 1e-5
    wide = replace(fence, vertices=fence.vertices - [0.5, 0.05, 0])
    assert gain_via(Scene.union([open_, wide]), pose, spec, "b", ("a",)) == 0


def test_bodies_that_move_are_where_they_are():
    """Rounds carried along are those found in the world as it stands then."""
    still = two("ball", "drum")
    move = np.eye(4)
    move[:3, :3], move[:3, 3] = [[0, -1, 0], [1, 0, 0], [0, 0, 1]], [0.1, 0.2, 0.3]
    carried = [one.moved(move) for one in prepare(still).quadrics]
    there = prepare(replace(still, vertices=still.vertices @ move[:3, :3].T + move[:3, 3])).quadrics
    for one, other in zip(carried, there, strict=True):
        assert one.centre[:2] == pytest.approx(other.centre[:2], abs=1e-6)
        assert abs(one.axes[2] @ other.axes[2]) == pytest.approx(1, abs=1e-9)
        assert one.local(other.centre)[:2] == pytest.approx([0, 0], abs=1e-6)


def test_which_bodies_are_round():
    kinds = [(body.is_sphere, round(body.radius, 2)) for body in prepare(two("ball", "drum")).quadrics]
    assert kinds == [(True, 0.3), (False, 0.3)]
    squeezed = two("ball", "ball")
    assert prepare(replace(squeezed, vertices=squeezed.vertices * [1, 1, 0.8])).quadrics == ()
