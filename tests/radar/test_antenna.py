"""Antenna patterns: the data sheet's values, smoothness, tables, and the cube the kernels read."""

import numpy as np
import pytest

import ullage as ul
from ullage.kernels.facets import toward
from ullage.radar.antenna import cube, gain

RNG = np.random.default_rng(3)


def at(degrees, plane):
    angle = np.radians(degrees)
    side = [np.sin(angle), 0.0] if plane == "azimuth" else [0.0, np.sin(angle)]
    return np.array([[np.cos(angle), *side]])


@pytest.mark.parametrize("plane", ["azimuth", "elevation"])
@pytest.mark.parametrize(("degrees", "low", "high"), [(0, 5.9, 6.0), (32.5, 2.6, 3.3), (47.5, -1, 1), (90, -8, -5)])
def test_x4a02_data_sheet(plane, degrees, low, high):
    level = 20 * np.log10(gain(ul.AntennaSpec(kind="x4a02"), at(degrees, plane))[0])
    assert low <= level <= high


def test_no_hard_edge():
    angle = np.radians(np.arange(0, 180, 0.25))
    way = np.stack([np.cos(angle), np.sin(angle), 0 * angle], 1)
    for kind in ("x4a02", "cosine"):
        assert abs(np.diff(gain(ul.AntennaSpec(kind=kind), way))).max() < 0.02


def test_cosine_opening_and_directivity():
    spec = ul.AntennaSpec(kind="cosine", azimuth_deg=40, elevation_deg=80, gain_dbi=10)
    assert 20 * np.log10(gain(spec, at(20, "azimuth"))[0]) == pytest.approx(7, abs=0.02)
    assert 20 * np.log10(gain(spec, at(40, "elevation"))[0]) == pytest.approx(7, abs=0.02)
    ball = RNG.standard_normal((200_000, 3))
    assert np.mean(gain(ul.AntennaSpec(kind="cosine"), ball) ** 2) == pytest.approx(1, abs=0.02)


def test_cube_is_the_pattern():
    for spec in (ul.AntennaSpec(), ul.AntennaSpec(kind="cosine", azimuth_deg=50), ul.AntennaSpec(kind="isotropic")):
        way = RNG.standard_normal((500, 3))
        way /= np.linalg.norm(way, axis=1, keepdims=True)
        ours = [toward(cube(spec), False, np.eye(3)[None, None], 0, 0, *w) for w in way]
        assert np.allclose(ours, gain(spec, way), atol=4e-3)


def test_table(tmp_path):
    file = tmp_path / "pattern.csv"
    rows = [f"{a},{e},{6 - abs(a) / 10 - abs(e) / 20}" for a in range(-180, 181, 10) for e in range(-90, 91, 10)]
    file.write_text("azimuth_deg,elevation_deg,gain_dbi\n" + "\n".join(rows))
    spec = ul.AntennaSpec(kind="table", file=str(file))
    assert 20 * np.log10(gain(spec, at(30, "azimuth"))[0]) == pytest.approx(3)
    file2 = tmp_path / "gap.csv"
    file2.write_text("azimuth_deg,elevation_deg,gain_dbi\n0,0,1\n0,10,1\n10,0,1\n20,20,3\n")
    with pytest.raises(ul.InputError, match="the antenna table has gaps"):
        gain(ul.AntennaSpec(kind="table", file=str(file2)), at(0, "azimuth"))
    with pytest.raises(ul.InputError, match="cannot read the antenna table"):
        gain(ul.AntennaSpec(kind="table", file=str(tmp_path / "none.csv")), at(0, "azimuth"))
    with pytest.raises(ul.InputError, match="needs a file"):
        gain(ul.AntennaSpec(kind="table"), at(0, "azimuth"))
