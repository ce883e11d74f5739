"""A wire over a conducting floor is the wire and what its images scatter; delays, reciprocity, shadow, materials."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.special import h2vp, hankel2, jv, jvp

import ullage as ul
from ullage.radar.physical import path_gain_cw
from ullage.world import scenes
from ullage.world.library import WORLDS

K = 2 * np.pi * 7.29e9 / 299792458


def radar(polarization="horizontal", **changes):
    return ul.RadarSpec.preset(
        "x4m05", noise=None, antenna={"kind": "isotropic", "polarization": polarization}, **changes
    )


HERE = ul.Trajectory.stationary((0, 0, 0))


def floor(depth=1.0, size=8.0, material="pec"):
    half = size / 2
    flat = scenes.plate(1, 1, 1, material=material, name="floor")
    corners = np.array([[-half, -half, -depth], [half, -half, -depth], [half, half, -depth], [-half, half, -depth]])
    return replace(flat, vertices=corners + np.array([2.0, 0, 0]))


def wire(radius, ahead=3.0, height=0.0, length=6.0):
    """Along y, so parallel to the floor and across the radar's sight."""
    return ul.Scene.of_wires([[ahead, -length / 2, height]], [[ahead, length / 2, height]], radius, name="wire")


def cw(scene, bounces, spec):
    return path_gain_cw(scene, HERE, spec, max_bounces=bounces)[0]


def bistatic(radius, r, s, psi, *, tm):
    """Field of an endless wire, image at r, receiver at s, psi between directions; over sqrt(received / sent power)."""
    n = np.arange(40)[:, None]
    z = np.array([[K * radius]])
    with np.errstate(all="ignore"):
        terms = jv(n, z) / hankel2(n, z) if tm else jvp(n, z) / h2vp(n, z)
    terms = np.where(np.isfinite(terms), terms, 0) * np.where(n == 0, 1, 2)
    series = -(terms * np.cos(n * psi)).sum()
    line = np.sqrt(2 * np.pi / K / (1 / r + 1 / s)) * np.exp(-1j * np.pi / 4) / (r * s)  # stationary phase
    wavelength = 2 * np.pi / K
    return 1j * wavelength / (4 * np.pi**2) * series * line * np.exp(-1j * K * (r + s))


@pytest.mark.parametrize("radius", [0.0005, 0.005, 0.02])
@pytest.mark.parametrize(("polarization", "sign", "tm"), [("horizontal", -1, True), ("vertical", 1, False)])
def test_a_wire_over_a_conducting_floor_is_the_wire_and_its_images(radius, polarization, sign, tm):
    """Two equal paths over floor and wire: an image that sends with the other sign, or for the field across with
    the same, seen under another angle. Direct echo, floor and corner of floor and nothing else are the rest."""
    spec = radar(polarization)
    both, alone = ul.Scene.union([floor(), wire(radius)]), floor()
    found = cw(both, 2, spec) - cw(alone, 2, spec) - cw(wire(radius), 1, spec)
    image, target = np.array([0, 0, -2.0]), np.array([3.0, 0, 0])
    r, s = np.linalg.norm(target - image), np.linalg.norm(target)
    coming, going = (target - image) / r, -target / s
    psi = np.arccos(coming @ going)
    if tm:
        turn = 1.0
    else:  # of the field across the wire: sent, as the image has it, along the wave's own cross direction
        axis = np.array([0, 1.0, 0])
        up = np.array([0, 0, 1.0])
        sent = up - (up @ (coming * [1, 1, -1])) * (coming * [1, 1, -1])
        sent = sent / np.linalg.norm(sent) * [1, 1, -1] * -1  # a conductor keeps the normal part, turns the rest
        turn = (sent @ np.cross(axis, coming)) * (up @ np.cross(axis, going)) * sign
    want = 2 * (sign * turn if not tm else sign) * bistatic(radius, r, s, psi, tm=tm)
    assert 20 * np.log10(abs(found) / abs(want)) == pytest.approx(0, abs=0.3)
    assert abs(np.angle(found / want)) < 0.1


def test_the_echo_over_the_floor_comes_at_the_images_delay():
    spec = radar()
    both = ul.Scene.union([floor(), wire(0.002)])
    at = lambda n, scene: ul.simulate(scene, HERE, spec, max_bounces=n).samples[0]  # noqa: E731
    for order, way in ((2, (3.0 + np.hypot(3, 2)) / 2), (3, np.hypot(3, 2))):
        more = at(order, both) - at(order, floor()) - at(order - 1, both) + at(order - 1, floor())
        assert spec.range_m[abs(more).argmax()] == pytest.approx(way, abs=0.03)


def test_a_wire_seen_only_over_the_mirror_is_found_and_explained():
    wall = replace(floor(), vertices=floor().vertices * 1.0)
    screen = scenes.plate(0.4, 1.0, 1.5, material="steel", name="screen")
    scene = ul.Scene.union([wall, screen, wire(0.005, length=0.3)])
    frames = ul.simulate(scene, HERE, radar(), max_bounces=3)
    told = str(ul.explain(frames, 0))
    assert "wire" in told
    assert abs(cw(ul.Scene.union([screen, wire(0.005, length=0.3)]), 1, radar()) - cw(screen, 1, radar())) < 1e-9


def test_order_of_face_and_wire_is_the_same_wave():
    """Transmitter and receiver exchanged, 0.4 m apart, over a concrete floor."""
    scene = ul.Scene.union([floor(material="concrete"), wire(0.003, height=0.3)])
    spec = radar(antenna_offset_m=0.4)
    turned = ul.Trajectory.stationary((0, 0, 0), yaw_deg=180)
    one, other = (path_gain_cw(scene, at, spec, max_bounces=3)[0] for at in (HERE, turned))
    assert abs(one) == pytest.approx(abs(other), rel=1e-6)


def test_small_and_hidden_floors_add_nothing():
    tiny = floor(size=0.5)
    spec = radar()
    more = cw(ul.Scene.union([tiny, wire(0.002)]), 3, spec) - cw(tiny, 3, spec) - cw(wire(0.002), 1, spec)
    assert abs(more) < 1e-9


@pytest.mark.slow
def test_the_crane_wire_of_the_cargo_hold_echoes_over_its_floor_as_over_a_floor_alone():
    """Among 3000 faces: what goes over the inner bottom is that of the wire and one plate at its place."""
    hold = ul.load_scene(WORLDS["cargo-hold"].path)
    wires = hold.wires
    line = ul.Scene.of_wires(wires.start, wires.end, float(wires.radius_m[0]), name="wire", made_of="steel")
    plate = floor(depth=0.0, size=30.0, material="steel")
    spec, pose = radar(), ul.Trajectory.stationary((0.1, 0, 6.6))
    found, alone = [], ul.Scene.union([plate, line])
    for scene, thing, ground in ((hold, "crane_wire", "inner_bottom"), (alone, "wire", "floor")):
        told = ul.explain(scene, pose, spec, 0, max_bounces=3, count=400)
        mine = [c for c in told if c.object == thing and set(c.via) == {ground}]
        found.append(sorted((c.bounces, c.path_gain_db, c.range_m) for c in mine))
    assert {bounces for bounces, _, _ in found[0]} == {2, 3}
    assert np.array(found[0]) == pytest.approx(np.array(found[1]), abs=0.1)
