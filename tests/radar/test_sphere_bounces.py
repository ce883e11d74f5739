"""From wall to wall inside a ball: physical optics iterated over the wall, the middle, gaps, antennas apart."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

import ullage as ul
from studies.validation import oracles
from studies.validation.validate import sphere_wall_to_wall
from ullage.radar import walls
from ullage.radar.context import antenna_pair, radar_context, radar_frame
from ullage.world.scene import Scene

SPEC = ul.RadarSpec.preset("x4m05").but(antenna={"kind": "isotropic"})


@pytest.mark.parametrize(("away", "bounces", "within"), [(0.02, 2, 0.02), (0.1, 2, 0.01), (0.3, 2, 0.03),
                                                         (0.6, 2, 0.03), (0.8, 2, 0.02), (0.85, 3, 0.06)])  # fmt: skip
def test_it_is_physical_optics_iterated_over_the_wall(away, bounces, within):
    """Close to the middle, where each half of the wall makes an image for the other, and off it."""
    want = oracles.dense_sphere(1.0, away, 3.75e9, bounces)
    assert abs(sphere_wall_to_wall(away, 3.75e9, bounces) - want) < within * abs(want)


def inside(scene: Scene, place: tuple[float, float, float], spec: ul.RadarSpec = SPEC, bounces: int = 2) -> complex:
    """What `accumulate_inside` alone lays on the grids, at the carrier."""
    context = radar_context(scene, spec)
    antennas = antenna_pair(spec, np.array(place), np.eye(3))
    echoes = walls.accumulate_inside(radar_frame(context, antennas, None, bounces))
    return sum((part.echo.sum() for part in echoes), 0j)


def test_meshes_of_a_ball_are_one_ball():
    one, other = (inside(ul.scenes.sphere(1.0, 0.0, edge_m=edge), (0.2, 0.3, 0.1)) for edge in (0.2, 0.07))
    assert abs(one) > 1e-2
    assert one == pytest.approx(other, rel=1e-3)


def test_a_conductor_turns_the_field_twice_and_nothing_is_lost():
    """Whichever way the field stands to the plane of a ray that meets the wall at right angles."""
    true = sphere_wall_to_wall(1e-3, SPEC.center_hz, 2)
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


def sent(points: np.ndarray, place: np.ndarray, field: np.ndarray, wave: float) -> tuple[np.ndarray, np.ndarray]:
    """Electric fields (n, 3) of an isotropic antenna at points (n, 3), and how the waves travel (n, 3)."""
    paths = points - place
    far = np.linalg.norm(paths, axis=1, keepdims=True)
    paths = paths / far
    across = field - (paths @ field)[:, None] * paths
    return across / np.linalg.norm(across, axis=1, keepdims=True) * np.exp(-1j * wave * far) / far, paths


def currents(points: np.ndarray, inward: np.ndarray, known: np.ndarray, area: float, wave: float) -> np.ndarray:
    """Currents (n, 3) of physical optics where currents (n, 3) at the same points send their magnetic fields."""
    out = np.empty_like(known)
    for first in range(0, len(points), 400):
        gaps = points[first : first + 400, None] - points
        far = np.maximum(np.linalg.norm(gaps, axis=2), 1e-9)
        each = np.where(far > 1e-6, -area / (4 * np.pi) * np.exp(-1j * wave * far) * (1j * wave + 1 / far) / far**2, 0)
        for row, (a, b) in enumerate(((1, 2), (2, 0), (0, 1))):
            out[first : first + 400, row] = (each * gaps[..., a]) @ known[:, b] - (each * gaps[..., b]) @ known[:, a]
    return np.asarray(2 * np.cross(inward, out))


@pytest.mark.slow
@pytest.mark.parametrize(("place", "within"), [((0.22, 0.0, 0.0), 0.15), ((0.0, 0.1, 0.2), 0.1)])
def test_fields_turn_as_maxwells_equations_have_it(place, within):
    """Currents as vectors at 7200 points. In a ring of paths the planes that hold the field and those across it turn it
    against each other: 0.22 m off the middle a third of what it were without polarisation."""
    radius, count, field = 0.6, 7200, np.array([0.0, 0.0, 1.0])
    spec = SPEC.but(center_hz=3.0e9)
    wave, area = 2 * np.pi / spec.wavelength_m, 4 * np.pi * radius**2 / count
    turn, z = np.arange(count) * np.pi * (3 - 5**0.5), 1 - (2 * np.arange(count) + 1) / count
    inward = -np.stack([np.sqrt(1 - z * z) * np.cos(turn), np.sqrt(1 - z * z) * np.sin(turn), z], 1)
    points = -radius * inward
    electric, paths = sent(points, np.array(place), field, wave)
    made = 2 * np.cross(inward, np.cross(paths, electric))
    made = currents(points, inward, made, area, wave)
    want = -0.125j / np.pi * (electric * made).sum() * area
    assert abs(inside(ul.scenes.sphere(radius, 0.0, edge_m=0.1), place, spec) - want) < within * abs(want)
