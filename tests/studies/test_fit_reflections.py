"""The ray model's reflection coefficients come back from its own recordings, in Python and by the command."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import ullage as ul
from studies.fit_reflections import fit_recording, fit_reflections, main
from ullage.config import WorldSpec
from ullage.experiments.simulated import load_world
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


@pytest.fixture
def recording(tmp_path: Path) -> Path:
    scene = load_world(WorldSpec(name="ntnu-plate"))
    path = ul.Trajectory.line((0, -1, 1.5), (0, 1, 1.5), 0.5, 5)
    out = ul.sink(tmp_path / "plate.mcap")
    out.write({"front": ul.simulate(scene, path, ul.RadarSpec.preset("x4m05"), fidelity="thesis", seed=2)})
    out.close()
    return tmp_path / "plate.mcap"


def test_a_recording_gives_back_its_world_s_coefficients(recording: Path) -> None:
    scene = load_world(WorldSpec(name="ntnu-plate"))
    fit = fit_recording(str(recording), "ntnu-plate")
    true = np.array([thing.material.reflection for thing in scene.objects])
    sure = fit.sigma < 0.03
    assert sure.sum() >= 2
    assert fit.coefficient[sure] == pytest.approx(true[sure], abs=0.05)
    assert np.isnan(fit.coefficient[:2]).all()  # halfway up, floor and ceiling give the same echoes


def test_bad_input_is_one_line_and_exit_code_2(recording: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main([str(recording), "no-such-world"]) == 2
    assert main([str(recording), "ntnu-plate", "back"]) == 2
    assert main([]) == 2
    lines = capsys.readouterr().err.splitlines()
    assert len(lines) == 3
    assert "no world 'no-such-world'" in lines[0]
    assert "no sensor 'back'" in lines[1]


def test_the_command_prints_every_object(recording: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main([str(recording), "ntnu-plate"]) == 0
    out = capsys.readouterr().out
    assert "misfit" in out
    assert len(out.splitlines()) == len(load_world(WorldSpec(name="ntnu-plate")).objects) + 1
