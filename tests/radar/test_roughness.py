"""Rough surfaces: power lost to the mirror echo comes back diffuse, from scatterers that stay where they are."""

import numpy as np
import pytest

import ullage as ul
from ullage.geometry import C0
from ullage.radar.context import antenna_pair, radar_context, radar_frame
from ullage.radar.penetration import coherent
from ullage.radar.physical import accumulate, echoes, path_gain_cw
from ullage.radar.roughness import DiffuseScatterers, diffuse_scatterers_of, spectrum
from ullage.world.materials import material
from ullage.world.scene import Scene

RADAR = ul.RadarSpec.preset("x4m05", antenna={"kind": "isotropic"}, noise=None)
WAVE = 2 * np.pi * RADAR.center_hz / C0
HERE = ul.Trajectory.stationary()


def rough(size, distance, *, height=1e-3, length=0.02, yaw_deg=0.0):
    plate = ul.scenes.plate(size, size, distance, yaw_deg=yaw_deg)
    object_id = material("pec").but(roughness_m=height, correlation_m=length)
    return Scene.of_mesh(plate.vertices, plate.faces, name="plate", made_of=object_id)


def diffuse(scene, seed, spec=RADAR, position=(0, 0, 0)):
    """The diffuse echoes alone at one pose, at the carrier."""
    from ullage.radar.roughness import accumulate_diffuse_scatterers

    context = radar_context(scene, spec, seed=seed)
    frame = radar_frame(context, antenna_pair(spec, np.asarray(position, float), np.eye(3)))
    return accumulate_diffuse_scatterers(frame).echo.sum()


@pytest.mark.parametrize("height", [2e-4, 1e-3, 3e-3, 0.02])
def test_what_the_mirror_echo_loses_is_what_scatters(height):
    """The lobe over all directions holds 1 - exp(-g), for any correlation length, up to the waves that run along."""
    for cosine in (1.0, 0.6):
        for length in (0.1, 1.0):
            object_id = material("pec").but(roughness_m=height, correlation_m=length)
            sine = np.geomspace(1e-5, 3e5, 4000)  # past 1 there are no waves: the whole spectrum is summed here
            power = spectrum(object_id, WAVE, np.full(len(sine), cosine), sine)
            total = np.trapezoid(power * (2 * WAVE) ** 2 * sine * sine, np.log(sine)) / (2 * np.pi)
            assert total + coherent(WAVE * height, cosine) ** 2 == pytest.approx(1, abs=3e-3)


@pytest.mark.parametrize(("height", "yaw"), [(1e-3, 0), (1e-3, 30), (4e-3, 30)])
def test_mean_power_follows_the_kirchhoff_law(height, yaw):
    """Over many seeds: the integral of cos^2 / (16 pi^2 r^4) times the spectrum."""
    size, distance = 0.8, 3.0
    scene = rough(size, distance, height=height, yaw_deg=yaw)
    power = [abs(diffuse(scene, seed)) ** 2 for seed in range(400)]
    side = (np.arange(80) + 0.5) / 80 * size - size / 2
    y, z = np.meshgrid(side, side)
    a = np.radians(yaw)
    p = np.stack([distance - y * np.sin(a), y * np.cos(a), z], -1)
    r = np.linalg.norm(p, axis=-1)
    cosine = abs(p @ [np.cos(a), np.sin(a), 0]) / r
    lobe = np.interp(cosine.ravel(), np.linspace(0, 1, 400),
                     spectrum(scene.objects[0].material, WAVE, np.linspace(0, 1, 400)))  # fmt: skip
    want = np.sum(cosine.ravel() ** 2 / (16 * np.pi**2 * r.ravel() ** 4) * lobe) * (size / 80) ** 2
    assert np.mean(power) == pytest.approx(want, rel=0.2)
    assert np.var(power) == pytest.approx(np.mean(power) ** 2, rel=0.6)  # speckle: exponential


def test_smooth_surfaces_have_none():
    smooth, marked = ul.scenes.plate(0.5, 0.5, 3.0), rough(0.5, 3.0, height=0.0)
    frames = [echoes(s, HERE, RADAR, seed=k) for s, k in ((smooth, 0), (marked, 0), (marked, 5))]
    assert (frames[0] == frames[1]).all()
    assert (frames[0] == frames[2]).all()


def test_the_same_spot_answers_the_same_phase():
    """World and radar moved together: nothing changes; another seed: another surface."""
    scene, turn = rough(0.8, 2.0), np.radians(37)
    rotate = np.array([[np.cos(turn), -np.sin(turn), 0], [np.sin(turn), np.cos(turn), 0], [0, 0, 1]])
    shift = np.array([3.0, -1.0, 2.0])
    moved = Scene.of_mesh(
        scene.vertices @ rotate.T + shift, scene.faces, name="plate", made_of=scene.objects[0].material
    )
    quat = np.array([[0, 0, np.sin(turn / 2), np.cos(turn / 2)]])
    there = ul.Trajectory(HERE.t_ns, shift[None], quat)
    a, b = echoes(scene, HERE, RADAR, seed=3), echoes(moved, there, RADAR, seed=3)
    assert abs(a - b).max() < 1e-4 * abs(a).max()
    other = echoes(scene, HERE, RADAR, seed=4)
    assert abs(a - other).max() > 1e-3 * abs(a).max()


@pytest.mark.parametrize("liquid", ["water", "sea-water", "oil", "sludge"])
@pytest.mark.parametrize("height", [1e-3, 3e-3])
def test_waves_on_a_liquid_weaken_its_mirror_echo(liquid, height):
    """The mean of the phase over Gaussian heights: exp(-(2 k s)^2 / 2) of the amplitude at right angles [Ament1953]."""
    plate = ul.scenes.plate(0.6, 0.6, 3.0)
    calm, waves = (
        Scene.of_mesh(plate.vertices, plate.faces, name="level", material=material(liquid).but(roughness_m=s))
        for s in (0.0, height)
    )
    mirrored = path_gain_cw(waves, HERE[:1], RADAR)[0] - diffuse(waves, 0)
    assert mirrored / path_gain_cw(calm, HERE[:1], RADAR)[0] == pytest.approx(
        np.exp(-2 * (WAVE * height) ** 2), rel=0.03
    )


def test_an_aperture_focuses_it():
    """Each scatterer's phase follows its own distance along a track, so apertures form speckle."""
    scene = rough(0.4, 3.0, yaw_deg=40)
    context = radar_context(scene, RADAR, seed=1)
    whole = diffuse_scatterers_of(context.world, 1)
    one = DiffuseScatterers(
        whole.points[:1], whole.normals[:1], whole.weights[:1], whole.object_ids[:1], np.array([0, 1]), np.array([0])
    )
    context.world.diffuse_scatterers[1] = one
    from ullage.radar.roughness import accumulate_diffuse_scatterers

    field = []
    for y in np.linspace(-0.5, 0.5, 41):
        at = np.array([0, y, 0])
        echo = accumulate_diffuse_scatterers(radar_frame(context, antenna_pair(RADAR, at, np.eye(3)))).echo.sum()
        field.append(echo * np.exp(2j * WAVE * np.linalg.norm(one.points[0] - at)))
    assert np.ptp(np.unwrap(np.angle(field))) < 1e-6


def test_explained_and_hidden():
    scene = rough(0.5, 3.0, yaw_deg=35)
    context = radar_context(scene, RADAR, seed=0)
    echoes = accumulate(radar_frame(context, antenna_pair(RADAR, np.zeros(3), np.eye(3))))
    assert sum(len(part.echo) for part in echoes) > 4
    screen = ul.scenes.plate(2, 2, 1.0)
    assert diffuse(Scene.union([scene, screen]), 0) == 0
    assert abs(diffuse(scene, 0)) > 0
