"""Radar settings: the X4's own arithmetic, presets, bad input."""

from __future__ import annotations

import numpy as np
import pytest

import ullage as ul


def test_the_x4_arithmetic_is_the_data_sheets() -> None:
    radar = ul.RadarSpec.preset("x4m05")
    assert radar.prf_hz == pytest.approx(15.1875e6)
    assert radar.bin_m == pytest.approx(0.05144 * 299792458 / 3e8, rel=1e-4)
    assert radar.unambiguous_range_m == pytest.approx(9.87, abs=0.01)
    assert radar.max_fps == pytest.approx(17, abs=0.1)


def test_the_pulse_is_ten_decibels_down_at_the_edge_of_its_band() -> None:
    radar = ul.RadarSpec.preset("x4m05")
    sigma = radar.pulse_sigma_s
    spectrum = np.exp(-2 * (np.pi * sigma * radar.bandwidth_hz / 2) ** 2)
    assert 20 * np.log10(spectrum) == pytest.approx(-10, abs=0.01)


def test_the_thesis_rig_looks_four_ways() -> None:
    rig = ul.Rig.preset("thesis-4")
    ahead = {name: spec.mount.body_from_sensor()[:3, 0].round(9).tolist() for name, spec in rig.sensors.items()}
    assert ahead == {"front": [1, 0, 0], "left": [0, 1, 0], "back": [-1, 0, 0], "right": [0, -1, 0]}


def test_completion_offers_no_name_that_warns_of_its_age(recwarn: pytest.WarningsRecorder) -> None:
    radar = ul.RadarSpec.preset("x4m05")
    assert {"but", "center_hz", "range_m"} <= set(dir(radar))
    assert not {"dict", "json", "copy", "parse_obj", "construct"} & set(dir(radar))
    for name in dir(radar):
        if not name.startswith(("_", "model_")):
            getattr(radar, name)
    assert not recwarn.list


def test_settings_are_taken_by_the_names_of_the_x4_driver() -> None:
    spec = ul.RadarSpec.preset("x4m05", frame_area=(0.4, 5.0), frame_area_offset=0.18)
    assert spec.range_m[0] == 0.4
    assert 5.0 - spec.bin_m < spec.range_m[-1] <= 5.0
    assert spec.frame_area_offset_m == 0.18
    rf = ul.RadarSpec.preset("x4m05", downconversion=0)
    assert (rf.output, rf.bins) == ("rf", 1536)
    assert rf.range_m[-1] == pytest.approx(9.87, abs=0.01)
    assert rf.but(downconversion=1) == ul.RadarSpec.preset("x4m05", downconversion=1) == ul.RadarSpec.preset("x4m05")
    near = rf.but(frame_area=(1.0, 2.0))
    assert near.range_m[0] == 1.0
    assert 2.0 - near.bin_m < near.range_m[-1] <= 2.0
    cut = ul.RadarSpec.preset("pulson440", frame_area=(1.0, 3.0))
    assert cut.bins == 219
    assert cut.range_m[-1] <= 3.0


@pytest.mark.parametrize(
    ("make", "words"),
    [
        (lambda: ul.RadarSpec.preset("x5"), "no radar preset 'x5'.*x4m05"),
        (lambda: ul.RadarSpec.preset("x4m05", fps=-1), r"fps is -1 \(allowed: greater than 0\)"),
        (lambda: ul.RadarSpec.preset("x4m05", dac_min=1200), "dac_max 1100 must be above dac_min 1200"),
        (lambda: ul.RadarSpec.preset("x4m05", colour="red"), "colour: no such setting .*center_hz.*thesis"),
        (
            lambda: ul.RadarSpec.preset("x4m05", antenna={"gain": 3}),
            "antenna.gain: no such setting .allowed: kind, gain_dbi",
        ),
        (lambda: ul.RadarSpec.preset("x4m05", frame_area=5), "frame_area is 5 .allowed: two ranges"),
        (lambda: ul.RadarSpec.preset("x4m05", frame_area=(2, 1)), "bins is -19"),
        (lambda: ul.RadarSpec(frame_area=(0, 1), bins=20), "frame_area and bins set the same thing"),
        (lambda: ul.RadarSpec.preset("x4m05", center_hz=float("nan")), "center_hz"),
        (lambda: ul.RadarSpec.preset("x4m05", antenna={"kind": "horn"}), "antenna.kind"),
        (lambda: ul.Rig.preset("five"), "no rig preset"),
        (lambda: ul.Rig(sensors={}), "sensors"),
    ],
)
def test_bad_settings_are_refused_in_one_line(make, words: str) -> None:
    with pytest.raises(ul.InputError, match=words) as caught:
        make()
    assert "\n" not in str(caught.value)


def test_a_radar_prints_what_differs_from_its_defaults() -> None:
    assert repr(ul.RadarSpec.preset("x4m05")) == "RadarSpec(name='x4m05')"
    assert repr(ul.RadarSpec.preset("x4m300", noise=None, fps=20)) == (
        "RadarSpec(name='x4m300', frame_area_offset_m=0.18, fps=20.0, noise=None)"
    )
    assert len(repr(ul.Rig.preset("thesis-4"))) < 500
