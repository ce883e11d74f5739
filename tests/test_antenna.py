"""Antenna patterns: the data sheet's values, smoothness, tables, and the cube the kernels read."""

import numpy as np
import pytest

import ullage as ul
from ullage.antenna import boresight_pattern, cube, gain
from ullage.kernels.facets import toward
from ullage.processing.inverse_sensor import mirror_m

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
        ours = [toward(cube(spec)[None].astype(complex), False, np.eye(3)[None, None], 0, 0, *w) for w in way]
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


def same_as_a_table(tmp_path, spec):
    """An antenna given by a table of another's gains."""
    rows = ["azimuth_deg,elevation_deg,gain_dbi"]
    for az in range(-180, 181, 3):
        for el in range(-90, 91, 3):
            a, e = np.radians([az, el])
            unit = [[np.cos(e) * np.cos(a), np.cos(e) * np.sin(a), np.sin(e)]]
            rows.append(f"{az},{el},{20 * np.log10(gain(spec, unit)[0])}")
    file = tmp_path / "same.csv"
    file.write_text("\n".join(rows))
    return ul.AntennaSpec(kind="table", file=str(file))


def test_a_table_of_an_antenna_has_its_beam_and_side_lobes(tmp_path):
    model = boresight_pattern(ul.AntennaSpec())
    table = boresight_pattern(same_as_a_table(tmp_path, ul.AntennaSpec()))
    assert np.degrees(model.half_power_rad) == pytest.approx(32.5, abs=1e-9)
    assert table.half_power_rad == pytest.approx(model.half_power_rad, abs=np.radians(0.3))
    assert table.main_lobe_rad == pytest.approx(model.main_lobe_rad, abs=np.radians(0.3))
    assert table.peak_dbi == pytest.approx(model.peak_dbi, abs=0.01)
    assert table.gain_dbi(np.arccos(0.8)) == pytest.approx(model.gain_dbi(np.arccos(0.8)), abs=0.1)


def test_a_pattern_that_differs_between_planes_has_a_greatest_gain_and_a_mean_opening():
    spec = ul.AntennaSpec(kind="cosine", azimuth_deg=40, elevation_deg=80)
    pattern = boresight_pattern(spec)
    k = int(np.argmin(abs(pattern.angle_rad - np.radians(30))))
    levels = [20 * np.log10(gain(spec, at(30, plane))[0]) for plane in ("azimuth", "elevation")]
    assert pattern.greatest_dbi[k] == pytest.approx(max(levels), abs=1e-6)
    assert 2 * np.degrees(pattern.half_power_rad) == pytest.approx(np.sqrt(40 * 80), abs=0.3)


def test_an_antenna_without_a_lobe_has_the_same_gain_all_round():
    pattern = boresight_pattern(ul.AntennaSpec(kind="isotropic"))
    assert pattern.half_power_rad == pattern.main_lobe_rad == np.pi
    assert pattern.gain_dbi(np.array([0.0, 1.5, 3.1])) == pytest.approx(0.0)


def test_a_mirror_is_heard_as_its_image():
    """A perfect mirror at R answers as a second antenna at 2 R: lambda / (8 pi R) between antennas of 0 dBi."""
    spec, path = ul.RadarSpec.preset("x4m05"), ul.Trajectory.stationary(n=1)
    frames = ul.Frames(np.zeros((1, spec.bins), np.complex64), spec.range_m, path.t_ns, spec)
    assert mirror_m(frames) == pytest.approx(spec.wavelength_m / (8 * np.pi))


def test_a_sensors_unknown_unit_hides_how_strong_a_wall_could_be():
    spec, path = ul.RadarSpec.preset("x4m05"), ul.Trajectory.stationary(n=1)
    frames = ul.Frames(np.zeros((1, spec.bins), np.complex64), spec.range_m, path.t_ns, spec, unit="normalised")
    assert mirror_m(frames) == np.inf


POWER = 6


def far_field(path, power, *, axes=((0, 0, 1), (1, 0, 0)), turns=range(0, 360, 5), lobes=((7.29e9, POWER),)):
    """Write a far field of CST with a lobe ((1 + cos) / 2)^m about its own z, half of it in each polarisation.

    Each of the lobes has a frequency and an m.
    """
    z, x = np.array(axes, float)
    tilts = np.arange(0.0, 181.0, 5.0)
    lines = [
        "// CST Farfield Source File",
        "// Version:",
        "3.0",
        "// Data Type",
        "Farfield",
        "// #Frequencies",
        len(lobes),
    ]
    lines += [
        "// Position",
        "0 0 0",
        "// zAxis",
        *z,
        "// xAxis",
        *x,
        "// Radiated/Accepted/Stimulated Power , Frequency",
    ]
    for hz, _ in lobes:
        lines += [*power, hz]
    for _, m in lobes:
        field = np.sqrt(0.5) * ((1 + np.cos(np.radians(tilts))) / 2) ** (m / 2)
        lines += ["// >> Total #phi samples, total #theta samples", len(turns), len(tilts), "// >> Phi, Theta, ..."]
        lines += [f"{t} {u} {f} 0 0 {f}" for t in turns for u, f in zip(tilts, field, strict=True)]
    path.write_text("\n".join(map(str, lines)) + "\n")
    return ul.AntennaSpec(kind="table", file=str(path))


def test_a_radar_takes_the_far_field_nearest_to_its_carrier(tmp_path):
    lobes = ((6e9, 2), (7.2e9, 4), (8.7e9, 8))
    antenna = far_field(tmp_path / "a.ffs", (-1, -1, -1), lobes=lobes)
    for hz, m in ((6.5e9, 2), (7.29e9, 4), (8.8e9, 8)):
        radar = ul.RadarSpec(center_hz=hz, antenna=antenna)
        assert gain(radar.antenna, (1, 0, 0))[0] ** 2 == pytest.approx(m + 1, rel=0.01)
        assert gain(radar.but(center_hz=6e9).antenna, (1, 0, 0))[0] ** 2 == pytest.approx(3, rel=0.01)
    assert gain(antenna, (1, 0, 0))[0] ** 2 == pytest.approx(5, rel=0.01)


@pytest.mark.parametrize(("power", "share"), [((-1, -1, -1), 1.0), ((0.4, 0.45, 0.8), 0.5)])
@pytest.mark.parametrize("turns", [range(0, 360, 5), range(-180, 181, 5)])
def test_a_far_field_of_cst_has_its_directivity_and_efficiency(tmp_path, power, share, turns):
    """The lobe's directivity is m + 1 by the integral over the sphere."""
    antenna = far_field(tmp_path / "a.ffs", power, turns=turns, lobes=((7.29e9, POWER),) * 3)
    unit = np.array([[1, 0, 0], [np.cos(0.5), np.sin(0.5), 0], [np.cos(1.2), 0, -np.sin(1.2)]])
    wanted = share * (POWER + 1) * ((1 + unit[:, 0]) / 2) ** POWER
    assert gain(antenna, unit) ** 2 == pytest.approx(wanted, rel=0.01)


def test_a_far_field_of_cst_lies_along_its_axes(tmp_path):
    """z of the file is the boresight, x is left, y is up; the lobe points to its own z axis."""
    for axes, unit in [(((1, 0, 0), (0, 1, 0)), (0, 1, 0)), (((0, 1, 0), (0, 0, 1)), (0, 0, 1))]:
        antenna = far_field(tmp_path / f"{unit[1]}.ffs", (-1, -1, -1), axes=axes)
        assert gain(antenna, unit)[0] ** 2 == pytest.approx(POWER + 1, rel=0.01)


def damaged(*, count="1", z="1", field="1", step=30):
    """The text of a far field that is whole by default."""
    cuts = [f"{phi} {theta} {field} 0 0 0" for phi in range(0, 360, 30) for theta in range(0, 181, step)]
    return "\n".join(
        ["3.0", "Farfield", count, "0 0 0", f"0 0 {z}", "1 0 0", "1 1 1 7e9", f"12 {180 // step + 1}", *cuts]
    )


def test_an_even_far_field_has_no_gain(tmp_path):
    path = tmp_path / "even.ffs"
    path.write_text(damaged())
    assert gain(ul.AntennaSpec(kind="table", file=str(path)), (0, 1, 0))[0] == pytest.approx(1, abs=0.02)


@pytest.mark.parametrize(
    "text",
    ["", "3.0\nFarfield\n1\n0 0 0", "3.0\nFarfield\nnan nan", damaged(count="inf"), damaged(z="0"), damaged(field="0"),
     damaged(step=90)],
)  # fmt: skip
def test_a_broken_far_field_is_refused(tmp_path, text):
    path = tmp_path / "b.ffs"
    path.write_text(text)
    with pytest.raises(ul.InputError, match=r"b\.ffs: not a far field"):
        gain(ul.AntennaSpec(kind="table", file=str(path)), (1, 0, 0))


def planet(path, across, upright, gain_line="GAIN 10 dBi", step=1):
    """Write an MSI Planet file of attenuations [dB] over both cuts' angles [deg]."""
    lines = ["NAME an antenna", "FREQUENCY 7290", gain_line, "TILT", "COMMENT gain 3"]
    for name, cut in (("HORIZONTAL", across), ("VERTICAL", upright)):
        angles = np.arange(0, 360, step)
        lines += [f"{name} {len(angles)}", *(f"{angle}.0\t{cut(np.radians(angle)):.4f}" for angle in angles)]
    path.write_text("\r\n".join(lines) + "\r\n")
    return ul.AntennaSpec(kind="table", file=str(path))


def level(antenna, az_deg, el_deg):
    """Gain [dBi] at azimuths to the left and elevations upwards."""
    az, el = np.radians(az_deg), np.radians(el_deg)
    unit = np.stack(np.broadcast_arrays(np.cos(el) * np.cos(az), np.cos(el) * np.sin(az), np.sin(el)), -1)
    return 20 * np.log10(gain(antenna, unit))


def test_cuts_of_planet_are_met_all_round(tmp_path):
    """The horizontal angle runs clockwise from above; the vertical one to the ground, behind and over the top."""

    def across(angle):
        return 12 * (1 - np.cos(angle)) + 3 * np.sin(angle / 2) ** 2 * (1 + np.sin(angle)) * abs(np.sin(angle))

    def upright(angle):
        return 9 * (1 - np.cos(angle)) + 6 * np.sin(angle / 2) ** 2 + 2 * np.sin(angle) ** 2 * (1 + np.sin(angle))

    antenna = planet(tmp_path / "a.msi", across, upright)
    az, el = np.arange(-180, 181, 15), np.arange(-90, 91, 15)
    assert level(antenna, az, 0) == pytest.approx(10 - across(np.radians(-az)), abs=0.02)
    assert level(antenna, 0, el) == pytest.approx(10 - upright(np.radians(-el)), abs=0.02)
    assert level(antenna, 180, el) == pytest.approx(10 - upright(np.radians(180 + el)), abs=0.02)
    assert np.ptp(level(antenna, az, 90.0)) < 1e-6  # right above there is one direction


def test_between_cuts_of_planet_a_lobe_is_their_product_and_a_dipole_stays_one(tmp_path):
    def lobe(width):
        return lambda angle: min(12 * (np.degrees(np.arcsin(np.sin(angle / 2))) * 2 / width) ** 2, 40)

    def dipole(angle):
        return min(-20 * np.log10(max(abs(np.cos(angle)), 1e-9)), 40)

    found = level(planet(tmp_path / "a.pln", lobe(40), lobe(25), "GAIN 7.85"), 12.0, 8.0)
    assert found == pytest.approx(10 - lobe(40)(np.radians(12)) - lobe(25)(np.radians(8)), abs=0.05)
    round_ = planet(tmp_path / "b.MSI", lambda _: 0.0, dipole, "gain 2.15dBi", step=5)
    az = np.arange(-180, 180, 15)
    assert level(round_, az, 45.0) == pytest.approx(2.15 - 3.01, abs=0.05)


@pytest.mark.parametrize(
    "damage",
    [("GAIN 10 dBi", "GAIN ten"), ("GAIN 10 dBi", ""), ("GAIN 10 dBi", "GAIN " + "9" * 400),
     ("HORIZONTAL 12", "HORIZONTAL 13"), ("HORIZONTAL 12", "HORIZONTAL 99999999999999999999999"),
     ("VERTICAL 12", "VERTICAL"), ("150.0\t", "nan\t"), ("90.0\t", "90.0\t-"), ("180.0\t", "180.0 0 "),
     ("1.0000", "1e308"), ("90.0\t", "60.0\t")],
)  # fmt: skip
def test_a_broken_file_of_planet_is_refused(tmp_path, damage):
    path = tmp_path / "b.msi"
    planet(path, lambda _: 1.0, lambda _: 1.0, step=30)
    assert level(ul.AntennaSpec(kind="table", file=str(path)), 0, 0) == pytest.approx(9)
    path = path.rename(tmp_path / "c.msi")
    path.write_text(path.read_text().replace(*damage))
    with pytest.raises(ul.InputError, match=r"c\.msi: not an MSI Planet antenna file \(allowed: GAIN in dBd"):
        gain(ul.AntennaSpec(kind="table", file=str(path)), (1, 0, 0))
