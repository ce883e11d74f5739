"""Recordings beside simulations: what is measured on both, the page, and what is refused."""

from __future__ import annotations

from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

import ullage as ul
from studies.validation.recordings import Comparison, count_behind
from studies.validation.recordings_page import bounded, unexplained, write_recordings_page
from studies.validation.validate import against_recordings
from ullage.cli import main

X4 = Path(__file__).parents[3] / "shared" / "data" / "x4"
SPEC = ul.RadarSpec.preset("pulson440", bins=330, range_start_m=0.7, noise=None)


def along_a_bend(places: list[tuple[float, float, float]], *, bend_m: float = 0.5) -> ul.Frames:
    """Frames of unit echoes at these places in noise, flown along a bend, the antenna pointing east."""
    s = np.linspace(0, 1, 300)
    position = np.stack([bend_m * np.sin(3 * s), 4 * s, 1.2 + bend_m * np.sin(5 * s)], axis=1)
    path = ul.Trajectory((np.arange(300) * 20_000_000).astype(np.int64), position, np.tile([0.0, 0, 0, 1], (300, 1)))
    samples = np.random.default_rng(4).normal(0, 0.5, (300, 330))
    for place in places:
        away = SPEC.range_m - np.linalg.norm(position - place, axis=1)[:, None]
        pulse = np.exp(-0.5 * (away * 2 / 299_792_458 / SPEC.pulse_sigma_s) ** 2)
        samples += pulse * np.cos(4 * np.pi / SPEC.wavelength_m * away)
    return ul.Frames(samples, SPEC.range_m, path.t_ns, SPEC, poses=path, unit="normalised")


@pytest.mark.slow
def test_scatterers_behind_the_antenna_are_counted() -> None:
    ahead, behind = (3.0, 2.0, 0.3), (-2.2, 2.5, 0.5)
    assert count_behind(along_a_bend([ahead, behind])) == (1, 2)
    assert count_behind(along_a_bend([ahead], bend_m=0.0)) is None  # a straight track cannot tell the sides apart


def compared(*, surveyed: bool = True, **added_db: float) -> Comparison:
    """A comparison that agrees, but for decibels added to its simulation in the bands near, middle and far."""
    range_m = np.arange(0.5, 11.5, 0.05)
    simulated = np.full(len(range_m), 30.0)
    for name, low, high in (("near", 1.0, 3.0), ("middle", 3.0, 4.5), ("far", 4.5, 11.0)):
        simulated[(range_m >= low) & (range_m < high)] += added_db.get(name, 0.0)
    fits: Any = SimpleNamespace(misfit={name: SimpleNamespace(value=0.0) for name in ("noise", "correlation_lag_1")})
    case: Any = SimpleNamespace(what="radar")
    point = {"error": 0.01, "width_x_6db": 0.1, "width_y_6db": 0.1}
    profiles = {"recorded": np.full(len(range_m), 30.0), "world": simulated, "receiver": simulated}
    return Comparison(case, fits, range_m, profiles, {}, points=(point, point) if surveyed else None)


@pytest.mark.parametrize(
    ("added_db", "broken"),
    [
        ({}, []),
        ({"near": 5.0}, ["radar: level from 1 to 3 m"]),
        ({"near": -5.0}, ["radar: level from 1 to 3 m"]),
        ({"middle": 7.0}, ["radar: level from 3 to 4.5 m, simulated above recorded"]),
        ({"far": 7.0}, ["radar: level from 4.5 to 11 m, simulated above recorded"]),
        ({"middle": -20.0, "far": -25.0}, []),  # what is not known of a place: stated, not bounded
    ],
)
def test_a_level_out_of_its_bound_breaks_it(added_db: dict[str, float], broken: list[str]) -> None:
    assert [row.oracle for row in bounded(compared(**added_db)) if not row.passed] == broken


def test_decibels_without_a_cause_are_stated_for_every_band() -> None:
    said = list(unexplained(compared(middle=-20.0, far=-40.0)))
    assert said == ["radar: 20.0 dB of 30.0 dB from 3 to 4.5 m are not explained",
                    "radar: 30.0 dB of 30.0 dB from 4.5 to 11 m are not explained"]  # fmt: skip
    assert len(list(unexplained(compared(surveyed=False)))) == 3


def test_a_folder_without_recordings_is_refused(tmp_path: Path) -> None:
    with pytest.raises(ul.InputError, match=r"no recording.*pulson440 or x4"):
        against_recordings(tmp_path, tmp_path / "out")


def test_the_command_refuses_it_in_one_line(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit) as end:
        main(["validate", "--recordings", str(tmp_path), "--out", str(tmp_path / "out")])
    assert end.value.code == 2
    assert capsys.readouterr().err.count("\n") == 1
    assert not (tmp_path / "out").exists()


@pytest.mark.slow
@pytest.mark.skipif(not X4.exists(), reason="the real recordings are not here")
def test_the_page_sets_a_real_recording_beside_a_room(tmp_path: Path) -> None:
    name = "xethru_baseband_iq_20170913_150437.dat"
    (tmp_path / "data" / "x4").mkdir(parents=True)
    (tmp_path / "data" / "x4" / name).symlink_to(X4 / name)
    rows = write_recordings_page(tmp_path / "data", tmp_path / "docs", report=lambda _: None)
    assert len(rows) == 2
    assert all(row.passed for row in rows)
    page = (tmp_path / "docs" / "validation_recordings.md").read_text()
    assert "| X4M300 of 2017 | 1 to 3 m | 40." in page
    assert (tmp_path / "docs" / "pictures" / "validation" / "x4-2017.png").stat().st_size > 10_000
