"""From wall to wall inside a ball: physical optics iterated over the wall, the middle, gaps, antennas apart."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

import ullage as ul
from ullage.geometry import C0
from ullage.radar import ball_bounces, physical
from ullage.radar.wall_bounces import fan_of
from ullage.world.scene import Scene

SPEC = ul.RadarSpec.preset("x4m05").but(antenna={"kind": "isotropic"})


def iterated(away: float, wave: float, bounces: int, per_wave: int = 5) -> complex:
    """Path gain of currents on a ball of 1 m that send waves to all of it and make currents there, again and again.

    Electric wall and magnetic wall in the mean; all is even around the line to the radar, `away` from the middle.
    """
    wavelength = 2 * np.pi / wave
    x, shares = np.polynomial.legendre.leggauss(int(np.pi / wavelength * per_wave))
    s, turn = np.sqrt(1 - x * x), (np.arange(2 * len(x)) + 0.5) * np.pi / (2 * len(x))
    far = np.sqrt(1 + away * away - 2 * away * x)
    sent, slope = np.exp(-1j * wave * far) / far, (1 - away * x) / far
    step = np.empty((len(x), len(x)), complex)
    for row, (one, other) in enumerate(zip(x, s, strict=True)):
        gap = np.sqrt(np.maximum(2 - 2 * (one * x[row:, None] + other * s[row:, None] * np.cos(turn)), 1e-12))
        step[row, row:] = (
            np.exp(-1j * wave * gap).sum(1) * np.pi / len(turn)
        )  # cos of incidence and of leaving: gap / 2
        step[row:, row] = step[row, row:]
    electric, magnetic = slope * sent, sent
    for _ in range(bounces - 1):
        electric, magnetic = (1j / wavelength * step @ (shares * field) for field in (electric, magnetic))
    back = 1j / wavelength * 2 * np.pi * shares * sent
    return complex(wavelength / (4 * np.pi) * (back * (electric + magnetic * slope)).sum() / 2)


def rays(away: float, wave: float, bounces: int) -> complex:
    """The same by the fan of rays, path gain of reflections of 1."""
    place = np.array([away, 0.0])
    fan = fan_of(1.0, place, place, bounces, wave)
    return complex(2 * (ball_bounces.fan_weights(fan) * np.exp(-1j * wave * fan.along[-1])).sum())


@pytest.mark.parametrize(("away", "bounces", "within"), [(0.02, 2, 0.02), (0.1, 2, 0.01), (0.3, 2, 0.03),
                                                         (0.6, 2, 0.03), (0.8, 2, 0.02), (0.85, 3, 0.06)])  # fmt: skip
def test_it_is_physical_optics_iterated_over_the_wall(away, bounces, within):
    """Close to the middle, where each half of the wall makes an image for the other, and off it."""
    wave = 2 * np.pi / 0.08
    want = iterated(away, wave, bounces)
    assert abs(rays(away, wave, bounces) - want) < within * abs(want)


def inside(scene: Scene, place: tuple[float, float, float], spec: ul.RadarSpec = SPEC, bounces: int = 2) -> complex:
    """What `lay_inside` alone lays on the grids, at the carrier."""
    ready = physical.bench(scene, spec)
    view = physical.view_of(spec, np.array(place), np.eye(3))
    grids = np.zeros((3, ready.places), complex)
    laid = ball_bounces.lay_inside(ready, ready.world.parts(None), view, bounces, grids)
    return sum((part.echo.sum() for part in laid), 0j)


def test_meshes_of_a_ball_are_one_ball():
    one, other = (inside(ul.scenes.sphere(1.0, 0.0, edge_m=edge), (0.2, 0.3, 0.1)) for edge in (0.2, 0.07))
    assert abs(one) > 1e-2
    assert one == pytest.approx(other, rel=1e-3)


def test_a_conductor_turns_the_field_twice_and_nothing_is_lost():
    """Whichever way the field stands to the plane of a ray that meets the wall at right angles."""
    waves = 2 * np.pi * SPEC.center_hz / C0
    true = rays(1e-3, waves, 2)
    assert abs(inside(ul.scenes.sphere(1.0, 0.0, edge_m=0.15), (1e-3, 0.0, 0.0))) == pytest.approx(abs(true), rel=0.02)


def test_what_is_not_there_mirrors_nothing_and_what_stands_between_hides():
    ball = ul.scenes.sphere(1.0, 0.0, edge_m=0.15)
    far = ball.corners().mean(1)[:, 0] > -0.5
    bowl = replace(ball, faces=ball.faces[far], face_object=ball.face_object[far])
    assert inside(bowl, (0.2, 0.3, 0.1)) == 0  # no ball any more
    box = ul.scenes.sphere(0.1, 0.0, edge_m=0.02)
    assert inside(Scene.union([ball, box]), (0.0, 0.0, 0.0)) == 0  # round the radar
    assert inside(ball, (0.2, 0.3, 0.1), SPEC.but(antenna_offset_m=0.6)) == 0  # antennas too far from each other
    assert inside(ball, (1.3, 0.3, 0.1)) == 0  # outside
