"""The calibration flight, and the command that plans one or calibrates a recording."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import pytest

from ullage.cli import main
from ullage.experiments.calibration_flight import LEGS, Planned, planned

RAIL = Path(__file__).parents[3] / "shared" / "data" / "pulson440" / "rail_a"


@pytest.fixture(scope="module")
def flight() -> Planned:
    return planned("", reflectors=None, radar="pulson440")


def test_the_flight_determines_all_nine_without_a_survey(flight: Planned) -> None:
    plan = flight.plan(surveyed=False)
    assert plan.undetermined == ()
    assert (plan.sigma < [one.wanted for one in plan.quantities]).all()


def test_every_leg_is_needed_for_what_it_is_flown_for(flight: Planned) -> None:
    assert len(flight.legs) == len(LEGS)
    whole = flight.plan(surveyed=False).sigma
    growth = [flight.plan(surveyed=False, but=k).sigma / whole for k in range(len(LEGS))]
    assert [round(float(one.max()), 1) >= 1.5 for one in growth] == [True] * len(LEGS)


def test_the_legs_are_flown_without_jumps(flight: Planned) -> None:
    apart = [np.linalg.norm(after.position[0] - before.position[-1])
             for before, after in zip(flight.legs, flight.legs[1:], strict=False)]  # fmt: skip
    assert max(apart) < 0.02


def test_the_command_prints_the_table_of_a_track(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    rows = "".join(f"{k / 20} {0} {k / 100} 1.5 0 0 0 1\n" for k in range(400))
    (tmp_path / "line.txt").write_text(rows)
    (tmp_path / "survey.csv").write_text("x_m,y_m,z_m\n3,1,1\n2.5,3,2\n")
    main_words(["calibrate", "--plan", str(tmp_path / "line.txt"), "--reflectors", str(tmp_path / "survey.csv")])
    said = capsys.readouterr().out
    assert "2 reflectors, at (3.0, 1.0, 1.0), (2.5, 3.0, 2.0) m" in said
    assert re.search(r"clock +10 ms +not shown +not shown", said)
    assert "clock by +10 ms with lever arm y by -2 mm" in said  # at 0.2 m/s along y, even with a survey
    assert "Lower bounds" in said


def main_words(words: list[str]) -> None:
    with pytest.raises(SystemExit) as end:
        main(words)
    assert end.value.code in (0, None)


@pytest.mark.parametrize(
    ("words", "says"),
    [
        (["calibrate"], "no recording"),
        (["calibrate", "--plan", "nowhere.csv"], "no such track"),
        (["calibrate", "nowhere.mcap"], "no such file"),
        (["calibrate", "--plan", "--radar", "x5"], "no radar preset 'x5'"),
    ],
)
def test_what_cannot_be_planned_is_refused_in_one_line(
    words: list[str], says: str, capsys: pytest.CaptureFixture[str]
) -> None:
    with pytest.raises(SystemExit) as end:
        main(words)
    assert end.value.code == 2
    said = capsys.readouterr().err.strip()
    assert says in said
    assert len(said.splitlines()) == 1


@pytest.mark.slow
@pytest.mark.skipif(not RAIL.exists(), reason="the real recordings are not here")
def test_the_command_calibrates_a_recording_without_a_map(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    main_words(["calibrate", str(RAIL)])
    said = capsys.readouterr().out
    assert float(re.search(r"pose clock less radar clock +([+-][\d.]+) s", said)[1]) == pytest.approx(4.476, abs=0.02)  # type: ignore[index]
    assert "the axes and attitudes of the track are unchecked" in said
    assert list(tmp_path.iterdir()) == []
