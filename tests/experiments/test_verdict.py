"""The verdict of a run on a recording: certain offsets, what is on the map, and what is not."""

from __future__ import annotations

import numpy as np
import pytest

import ullage as ul
from ullage.data import Calibration
from ullage.experiments.verdict import verdict
from ullage.processing.scatterers import Scatterer


def test_the_verdict_compares_the_map_with_the_survey_and_the_path() -> None:
    path = ul.Trajectory.line((0, 0, 1), (2, 0, 1), rate_hz=10)
    spec = ul.RadarSpec.preset("x4m05", bins=20)
    found = Calibration(6.5, -0.3, 0.01, 0.02, 5.0, probability=0.99, modes=((6.5, -0.3, 0.99), (2.0, -0.3, 0.01)))
    frames = ul.Frames(np.zeros((len(path), 20), np.complex64), spec.range_m, path.t_ns, spec, path, calibration=found)
    grid = ul.Grid.covering(np.array([[-1.0, -1, 0], [3, 4, 2]]), 0.1)
    percent = np.full(grid.shape, -1, np.int8)
    place = np.array([1.0, 2.0, 0.5])
    percent[tuple(grid.index(place)[0][0])] = 100
    omap = ul.OccupancyMap(grid, percent)
    words, metrics = verdict(frames, omap, [Scatterer(place, 90.0, True)], np.array([place, [0.0, 3.0, 0.5]]))
    text = " ".join(words)
    assert "Clock offset +6.500 +- 0.010 s" in text
    assert "other candidates: +2.00 s" in text
    assert "(1.00, 2.00, 0.50) m is on the map" in text
    assert "(0.00, 3.00, 0.50) m is not on the map at its survey" in text
    assert "flown path" in text
    assert {one.name for one in metrics} == {"scatterers", "occupied_to_path", "reflector_to_map", "offset_shift"}
    assert "moves what is mapped by 0.005 m along the track and by 0.020 m in range" in text
    assert "settled" not in text
    words, _ = verdict(frames, omap, [], place[None], settled=True)
    assert any("reflectors settled the offsets" in one for one in words)
    on_path = np.array([1.0, 0.1, 0.4])  # in plan on the path, 0.6 m under it
    percent[tuple(grid.index(on_path)[0][0])] = 100
    both = ul.OccupancyMap(grid, percent)
    words, metrics = verdict(frames, both, [Scatterer(on_path, 90.0, True)], None)
    assert next(one.value for one in metrics if one.name == "occupied_to_path") == pytest.approx(0.61, abs=0.02)
    words, _ = verdict(frames, both, [], None)
    assert any("the map is wrong there" in one for one in words)
    assert any("No place reflects coherently" in one for one in words)
