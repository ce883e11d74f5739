"""Curved surfaces over flat faces: against a plate that is not meshed, image and object, a dense sum; shadow, names."""

from dataclasses import replace

import numpy as np
import pytest
from radar_worlds import at, db

import ullage as ul
from studies.validation.oracles import dense_tank
from studies.validation.rows import gain_via
from ullage.antenna import gain
from ullage.radar import curves, paths, physical, sphere_echoes
from ullage.radar.context import antenna_pair, radar_context, radar_frame
from ullage.radar.multipath import beams_of
from ullage.radar.penetration import fresnel
from ullage.radar.physical import path_gain_cw
from ullage.world import scenes
from ullage.world.scene import Scene

WAVELENGTH = 299792458 / 7.29e9


def radar(**changes):
    antenna = {"kind": "isotropic", "polarization": "horizontal"}
    return ul.RadarSpec.preset("x4m05", noise=None, antenna=antenna, **changes)


def mesh(vertices, faces, name, material="pec"):
    return Scene.of_mesh(np.asarray(vertices, float), np.asarray(faces), name=name, made_of=material)


def floor(size=8.0, material="pec", centre=(2.0, 0.0), depth=1.0, half=None):
    x, y = half or (size / 2, size / 2)
    corners = [[-x, -y, 0], [x, -y, 0], [x, y, 0], [-x, y, 0]]
    return mesh(np.array(corners) + np.array([*centre, -depth]), [[0, 1, 2], [0, 2, 3]], "floor", material)


def wall(cells, width=0.6, height=0.6, ahead=2.0, foot=-1.0, yaw_deg=0.0, tilt_deg=0.0, dent_m=5e-5):
    """An upright plate in cells x cells quadrangles, whose inner corners lie a little off its plane where it is cut."""
    u = np.linspace(-0.5, 0.5, cells + 1)
    y, z = (a.ravel() for a in np.meshgrid(u * width, u * height, indexing="ij"))
    x = np.random.default_rng(3).uniform(-dent_m, dent_m, len(y)) if cells > 1 else np.zeros(len(y))
    a, b = np.deg2rad(tilt_deg), np.deg2rad(yaw_deg)
    points = np.stack([x, y, z + height / 2], 1)
    points = points @ np.array([[np.cos(a), 0, -np.sin(a)], [0, 1, 0], [np.sin(a), 0, np.cos(a)]])
    points = points @ np.array([[np.cos(b), np.sin(b), 0], [-np.sin(b), np.cos(b), 0], [0, 0, 1]])
    k = np.arange(cells * (cells + 1)).reshape(cells, cells + 1)[:, :-1].ravel()
    n = cells + 1
    faces = np.concatenate([np.stack([k, k + n, k + n + 1], 1), np.stack([k, k + n + 1, k + 1], 1)])
    return mesh(points + np.array([ahead, 0, foot]), faces, "wall")


def ball(radius=0.1, centre=(2.0, 0.0, -0.5), step_m=0.02):
    """A closed sphere of small triangles."""
    lone = scenes.sphere(radius, 2.0, edge_m=step_m)
    return replace(lone, vertices=lone.vertices + np.array(centre) - [2.0, 0, 0])


def order(scene, pose, spec, bounces):
    """What the paths of just so many bounces add, at the carrier."""
    return path_gain_cw(scene, pose, spec, max_bounces=bounces)[0] - path_gain_cw(
        scene, pose, spec, max_bounces=bounces - 1)[0]  # fmt: skip


def kinds(scene):
    still = radar_context(scene, radar()).world.still
    return len(still.corners), int(still.planar.smooth.sum()), len(still.planar)


def test_what_is_curved():
    assert kinds(Scene.union([floor(), wall(12)])) == (288, 0, 1)  # small triangles
    assert kinds(Scene.union([floor(), wall(3)]))[:2] == (0, 16)  # two triangles have but one neighbour
    assert kinds(Scene.union([floor(), wall(1)])) == (0, 0, 2)
    assert kinds(scenes.tank(2.0, 1.2, strips=24)) == (0, 24, 25)
    assert kinds(scenes.tank(2.0, 1.2, strips=12))[1] == 0  # walls that meet at 30 deg are flat walls
    assert kinds(scenes.room((4, 3, 2)))[1] == 0


@pytest.mark.parametrize("cells", [3, 12])
@pytest.mark.parametrize(("yaw_deg", "tilt_deg", "height"), [(0, 0, 0.0), (0, 0, 0.7), (8, 0, 0.3), (20, 0, 0.0)])
def test_a_meshed_plate_on_a_floor_is_the_plate(cells, yaw_deg, tilt_deg, height):
    """Facets of 0.2 m and triangles of 0.05 m against the one face of the same plate, amplitude and phase."""
    spec, pose = radar(), at(0, 0, height)
    whole, cut = (
        order(Scene.union([floor(), wall(n, yaw_deg=yaw_deg, tilt_deg=tilt_deg)]), pose, spec, 2) for n in (1, cells)
    )
    if yaw_deg <= 10:
        assert db(cut / whole) == pytest.approx(0, abs=0.5)
        assert abs(np.angle(cut / whole)) < 0.06
    else:  # 23 dB under the facing plate; a sum point by point lies between the two
        facing = order(Scene.union([floor(), wall(1)]), pose, spec, 2)
        assert abs(cut - whole) < 0.01 * abs(facing)


@pytest.mark.parametrize(("step_m", "within_db"), [(0.02, 0.1), (0.2, 0.5)])
def test_a_ball_over_a_floor_is_the_ball_and_its_image(monkeypatch, step_m, within_db):
    """With the floor away and the antennas where the floor has their images: across the plane of incidence a
    conductor turns the sign at each bounce. Small triangles, and facets large enough to be done by their rims:
    the lone ball is not taken for a smooth one. `test_fermat_faces` covers waves from the ball over the floor back
    to it."""
    monkeypatch.setattr(physical, "accumulate_fermat", lambda *_: [])
    radius = 0.1 if step_m < 0.1 else 0.8
    alone = ball(radius, centre=(3.0, 0, 0.0), step_m=step_m)
    monkeypatch.setattr(sphere_echoes, "visible_parts", lambda *_: [])
    both, ground = Scene.union([floor(12.0), alone]), floor(12.0)
    spec, here = radar(), at(0, 0, 0)
    upright = spec.but(antenna_offset_m=2.0, antenna={"kind": "isotropic", "polarization": "vertical"})
    cross = path_gain_cw(alone, at(0, 0, -1.0, roll_deg=90), upright, edges=False)[0]
    image = path_gain_cw(alone, at(0, 0, -2.0), spec, edges=False)[0]
    once = order(both, here, spec, 2) - order(ground, here, spec, 2)
    twice = order(both, here, spec, 3)
    assert db(once / (-2 * cross)) == pytest.approx(0, abs=within_db)
    assert abs(np.angle(once / (-2 * cross))) < 0.2 * within_db
    assert db(twice / image) == pytest.approx(0, abs=within_db)
    assert abs(np.angle(twice / image)) < 0.2 * within_db


def test_a_floor_of_concrete_keeps_of_the_wave_what_fresnel_says():
    spec, pose = radar(), at(0, 0, 0)
    both = [order(Scene.union([floor(12.0, m), ball()]), pose, spec, 2) for m in ("concrete", "pec")]
    eps = floor(1.0, "concrete").objects[0].material.permittivity(spec.center_hz)
    cosine = 1.5 / np.hypot(2.0, 1.5)  # by the image of the ball's middle
    assert abs(both[0] / both[1]) == pytest.approx(abs(fresnel(eps, cosine)[0]), rel=0.02)


def test_the_antenna_weighs_the_way_to_the_floor_and_the_way_from_the_ball():
    """Turned down by 25 deg, so that the two ways leave it unlike each other."""
    scene, spec = Scene.union([floor(12.0), ball()]), radar()
    patch = spec.but(antenna={"kind": "x4a02", "polarization": "horizontal"})
    middle, image = np.array([2.0, 0, -0.5]), np.array([0, 0, -2.0])
    half = (middle - image) / np.linalg.norm(middle - image) + middle / np.linalg.norm(middle)
    spot = middle - 0.1 * half / np.linalg.norm(half)
    paths = np.stack([spot, (spot - image) * [1, 1, -1]])
    turn = np.deg2rad(25.0)
    down = replace(at(0, 0, 0), quat_xyzw=np.array([[0, np.sin(turn / 2), 0, np.cos(turn / 2)]]))
    axes = np.array([[np.cos(turn), 0, -np.sin(turn)], [0, 1, 0], [np.sin(turn), 0, np.cos(turn)]])
    sent, received = gain(patch.antenna, paths / np.linalg.norm(paths, axis=1)[:, None] @ axes.T)
    found = [order(scene, down, s, 2) for s in (patch, spec)]
    assert abs(found[0] / found[1]) == pytest.approx(sent * received, rel=0.01)


@pytest.mark.parametrize("target", [ball(), wall(12, yaw_deg=10), scenes.tank(2.0, 1.2, strips=24)])
def test_sending_and_receiving_may_be_exchanged(target):
    if target.objects[0].name == "floor":
        scene = replace(target, vertices=target.vertices - [0.3, 0, 0.5])
    else:
        scene = Scene.union([floor(material="concrete"), target])
    spec = radar(antenna_offset_m=0.4)
    for bounces in (2, 3):
        one, other = (order(scene, at(0, 0.1, 0, roll_deg=r), spec, bounces) for r in (0, 180))
        assert one == pytest.approx(other, rel=1e-3)


def test_a_small_offset_of_the_antennas_changes_little():
    scene = Scene.union([floor(), ball()])
    together, apart = (order(scene, at(0, 0, 0), radar(antenna_offset_m=d), 2) for d in (0.0, 1e-6))
    assert together == pytest.approx(apart, rel=1e-4)


def test_nothing_is_counted_twice():
    """Of paths with one bounce at a curved surface, none is left to the mirrors; flat faces leave none to this."""
    spec = radar()
    context = radar_context(scenes.tank(2.0, 1.2, strips=24), spec)
    planar, antennas = context.world.still.planar, antenna_pair(spec, np.array([0.3, 0.2, 0.5]), np.eye(3))
    frame = radar_frame(context, antennas, None, 3)
    beams = beams_of(frame, antennas)
    faces = np.column_stack([beams.chains, beams.ends_on])
    bent = (planar.smooth[faces] & (faces >= 0)).sum(1)
    assert not beams.weights[bent == 1].any()
    led = paths.paths_of(frame)
    assert len(led)
    assert not (planar.smooth[led.faces] & (led.faces >= 0)).any()


@pytest.mark.parametrize("place", [(0.5, 0.2, 0.5), (0.0, 0.0, 0.4), (-0.2, 0.9, 0.8)])
def test_a_tanks_corner_of_floor_and_wall_is_the_dense_sum_over_its_wall(place):
    """Strips 0.3 m wide, in the middle of the tank all at one distance."""
    want = dense_tank(40, 2.0, 1.2, np.array(place), 7.29e9)
    tank = scenes.tank(2.0, 1.2, "pec", strips=40)
    found = [gain_via(tank, at(*place), radar(), "wall", via) for via in (("floor",), ("floor", "floor"))]
    assert abs(found[0] - want[0]) < 0.05 * abs(want[0])
    assert abs(found[1] - want[1]) < 0.1 * abs(want[1]) + 0.01 * abs(want[0])


def test_a_tanks_corner_settles_as_its_strips_grow_narrow():
    """A strip's chord lies inside the round by 8 mm of 32 strips, 0.1 mm of 256; about the middle nothing focuses."""
    place = at(0.8, 0.3, 0.5)
    tanks = [scenes.tank(2.0, 1.2, "pec", strips=n) for n in (32, 192, 256)]
    levels = [gain_via(tank, place, radar(), "wall", ("floor",)) for tank in tanks]
    assert abs(levels[1] - levels[2]) < 0.1 * abs(levels[2])
    assert abs(levels[0] - levels[2]) > 3 * abs(levels[1] - levels[2])


def test_a_dihedral_with_one_side_meshed_has_its_radar_cross_section():
    edge, away = 0.2, 7.0
    root = np.sqrt(0.5)
    spec, pose = radar(), at(-away * root, 0, away * root)
    ground = floor(half=(edge / 2, edge / 2), centre=(-edge / 2, 0.0), depth=0.0)
    scene = Scene.union([ground, wall(4, edge, edge, ahead=0.0, foot=0.0)])
    section = 8 * np.pi * edge**4 / WAVELENGTH**2  # on the axis, sides of edge x edge
    want = np.sqrt(WAVELENGTH**2 * section / (4 * np.pi) ** 3) / away**2
    assert db(abs(order(scene, pose, spec, 2)) / want) == pytest.approx(0, abs=0.7)


def heard_over_floor(scene):
    told = ul.explain(scene, at(0, 0, 0), radar(), 0, max_bounces=2, count=200)
    return [c for c in told if c.object == "sphere" and c.via == ("floor",)]


def test_it_is_told_by_name_and_a_leg_that_is_blocked_gives_nothing():
    open_ = Scene.union([floor(), ball()])
    best = max(heard_over_floor(open_), key=lambda c: c.path_gain_db)
    image = np.linalg.norm(np.array([2.0, 0, -0.5]) - [0, 0, -2.0])
    direct = np.linalg.norm([2.0, 0, -0.5])
    assert best.bounces == 2
    assert best.range_m == pytest.approx((image + direct) / 2 - 0.1, abs=0.03)
    assert np.linalg.norm(np.array(best.point) - [2.0, 0, -0.5]) == pytest.approx(0.1, abs=0.01)
    # the wave to the floor passes x = 0.6 at z = -0.45, the wave to the ball at z = -0.15
    fence = mesh([[0.6, -3, -1.0], [0.6, 3, -1.0], [0.6, 3, -0.25], [0.6, -3, -0.25]], [[0, 1, 2], [0, 2, 3]], "fence")
    assert heard_over_floor(Scene.union([floor(), ball(), fence])) == []
    assert any(c.object == "sphere" for c in ul.explain(Scene.union([floor(), ball(), fence]), at(0, 0, 0), radar(), 0))
    short = Scene.union([floor(centre=(-3.0, 0.0)), ball()])  # ends at x = 1, before the wave would meet it
    assert heard_over_floor(short) == []


def test_echoes_over_the_floor_change_smoothly_along_a_track(monkeypatch):
    monkeypatch.setattr(paths, "FACES", 2)
    scene = Scene.union([scenes.room((5, 4, 2.4)), ball(centre=(1.0, 0.0, 0.0))])
    path = ul.Trajectory.line((-0.6, -0.02, 0.3), (-0.6, 0.02, 0.3), 0.5, 400)
    spec = radar()
    faces = set()
    for place in path.position:
        context = radar_context(scene, spec)
        frame = radar_frame(context, antenna_pair(spec, place, np.eye(3)), None, 2)
        faces.add(tuple(paths.paths_of(frame).faces.ravel()))
    both = [ul.simulate(scene, path, spec, max_bounces=b).samples for b in (1, 2)]
    bare = [ul.simulate(scenes.room((5, 4, 2.4)), path, spec, max_bounces=b).samples for b in (1, 2)]
    change = abs(np.diff((both[1] - both[0]) - (bare[1] - bare[0]), axis=0)).max(1)
    assert len(faces) > 0
    assert change.max() < 0.3 * abs(both[1] - both[0]).max()


def afar(count=520, away=60.0):
    """Small upright plates far beyond any gate, each a flat face of its own."""
    one = wall(1, width=0.2, height=0.2, ahead=0.0)
    places = away + 0.5 * np.stack([np.arange(count) % 26, np.arange(count) // 26, np.zeros(count)], 1)
    vertices = (one.vertices[None] + places[:, None]).reshape(-1, 3)
    faces = (one.faces[None] + 4 * np.arange(count)[:, None, None]).reshape(-1, 3)
    return mesh(vertices, faces, "afar")


def drum(radius=0.15, height=0.7, strips=24):
    """An upright closed drum of narrow strips, 2 m ahead over the floor."""
    angle = 2 * np.pi * np.arange(strips) / strips
    ring = np.stack([radius * np.cos(angle) + 2.0, radius * np.sin(angle), 0 * angle - 0.8], 1)
    here, after = np.arange(strips), np.roll(np.arange(strips), -1)
    sides = [np.stack([here, after, here + strips], 1), np.stack([after, after + strips, here + strips], 1)]
    lid = np.stack([np.full(strips - 2, strips), here[1:-1] + strips, here[2:] + strips], 1)
    base = np.stack([np.zeros(strips - 2, int), here[2:], here[1:-1]], 1)
    return mesh(np.concatenate([ring, ring + np.array([0, 0, height])]), np.concatenate([*sides, lid, base]), "drum")


def wire():
    return Scene.of_wires([[2.0, -1, 0]], [[2.0, 1, 0]], 0.002, name="wire")


@pytest.mark.parametrize("thing", [ball(), drum(), wire()])
def test_what_is_far_away_changes_nothing_of_what_is_near(thing):
    """Hundreds of faces beyond the gate, as in a hall or a hold: the echoes over the floor are those without them."""
    spec, near = radar(bins=100), Scene.union([floor(material="concrete"), thing])
    wide = Scene.union([near, afar()])
    assert (~radar_context(wide, spec).world.still.planar.smooth).sum() > 500
    for bounces in (2, 3):
        alone, padded = (ul.simulate(s, at(0, 0, 0), spec, max_bounces=bounces).samples[0] for s in (near, wide))
        fewer = ul.simulate(near, at(0, 0, 0), spec, max_bounces=bounces - 1).samples[0]
        assert abs(alone - fewer).max() > 1e-6
        assert abs(padded - alone).max() < 0.01 * abs(alone - fewer).max()


def left_out(monkeypatch, told):
    """What comes with and without what is too faint, and how many parts of rims count in either."""
    held, found, heard = [], [], curves.audible

    def counted(*told):
        known = heard(*told)
        held.append(int(known.sum()))
        return known

    monkeypatch.setattr(curves, "audible", counted)
    for share in (1.0, 0.0):
        monkeypatch.setattr(curves, "FACETS", share * curves.FACETS)
        monkeypatch.setattr(curves, "REST", share * curves.REST)
        found.append(told())
    return *found, sum(held[: len(held) // 2]) / max(sum(held[len(held) // 2 :]), 1)


@pytest.mark.parametrize("strips", [256, 512])
def test_facets_too_faint_to_count_are_left_out_and_no_others(monkeypatch, strips):
    """Strips of a drum over a floor, of a third of a wave and a sixth: it is a smooth surface however it is cut."""
    scene, spec = Scene.union([floor(), drum(radius=0.5, strips=strips)]), radar()
    some, all_, share = left_out(monkeypatch, lambda: order(scene, at(0, 0, 0), spec, 2))
    assert share < 0.97
    assert db(some / all_) == pytest.approx(0, abs=0.1)


def test_what_is_left_out_in_a_room_is_forty_db_below_the_strongest(monkeypatch):
    """Drums of facets of 5 to 23 cm: many are too faint over two walls."""
    things = [replace(drum(r, 1.5, 24), vertices=drum(r, 1.5, 24).vertices + np.array(p))
              for r, p in ((0.2, (-0.8, 0.9, -0.2)), (0.35, (-1.0, -1.2, -0.2)), (0.9, (-3.3, 0.5, -0.2)))]  # fmt: skip
    scene = Scene.union([scenes.room((6, 5, 2.4)), *things])
    path = ul.Trajectory.line((-0.2, -0.6, 0.2), (0, 0.6, 0.4), 0.5, 4)
    some, all_, share = left_out(monkeypatch, lambda: ul.simulate(scene, path, radar(), max_bounces=3).samples)
    assert share < 0.9
    assert (abs(some - all_).max(1) < 0.01 * abs(all_).max(1)).all()
