"""Reflection coefficients of the ray model come back from its own recordings."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

import ullage as ul
from ullage.radar.reflection_fit import fit_reflections
from ullage.world.scene import Scene

PATH = ul.Trajectory.line((0, -1, 0), (0, 1, 0), 0.5, 5)
SPEC = ul.RadarSpec.preset("x4m05")
TRUE = {"near": 0.35, "far": 0.8}


def world(near: float = 0.35, far: float = 0.8) -> Scene:
    parts = []
    for name, value, distance, side in (("near", near, 2.0, 0.8), ("far", far, 4.0, 3.0)):
        plate = ul.scenes.plate(side, side, distance)
        thing = replace(plate.objects[0], name=name, material=plate.objects[0].material.but(reflection=value))
        parts.append(replace(plate, objects=(thing,)))
    return Scene.union(parts)


def test_coefficients_come_back_without_noise() -> None:
    frames = ul.simulate(world(), PATH, SPEC.but(noise=None), fidelity="thesis")
    fit = fit_reflections(frames, world(1.0, 1.0))
    assert dict(zip((name.split("/")[-1] for name in fit.names), fit.coefficient, strict=True)) == pytest.approx(
        TRUE, rel=0.02
    )
    assert fit.misfit < 0.02


def test_coefficients_come_back_from_noise_within_their_sigmas() -> None:
    frames = ul.simulate(world(), PATH, SPEC, fidelity="thesis", seed=4)
    fit = fit_reflections(frames, world(0.1, 0.1))
    assert fit.coefficient == pytest.approx([0.35, 0.8], rel=0.15)
    assert np.all(fit.sigma > 0)
    assert np.all(fit.sigma < 0.05)


def test_another_gain_scales_all_alike() -> None:
    frames = ul.simulate(world(), PATH, SPEC.but(noise=None), fidelity="thesis")
    fit = fit_reflections(replace(frames, samples=7 * frames.samples), world(1, 1))
    assert fit.coefficient[1] / fit.coefficient[0] == pytest.approx(0.8 / 0.35, rel=0.03)


def test_an_object_that_no_ray_meets_stays_unknown() -> None:
    behind = ul.scenes.plate(0.5, 0.5, -3.0)
    frames = ul.simulate(world(), PATH, SPEC.but(noise=None), fidelity="thesis")
    fit = fit_reflections(frames, Scene.union([world(1, 1), behind]))
    assert np.isnan(fit.coefficient[2])
    assert np.isinf(fit.sigma[2])


def test_frames_without_poses_or_echo_are_refused() -> None:
    frames = ul.simulate(world(), PATH, SPEC.but(noise=None), fidelity="thesis")
    with pytest.raises(ul.InputError, match="no poses"):
        fit_reflections(replace(frames, poses=None, truth=None), world())
    with pytest.raises(ul.InputError, match="no echo"):
        fit_reflections(replace(frames, samples=0 * frames.samples), world())
