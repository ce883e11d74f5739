"""The command that fits reflection coefficients to a recording."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

import ullage as ul
from studies.fit_reflections import fit_recording, main
from ullage.config import WorldSpec
from ullage.experiments.simulated import load_world


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
