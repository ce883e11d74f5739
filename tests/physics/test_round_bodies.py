"""Balls and rods of a few millimetres and more against the series of Mie and Bessel, and a method of moments."""

import sys
from functools import lru_cache
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
import trimesh
from scipy.spatial.transform import Rotation
from scipy.special import spherical_jn, spherical_yn

sys.path.insert(0, str(Path(__file__).parent))
import oblique

import ullage as ul
from studies.validation.oracles import mie_width, wire_gain
from studies.validation.rows import db
from ullage.geometry import C0
from ullage.radar import creeping
from ullage.radar.context import radar_context
from ullage.radar.physical import path_gain_cw
from ullage.radar.pulse import spectrum
from ullage.world.materials import material

F_HZ = oblique.F_HZ
FAR_M = 3.0


def radar(name="x4m05", polarization="vertical", **changes):
    antenna = {"kind": "isotropic", "polarization": polarization}
    return ul.RadarSpec.preset(name, noise=None, antenna=antenna, **changes)


def series(radius_m, hz, eps=None):
    """Scattering length straight back [m]: the fields matched on the surface, order by order; eps None: a conductor."""
    k = 2 * np.pi * hz / C0
    x, total = k * radius_m, 0j
    for n in range(1, int(np.max(x + 4 * x ** (1 / 3))) + 10):
        j, dj = spherical_jn(n, x), spherical_jn(n, x) / x + spherical_jn(n, x, derivative=True)
        y, dy = spherical_yn(n, x), spherical_yn(n, x) / x + spherical_yn(n, x, derivative=True)
        h, dh = j - 1j * y, dj - 1j * dy
        if eps is None:
            magnetic, electric = -j / h, -dj / dh
        else:
            m = np.sqrt(complex(eps))
            i = spherical_jn(n, m * x)
            di = i / x + m * spherical_jn(n, m * x, derivative=True)
            magnetic = np.linalg.solve([[h, -i], [dh, -di]], [-j, -dj])[0]
            electric = np.linalg.solve([[h, -m * i], [dh, -di / m]], [-j, -dj])[0]
        total += (-1) ** n * (2 * n + 1) * (electric - magnetic)
    return -1j * total / (2 * k)


def gain(radius_m, hz, eps=None):
    """Path gain of a ball whose centre lies at FAR_M, for isotropic antennas."""
    wave = 4 * np.pi * hz / C0
    return series(radius_m, hz, eps) / wave / (FAR_M * (FAR_M - radius_m)) * np.exp(-1j * wave * FAR_M)


@lru_cache
def waveform(spec, radius_m):
    """Frame (b) of a conducting ball: its spectrum, transformed."""
    offset = np.linspace(-4, 4, 241) / (2 * np.pi * spec.pulse_sigma_s)
    offset = offset[spec.center_hz + offset > 5e8]
    weight = spectrum(spec, offset)
    echo = gain(radius_m, spec.center_hz + offset) * weight / weight.sum()
    return np.exp(2j * np.pi * np.multiply.outer(2 * spec.range_m / C0, offset)) @ echo


@pytest.mark.parametrize("radius_m", [0.005, 0.01, 0.03, 0.3])
def test_the_series_of_this_test(radius_m):
    """As the radar equation has it with the published cross section."""
    want = C0 / F_HZ * np.sqrt(mie_width(radius_m, F_HZ)) / (4 * np.pi) ** 1.5 / (FAR_M * (FAR_M - radius_m))
    assert abs(gain(radius_m, F_HZ)) == pytest.approx(want, rel=1e-9)


@pytest.mark.parametrize("ka", [0.5, 0.8, 1, 1.4, 2, 2.7, 4, 6, 8, 12, 20, 40])
def test_conducting_balls_of_any_size(ka):
    radius = ka * C0 / (2 * np.pi * F_HZ)
    own = path_gain_cw(ul.scenes.sphere(radius, FAR_M), ul.Trajectory.stationary(), radar(), F_HZ)[0]
    assert abs(db(own) - db(gain(radius, F_HZ))) < 0.5
    assert abs(np.angle(own / gain(radius, F_HZ), deg=True)) < 5


@pytest.mark.parametrize("radius_m", [0.005, 0.01, 0.02, 0.05, 0.1])
@pytest.mark.parametrize("of", ["concrete", "water"])
def test_dielectric_balls(of, radius_m):
    """Deep minima are off by more decibels; as parts of a conductor's echo all are right."""
    own = path_gain_cw(ul.scenes.sphere(radius_m, FAR_M, of), ul.Trajectory.stationary(), radar(), F_HZ)[0]
    want = gain(radius_m, F_HZ, material(of).permittivity(F_HZ))
    assert abs(own - want) < 0.06 * max(abs(want), radius_m / (8 * np.pi * F_HZ / C0 * FAR_M**2))


@pytest.mark.parametrize("radius_m", [0.005, 0.01, 0.013, 0.02, 0.05, 0.1])
@pytest.mark.parametrize("name", ["x4m05", "x4m05-8ghz", "pulson440"])
def test_pulses(name, radius_m):
    spec = radar(name, output="baseband")
    own = ul.simulate(ul.scenes.sphere(radius_m, FAR_M), ul.Trajectory.stationary(), spec, max_bounces=1).samples[0]
    want = waveform(spec, radius_m)
    assert abs(db(abs(own).max()) - db(abs(want).max())) < 0.5
    assert abs(own - want).max() < 0.08 * abs(want).max()


@pytest.mark.parametrize("radius_m", [0.01, 0.03, 0.05])
@pytest.mark.parametrize("parts", [1, 2])
def test_coarse_and_turned_balls(radius_m, parts):
    ball = trimesh.creation.icosphere(parts, radius_m)
    want = abs(waveform(radar(), radius_m)).max()
    for seed in range(2):
        places = Rotation.random(random_state=seed).apply(ball.vertices) + np.array([FAR_M, 0, 0])
        scene = ul.Scene.of_mesh(places, ball.faces, name="ball", made_of="pec")
        own = ul.simulate(scene, ul.Trajectory.stationary(), radar(), max_bounces=1).samples[0]
        assert abs(db(abs(own).max()) - db(want)) < 0.6


def test_moving_balls():
    """A ball that moves echoes as one at rest there, and one behind a plate not at all."""
    spec, here = radar(), ul.Trajectory.stationary()
    ball = ul.scenes.sphere(0.02)
    carried = ul.Trajectory.stationary((FAR_M, 0, 0))
    moving = ul.Scene.of_mesh(ball.vertices, ball.faces, name="ball", made_of="pec", motion=carried)
    want = ul.simulate(ul.scenes.sphere(0.02, FAR_M), here, spec).samples[0]
    assert abs(ul.simulate(moving, here, spec).samples[0] - want).max() < 1e-3 * abs(want).max()
    plate = ul.scenes.plate(0.5, 0.5, 2.0)
    alone, both = (ul.simulate(scene, here, spec).samples[0] for scene in (plate, plate.add(moving)))
    assert abs(both - alone).max() < 1e-3 * abs(want).max()


@pytest.mark.parametrize("radius_m", [0.003, 0.005, 0.01, 0.02, 0.05])
@pytest.mark.parametrize("field", ["vertical", "horizontal"])
def test_long_rods(radius_m, field):
    """Meshes, which are off by up to 4 dB without the difference; longer than their Fresnel zones."""
    rod, here = ul.scenes.cylinder(radius_m, 6.0, 3.0), ul.Trajectory.stationary()
    own = path_gain_cw(rod, here, radar(polarization=field), F_HZ)[0]
    assert abs(db(own) - db(wire_gain(radius_m, 3.0, F_HZ, tm=field == "vertical"))) < 0.6


def stub(radius_m, length_m, sides, rings):
    """Triangles (n, 3, 3) of an upright rod with flat ends."""
    turn = np.arange(sides) * 2 * np.pi / sides
    circle = radius_m * np.stack([np.cos(turn), np.sin(turn), 0 * turn], 1)
    levels = [circle + np.array([0, 0, z]) for z in np.linspace(-length_m / 2, length_m / 2, rings + 1)]
    levels = [levels[0] * [0, 0, 1], levels[0] * [0.5, 0.5, 1], *levels, levels[-1] * [0.5, 0.5, 1],
              levels[-1] * [0, 0, 1]]  # fmt: skip
    out = []
    for low, high in pairwise(levels):
        for a, b, c, d in zip(low, np.roll(low, -1, 0), np.roll(high, -1, 0), high, strict=True):
            out += [
                corners for corners in ((a, b, c), (a, c, d)) if np.linalg.norm(np.cross(*np.diff(corners, axis=0)))
            ]
    return np.array(out)


def test_a_stub_at_broadside():
    """Two waves long, 2 cm thick, both fields: by the method of moments, whose mesh has the volume of the rod."""
    _, _, places, axes = oblique.views((0, 5), (90,))
    round_ = np.sqrt(np.pi / 8 / np.sin(np.pi / 8))
    want = oblique.truth(stub(0.01 * round_, 0.08, 16, 16), places, axes)
    own = oblique.ours(stub(0.01, 0.08, 32, 1), places, axes, 1)
    assert abs(20 * np.log10(abs(own / want))).max() < 0.6


def test_moving_rods():
    rod, here = ul.scenes.cylinder(0.01, 0.3), ul.Trajectory.stationary()
    carried = ul.Trajectory.stationary((FAR_M, 0, 0))
    moving = ul.Scene.of_mesh(rod.vertices, rod.faces, name="rod", made_of="pec", motion=carried)
    want = ul.simulate(ul.scenes.cylinder(0.01, 0.3, FAR_M), here, radar()).samples[0]
    assert abs(ul.simulate(moving, here, radar()).samples[0] - want).max() < 1e-3 * abs(want).max()


@pytest.mark.parametrize("coat", [{"layers": [("plastic", 0.002)]}, {"roughness_m": 0.001}])
def test_coated_and_rough_bodies_stay_as_they_are(coat):
    """The series know one smooth material; what they say of the bare body must not come on top."""
    here, made_of = ul.Trajectory.stationary(), material("steel").but(**coat)
    ball, rod = (ul.Scene.of_mesh(bare.vertices, bare.faces, name="body", made_of=made_of)
                 for bare in (ul.scenes.sphere(0.02, FAR_M), ul.scenes.cylinder(0.01, 0.1, FAR_M)))  # fmt: skip
    whole, plain = (path_gain_cw(ball, here, radar(), F_HZ, edges=edges)[0] for edges in (True, False))
    assert whole == plain
    context = radar_context(rod, radar())
    assert len(context.world.rods) == 1
    assert len(creeping.rods(context)) == 0
