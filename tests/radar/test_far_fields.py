"""Antennas given by their far fields: polarisation, phase over angle, and transfer over frequency."""

from dataclasses import replace

import numpy as np
import pytest
from radar_worlds import at, db

import ullage as ul
from ullage.antenna import gain, pattern_pairs
from ullage.geometry import C0
from ullage.radar.physical import echoes, path_gain_cw
from ullage.world import scenes
from ullage.world.scene import Scene

RADAR = ul.RadarSpec.preset("x4m05", noise=None)
CARRIER = (RADAR.center_hz,)
PLATE = scenes.plate(width_m=0.4, height_m=0.3, distance_m=2.0, material="pec")


def across(axis, unit):
    """Unit vectors along an axis across the directions (n, 3)."""
    field = axis - (unit @ axis)[:, None] * unit
    return field / np.maximum(np.linalg.norm(field, axis=1, keepdims=True), 1e-9)


def with_field(file, field, hz=CARRIER, *, spec=RADAR, **antenna):
    """A radar with the far field (n, 3) that `field` gives in the sensor's frame by directions (n, 3) and frequency."""
    phi, theta = (a.ravel() for a in np.meshgrid(np.arange(0, 360, 5.0), np.arange(0, 181, 5.0), indexing="ij"))
    a, b = np.radians(phi), np.radians(theta)
    # forward, left and up are z, x and y of the file
    unit = np.stack([np.cos(b), np.sin(b) * np.cos(a), np.sin(b) * np.sin(a)], 1)
    polar = np.stack([-np.sin(b), np.cos(b) * np.cos(a), np.cos(b) * np.sin(a)], 1)
    level = np.stack([0 * a, -np.sin(a), np.cos(a)], 1)
    lines = ["3.0", "Farfield", len(hz), "0 0 0", "0 0 1", "1 0 0"]
    fields = [field(unit, one) for one in hz]
    sine = np.sin(b)[:, None]  # radiated power of the stimulated one, so that the gain is the square of the field
    lines += [f"{(abs(e) ** 2 * sine).sum() / (sine.sum())} 1 1 {one}" for e, one in zip(fields, hz, strict=True)]
    for e in fields:
        parts = [(e * basis).sum(1) for basis in (polar, level)]
        lines += ["72 37", *(" ".join(map(str, row)) for row in zip(
            phi, theta, parts[0].real, parts[0].imag, parts[1].real, parts[1].imag, strict=True))]  # fmt: skip
    file.write_text("\n".join(map(str, lines)) + "\n")
    return spec.but(antenna={"kind": "table", "file": str(file), **antenna})


def lobe(axis, kind="x4a02"):
    """Fields along an axis with the gains of a dome."""
    return lambda unit, _: gain(ul.AntennaSpec(kind=kind), unit)[:, None] * across(np.array(axis, complex), unit)


def worst(ours, wanted):
    return abs(ours - wanted).max() / abs(wanted).max()


@pytest.mark.parametrize(("axis", "known"), [
    ((0, 0, 1), {}), ((0, 1, 0), {"polarization": "horizontal"}), ((0, 0, 1), {"receive_polarization": "horizontal"}),
])  # fmt: skip
def test_a_far_field_of_a_dome_is_the_dome(tmp_path, axis, known):
    """Antennas apart, over a bounce: also where transmitter and receiver have patterns of their own."""
    spec = RADAR.but(antenna_offset_m=0.2)
    scene = Scene.union(
        [scenes.dihedral(0.8, 2.0, yaw_deg=20), scenes.wire(radius_m=0.001, length_m=0.5, distance_m=1.0)]
    )
    rest = {} if "polarization" in known else known
    path = ul.Trajectory.line((0.1, 0.2, 0.1), (0.3, 0.4, 0.2), 0.5, 4)
    ours = echoes(scene, path, with_field(tmp_path / "a.ffs", lobe(axis), spec=spec, **rest), max_bounces=2)
    assert worst(ours, echoes(scene, path, spec.but(antenna=known), max_bounces=2)) < 0.02


@pytest.mark.parametrize("tilt_deg", [0, 30, 60, 90])
def test_a_wire_returns_the_square_of_a_dipoles_cosine(tmp_path, tilt_deg):
    """A thin upright wire scatters the field along it: cos^2 of the tilt, and sin cos in a crossed receiver."""
    tilt = np.radians(tilt_deg)
    dipole = lobe((0, np.sin(tilt), np.cos(tilt)), "isotropic")
    wire = scenes.wire(radius_m=1e-4, length_m=0.3, distance_m=2.0)
    whole = path_gain_cw(wire, at(0, 0, 0), RADAR.but(antenna={"kind": "isotropic"}))[0]
    alike = path_gain_cw(wire, at(0, 0, 0), with_field(tmp_path / "a.ffs", dipole))[0]
    crossed = with_field(tmp_path / "a.ffs", dipole, receive_polarization="horizontal")
    assert alike / whole == pytest.approx(np.cos(tilt) ** 2, abs=0.01)
    assert abs(path_gain_cw(wire, at(0, 0, 0), crossed)[0] / whole) == pytest.approx(
        np.sin(tilt) * np.cos(tilt), abs=0.01
    )


def test_crossed_dipoles_do_not_see_a_facing_plate(tmp_path):
    """But for its edges, which return the two polarisations unlike."""
    crossed = with_field(tmp_path / "a.ffs", lobe((0, 0.6, 0.8)), receive_polarization="horizontal")
    ours, plain = (path_gain_cw(PLATE, at(0, 0, 0), spec, edges=False)[0] for spec in (crossed, RADAR))
    assert db(ours / plain) < -50


def test_a_circular_antenna_sees_two_bounces_and_not_one(tmp_path):
    """A mirror turns the sense of rotation, which the antenna does not receive; a dihedral turns it back.

    In circular waves the echo is half the difference of those in upright and level ones.
    """
    circular = with_field(tmp_path / "a.ffs", lobe((0, 1j * np.sqrt(0.5), np.sqrt(0.5))))
    for scene, bounces, low, high in ((PLATE, 1, -200, -50), (scenes.dihedral(0.3, 2.0), 2, -1, 1)):
        upright, level, ours = (
            path_gain_cw(scene, at(0, 0, 0), spec, max_bounces=bounces, edges=False)[0]
            for spec in (RADAR, RADAR.but(antenna={"polarization": "horizontal"}), circular)
        )
        assert abs(ours - (upright - level) / 2) < 2e-3 * abs(upright)
        assert low < db(ours / upright) < high


def displaced(moved):
    """Field of a dome at another place, seen from here."""
    return lambda unit, hz: np.exp(2j * np.pi * hz / C0 * (unit @ moved))[:, None] * lobe((0, 0, 1))(unit, hz)


def test_a_linear_phase_over_angle_is_a_displaced_antenna(tmp_path):
    """Of the carrier and of the pulse, over all frequencies; what differs is that it is 1 % nearer."""
    moved, path = np.array([0.04, 0.02, -0.01]), ul.Trajectory.stationary((0, 0.2, 0.1), n=1)
    spec = with_field(tmp_path / "a.ffs", displaced(moved), np.arange(4.5e9, 10.2e9, 0.7e9))
    scene = Scene.union(
        [scenes.dihedral(0.8, 5.0, yaw_deg=20), scenes.wire(radius_m=0.001, length_m=0.5, distance_m=4.0)]
    )
    wanted = echoes(scene, replace(path, position=path.position + moved), RADAR, max_bounces=2)
    assert worst(echoes(scene, path, spec, max_bounces=2), wanted) < 0.03
    assert worst(echoes(scene, path, RADAR, max_bounces=2), wanted) > 0.5


def test_gains_at_two_frequencies_filter_the_pulse(tmp_path):
    """The amplitude runs evenly from .9 to .3 over 5 GHz, and counts there and back."""
    hz = RADAR.center_hz - 2.5e9, RADAR.center_hz + 2.5e9
    spec = with_field(
        tmp_path / "a.ffs", lambda unit, one: (0.9 if one == hz[0] else 0.3) * lobe((0, 0, 1))(unit, one), hz
    )
    flat = with_field(tmp_path / "b.ffs", lobe((0, 0, 1)))
    ours, plain = (np.fft.fft(echoes(PLATE, at(0, 0, 0), one)[0], 4096) for one in (spec, flat))
    offset = np.fft.fftfreq(4096, RADAR.step_s)
    band = abs(plain) > 0.1 * abs(plain).max()
    assert np.ptp(offset[band]) > 1e9
    assert ours[band] / plain[band] == pytest.approx((0.6 - 0.6 * offset[band] / 5e9) ** 2, abs=0.01)
    ours, plain = (path_gain_cw(PLATE, at(0, 0, 0), one, RADAR.center_hz + 1e9)[0] for one in (spec, flat))
    assert ours / plain == pytest.approx(0.48**2, abs=0.01)
    ours, plain = (ul.explain(PLATE, at(0, 0, 0), one, 0)[0].path_gain_db for one in (spec, flat))
    assert ours - plain == pytest.approx(db(0.6**2), abs=0.01)


def test_contributions_of_a_far_field_add_up_to_its_frame(tmp_path):
    spec = with_field(tmp_path / "a.ffs", displaced(np.array([0.02, 0.01, 0])), (6.5e9, 7.3e9, 8.1e9),
                      spec=RADAR.but(antenna_offset_m=0.1))  # fmt: skip
    assert len(pattern_pairs(spec)) > 4
    scene = Scene.union([PLATE, scenes.wire(radius_m=0.001, length_m=0.5, distance_m=1.0)])
    parts = ul.explain(scene, at(0, 0, 0), spec, 0, max_bounces=2, count=None)
    total = np.sum([part.samples for part in parts], axis=0)
    frame = echoes(scene, at(0, 0, 0), spec, max_bounces=2)[0]
    assert worst(total, frame) < 1e-4


def test_a_chosen_peak_gain_scales_a_far_field(tmp_path):
    louder = with_field(tmp_path / "a.ffs", lobe((0, 0, 1)), CARRIER * 2, gain_dbi=11.97)  # one frequency twice
    ratio = path_gain_cw(PLATE, at(0, 0, 0), louder)[0] / path_gain_cw(PLATE, at(0, 0, 0), RADAR)[0]
    assert db(ratio) == pytest.approx(12, abs=0.1)
