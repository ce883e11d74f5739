"""Edges of conductors: strengths against Keller and against exact currents, and which edges of a mesh count."""

import tracemalloc

import numpy as np
import pytest
import trimesh
from scipy.spatial.transform import Rotation
from scipy.special import fresnel

import ullage as ul
from ullage.geometry import C0
from ullage.kernels import corner_diffraction, double_edge_diffraction, edge_diffraction
from ullage.radar.double_diffraction import facing_pairs
from ullage.radar.physical import path_gain_cw
from ullage.radar.prepared import prepare
from ullage.world.scene import Scene

HERE = ul.Trajectory.stationary()


def radar(polarization="vertical"):
    return ul.RadarSpec.preset("x4m05", antenna={"kind": "isotropic", "polarization": polarization}, noise=None)


def edges_of(scene):
    return prepare(scene).edges.edges


def strength(n, phi, u=None, field=None):
    """Fringe strength of a wedge along z whose first face is the half plane y = 0, x > 0."""
    u = -np.array([np.cos(phi), np.sin(phi), 0.0]) if u is None else u
    turn = n * np.pi
    inward = np.array([[[1.0, 0, 0], [np.cos(turn), np.sin(turn), 0]]])
    normals = np.array([[[0, 1.0, 0], [np.sin(turn), -np.cos(turn), 0]]])
    rows = np.array([u, field, field], float)
    return sum(edge_diffraction.face(float(n), inward, normals, 0, i, 1.0, rows, np.empty(2)) for i in range(2))


@pytest.mark.parametrize("n", [2.0, 1.75, 1.5, 1.2])
def test_with_physical_optics_a_straight_edge_is_kellers(n):
    """Broadside, fringe and both faces' optical shares make Keller's coefficient [Keller1962]."""
    for deg in (7, 40, 89.9, 90.1, 130, 170, 190, 250, 320):
        phi = np.radians(deg)
        if phi >= n * np.pi:
            continue
        other = n * np.pi - phi
        optical = sum(np.tan(a) / 2 for a in (phi, other) if a < np.pi)
        direct = np.sin(np.pi / n) / n / (np.cos(np.pi / n) - 1)
        mirrored = np.sin(np.pi / n) / n / (np.cos(np.pi / n) - np.cos(2 * phi / n))
        soft = strength(n, phi, field=np.array([0, 0, 1.0]))
        hard = strength(n, phi, field=np.array([-np.sin(phi), np.cos(phi), 0]))
        assert soft + optical == pytest.approx(direct - mirrored, rel=2e-3, abs=2e-3)
        assert -hard - optical == pytest.approx(direct + mirrored, rel=2e-3, abs=2e-3)


def sommerfeld(x, phi, hard):
    """Field (hard) or its normal slope (soft) on the lit side of a half plane, over kx; exact."""

    def tail(a):  # integral of e^{-j t^2} from a on
        s, c = fresnel(a * np.sqrt(2 / np.pi))
        return np.sqrt(np.pi / 8) * (1 - 1j) - np.sqrt(np.pi / 2) * (c - 1j * s)

    a = np.sqrt(2 * x) * np.cos(phi / 2)
    g = np.exp(1j * np.pi / 4) / np.sqrt(np.pi) * np.exp(1j * x * np.cos(phi)) * tail(-a)
    if hard:
        return 2 * g
    bend = np.exp(1j * np.pi / 4) / np.sqrt(np.pi) * np.exp(-1j * x) * np.sin(phi / 2) / np.sqrt(2 * x)
    return 2 * (1j * np.sin(phi) * g + bend)


@pytest.mark.parametrize(("deg", "mu"), [(40, 0.5), (130, -0.4), (70, -1.7), (150, -6.0), (230, 0.3)])
def test_edge_diffraction_currents_are_those_of_the_exact_half_plane(deg, mu):
    """The integral of exact less optical current along the face, for steps that no single angle gives."""
    phi, loss = np.radians(deg), 0.02
    s = (np.arange(400_000) + 0.5) * 1.5e-3  # of the root of kx, which takes the edge's singularity out
    x = s * s / 2
    weight = np.exp(1j * mu * x - loss * x) * s * 1.5e-3
    out = np.empty(2)
    edge_diffraction.edge_diffraction(2.0, phi, mu, out)
    lit = phi < np.pi
    optical = 2 * np.exp(1j * x * np.cos(phi)) * lit
    hard = np.sum((sommerfeld(x, phi, True) - optical) * weight) / 2j
    soft = np.sum((sommerfeld(x, phi, False) - 1j * np.sin(phi) * optical) * weight) / -2
    assert hard == pytest.approx(out[1], abs=0.03)
    assert soft == pytest.approx(out[0], abs=0.03)


@pytest.mark.parametrize("deg", [20, 70, 130])
def test_currents_that_meet_a_corner_are_those_of_the_exact_half_plane(deg):
    """Both polarisations, at broadside: exact less optical current on the lit side."""
    phi, x = np.radians(deg), np.array([0.05, 0.4, 3.0, 20.0])
    optical = 2 * np.exp(1j * x * np.cos(phi))
    ours = np.array([corner_diffraction.sheet_currents(np.cos(phi / 2), 2 * v) for v in x]) * np.exp(-1j * x)[:, None]
    across = optical - sommerfeld(x, phi, True)
    along = sommerfeld(x, phi, False) - 1j * np.sin(phi) * optical
    assert ours[:, 0] == pytest.approx(across, rel=1e-2)
    assert ours[:, 1] == pytest.approx(along / (2j * np.sin(phi / 2)), rel=1e-2)


@pytest.mark.parametrize("back", [0.1, 0.9, 1.7])
def test_a_current_along_a_sheet_ends_at_its_edge(back):
    """Both faces of a sheet together, for a wave that grazes it: Michaeli's currents in closed form."""
    out, cosine = np.empty(2), 0.3
    sine2, total = 1 - cosine**2, np.zeros(2)
    for side in range(2):
        sign = 1.0 - 2 * side
        edge_diffraction.face_currents(2.0, side * 2 * np.pi, 0.0, sign * np.sqrt(sine2), sign * cosine, back, out)
        total += np.array([sign, 1.0]) * out
    half = np.sqrt(0.5 * back / sine2)
    fringe = 1 / (2 * half * (1 + half))
    along = cosine / np.sqrt(sine2) * (1 + (1 - back / sine2) * fringe)
    assert total == pytest.approx([along, fringe], rel=2e-3)


def test_a_box_and_its_radar_may_turn_together():
    """Oblique, where waves from edge to edge carry the echo; the world's axes mean nothing."""
    turn = Rotation.random(random_state=2).as_matrix()
    place, body = np.array([0.6, 0.5, 0.4]), trimesh.creation.box((0.06, 0.05, 0.07))
    for pol in ("vertical", "horizontal"):
        echo = []
        for frame in (np.eye(3), turn):
            scene = Scene.of_mesh(body.vertices @ frame.T, body.faces, name="box", made_of="pec")
            away = -place / np.linalg.norm(place)
            left = np.cross([0, 0, 1.0], away)
            left /= np.linalg.norm(left)
            axes = frame @ np.stack([away, left, np.cross(away, left)], 1)
            none, quat = np.zeros((1, 3)), Rotation.from_matrix(axes[None]).as_quat()
            there = ul.Trajectory(np.zeros(1, np.int64), (frame @ place)[None], quat, none, none)
            echo.append(path_gain_cw(scene, there, radar(pol))[0])
        assert abs(echo[1] / echo[0] - 1) < 1e-6


def test_transition_function():
    x = np.array([1e-4, 0.3, 1.0, 3.0, 5.4, 5.6, 20.0])
    s, c = fresnel(np.sqrt(2 * x / np.pi))
    tail = np.sqrt(np.pi / 8) * (1 - 1j) - np.sqrt(np.pi / 2) * (c - 1j * s)
    want = 2j * np.sqrt(x) * np.exp(1j * x) * tail
    ours = np.array([double_edge_diffraction.transition(float(v)) for v in x])
    assert abs(ours - want).max() < 5e-3


def test_a_plate_is_four_outlines_and_a_box_twelve_edges():
    plate = edges_of(ul.scenes.plate(0.5, 0.3, 3.0))
    assert sorted(np.linalg.norm(plate.ends - plate.starts, axis=1)) == pytest.approx([0.3, 0.3, 0.5, 0.5])
    assert plate.angles == pytest.approx([2] * 4)
    box = edges_of(cube(0.4))
    assert box.angles == pytest.approx([1.5] * 12)
    assert box.widths == pytest.approx(np.full((12, 2), 0.4))


def cube(edge, *, at=(3.0, 0, 0), made_of="steel"):
    body = trimesh.creation.box((edge, edge, edge))
    return Scene.of_mesh(body.vertices + np.asarray(at), body.faces, name="box", made_of=made_of)


def test_a_straight_edge_is_one_however_a_mesh_cuts_it():
    box = trimesh.creation.box((0.6, 0.4, 0.3)).subdivide().subdivide()
    found = edges_of(
        Scene.of_mesh(np.asarray(box.vertices) + np.array([3, 0, 0]), np.asarray(box.faces, np.int32), name="box")
    )
    length = np.linalg.norm(found.ends - found.starts, axis=1)
    assert np.sort(length) == pytest.approx(np.repeat([0.3, 0.4, 0.6], 4))


def test_a_plate_of_needles_echoes_as_one_of_two_triangles():
    whole = ul.scenes.plate(0.5, 0.5, 3.0, yaw_deg=25)
    across = whole.vertices[[0, 1]] if abs(np.diff(whole.vertices[[0, 1], 2])) < 1e-9 else whole.vertices[[0, 3]]
    line = across[0] + np.linspace(0, 1, 201)[:, None] * (across[1] - across[0])
    vertices = np.concatenate([line * [1, 1, 0] + [0, 0, z] for z in (-0.25, 0.25)])
    k = np.arange(200)
    faces = np.concatenate([np.stack([k, k + 1, k + 202], 1), np.stack([k, k + 202, k + 201], 1)])
    cut = Scene.of_mesh(vertices, faces.astype(np.int32), name="plate", made_of="pec")
    want, ours = (path_gain_cw(scene, HERE, radar())[0] for scene in (whole, cut))
    assert abs(ours / want - 1) < 1e-6  # each needle's edge by itself: 3e-3


def test_smooth_meshes_dielectrics_and_what_touches_have_no_edges():
    assert len(edges_of(ul.scenes.sphere(0.3, 3.0))) == 0
    assert len(edges_of(cube(0.4, made_of="wood"))) == 0
    floor = Scene.of_mesh(np.array([[0, -3, -0.2], [6, -3, -0.2], [6, 3, -0.2], [0, 3, -0.2]]),
                          np.array([[0, 1, 2], [0, 2, 3]]), name="floor", made_of="concrete")  # fmt: skip
    standing = edges_of(Scene.union([cube(0.4), floor]))
    assert len(standing) == 8
    assert (standing.starts[:, 2] + standing.ends[:, 2] > -0.39).all()


def test_the_outlines_of_a_thin_body_are_those_of_a_sheet():
    """The sides of a body of 0.1 mm are no faces."""
    turn = np.array([[np.cos(0.7), -np.sin(0.7), 0], [np.sin(0.7), np.cos(0.7), 0], [0, 0, 1]])
    body = trimesh.creation.box((1e-4, 0.3, 0.3))
    body = Scene.of_mesh(body.vertices @ turn.T + [3.0, 0, 0], body.faces, name="box", made_of="steel")
    sheet = ul.scenes.plate(0.3, 0.3, 3.0, yaw_deg=np.degrees(0.7))
    for pol in ("vertical", "horizontal"):
        thick, thin = (path_gain_cw(s, HERE, radar(pol)) - path_gain_cw(s, HERE, radar(pol), edges=False)
                       for s in (body, sheet))  # fmt: skip
        assert abs(20 * np.log10(abs(thick / thin))) < 0.2


def test_inside_a_closed_steel_room_no_edge_echoes():
    room = ul.scenes.room((4, 3, 2), material="steel")
    assert path_gain_cw(room, HERE, radar()) == path_gain_cw(room, HERE, radar(), edges=False)


@pytest.mark.parametrize(("pol", "tilt"), [("vertical", 30), ("vertical", 50), ("horizontal", 30), ("horizontal", 50)])
def test_a_long_strip_is_kellers_two_edges(pol, tilt):
    """A tall strip, turned: both edges by Keller, for "horizontal" also the wave from edge to edge."""
    width, r0 = 0.4, 4.0
    k, t = 2 * np.pi * 7.29e9 / C0, np.radians(tilt)
    ours = path_gain_cw(ul.scenes.plate(width, 6.0, r0, yaw_deg=tilt), HERE, radar(pol))[0]
    total, sign = 0j, (-1 if pol == "vertical" else 1)
    ends, r, phi = [], [], []
    for side in (1, -1):
        p = np.array([r0, 0.0]) + side * width / 2 * np.array([-np.sin(t), np.cos(t)])
        inward = -side * np.array([-np.sin(t), np.cos(t)])
        ends.append(p)
        r.append(np.hypot(*p))
        phi.append(np.arccos(-p @ inward / r[-1]))
    for j in range(2):
        keller = 0.5 * (-1 + sign * -1 / np.cos(phi[j])) * (-sign)
        length = np.sqrt(np.pi * r[j] / k) * np.exp(-1j * np.pi / 4)  # of the stationary part
        total += keller / (4 * np.pi * k * r[j] ** 2) * length * np.exp(-2j * k * r[j])
    if pol == "horizontal":
        twice = 2 * np.exp(-1j * np.pi / 4) / np.sqrt(2 * np.pi * k * width) / np.cos(phi[0] / 2) / np.cos(phi[1] / 2)
        path = r[0] + r[1] + width
        length = np.sqrt(2 * np.pi * r[0] * r[1] / (r[0] + r[1]) / k) * np.exp(-1j * np.pi / 4)
        total -= twice / (4 * np.pi * k * r[0] * r[1]) * length * np.exp(-1j * k * path)
    assert abs(20 * np.log10(abs(ours / total))) < 0.7
    assert abs(np.angle(ours / total, deg=True)) < 8


def test_a_moving_plate_takes_its_edges_along():
    still = ul.scenes.plate(0.3, 0.3, 3.0, yaw_deg=40)
    lone = ul.scenes.plate(0.3, 0.3, 3.0)
    half = np.radians(20)
    quat = np.array([[0, 0, np.sin(half), np.cos(half)]] * 2)
    way = ul.Trajectory(np.array([0, 10**9]), np.array([[3.0, 0, 0]] * 2), quat)
    moving = Scene.of_mesh(lone.vertices - [3.0, 0, 0], lone.faces, name="plate", made_of="pec", motion=way)
    a, b = (path_gain_cw(s, HERE, radar())[0] for s in (still, moving))
    assert a == pytest.approx(b, rel=1e-6)


@pytest.mark.parametrize("share", np.linspace(0.05, 0.95, 10))
@pytest.mark.parametrize("kind", ["box", "rim"])
def test_an_edge_counts_where_nothing_stands_in_its_open_side_at_whatever_angle(share, kind):
    """A rod of wood, as thick as a match and 10 mm off, along half of one edge: that half is gone, and nothing else."""
    if kind == "box":  # over the top face and down the front
        body, edge, inward, normal = cube(0.4), [2.8, 0, 0.2], [1.0, 0, 0], [0, 0, 1.0]
    else:  # once around the upper rim
        body, edge, inward, normal = ul.scenes.plate(0.4, 0.4, 3.0), [3.0, 0, 0.2], [0, 0, -1.0], [-1.0, 0, 0]
    angle = 0.2 + share * ((1.5 if kind == "box" else 2.0) * np.pi - 0.4)
    centre = edge + 0.01 * (np.cos(angle) * np.array(inward) + np.sin(angle) * np.array(normal))
    found, whole = edges_of(Scene.union([body, rod_along_y(centre + np.array([0, 0.1, 0]))])), edges_of(body)
    lost = lengths(whole).sum() - lengths(found).sum()
    assert lost == pytest.approx(0.2)
    cut = np.flatnonzero(np.isclose(lengths(found), 0.2))
    assert len(cut) == 1
    ends = sorted([found.starts[cut[0]].tolist(), found.ends[cut[0]].tolist()])
    assert np.array(ends) == pytest.approx(np.array([[edge[0], -0.2, edge[2]], edge]))


def lengths(edges):
    return np.linalg.norm(edges.ends - edges.starts, axis=1)


def rod_along_y(middle):
    rod = trimesh.creation.cylinder(0.0015, 0.19, sections=6)
    return Scene.of_mesh(rod.vertices[:, [1, 2, 0]] + middle, rod.faces, name="rod", made_of="wood")


def test_a_rod_farther_off_than_the_circle_cuts_no_edge():
    rod = rod_along_y(np.array([2.8, 0.1, 0.2]) + 0.015 * np.array([-0.7, 0, 0.7]))
    assert len(edges_of(Scene.union([cube(0.4), rod]))) == 12


def test_a_face_of_many_edges_takes_little_memory():
    """Of all pairs of its edges only those that face each other are kept, some at a time."""
    count = 2000
    turn = 2 * np.pi * np.arange(count + 1) / count
    ring = 0.4 * np.stack([np.cos(turn), np.sin(turn), 0 * turn], 1)
    middle = (ring[1:] + ring[:-1]) / 2
    into, size = -middle / np.linalg.norm(middle, axis=1, keepdims=True), 2 * np.linalg.norm(middle[0])
    both, up = np.stack([into, into], 1), np.tile([0.0, 0, 1], (count, 2, 1))
    tracemalloc.start()
    pairs = facing_pairs(ring[:-1], ring[1:], np.full(count, 2.0), both, up, np.full((count, 2), size),
                         np.zeros(count, np.int32), np.zeros((count, 2), np.int64))  # fmt: skip
    _, peak = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    assert len(pairs) == count // 2
    assert np.linalg.norm(pairs.gaps, axis=1) == pytest.approx(size)
    assert peak < 100e6
