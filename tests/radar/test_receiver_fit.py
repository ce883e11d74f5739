"""The receiver model fitted to recordings: settings come out as they went in, also on real devices."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import ullage as ul
from ullage.errors import InputError
from ullage.radar.receiver_fit import lattice_counts

DATA = Path(__file__).parents[3] / "shared" / "data"
needs_data = pytest.mark.skipif(not (DATA / "x4").exists(), reason="the recordings are not in ../shared/data")


def at_rest(n: int) -> ul.Trajectory:
    """A track that stands still for n frames."""
    return ul.Trajectory.stationary((0.3, 0.2, 0.0), n=n)


def recorded(spec: ul.RadarSpec, path: ul.Trajectory, seed: int = 1) -> ul.Frames:
    """What a radar receives in a concrete room along a track."""
    return ul.simulate(ul.scenes.room(material="concrete"), path, spec, seed=seed)


@pytest.fixture(scope="module")
def known() -> ul.RadarSpec:
    """A receiver unlike any preset."""
    noise = ul.NoiseSpec(thermal=2e-3, phase_rad=0.006, phase_thermal_rad=0.0, amplitude=0.003)
    return ul.RadarSpec.preset("x4m05", noise=noise, iterations=16, pulses_per_step=8)


@pytest.fixture(scope="module")
def still(known: ul.RadarSpec) -> ul.Frames:
    """800 frames of it at rest."""
    return recorded(known, at_rest(800))


@pytest.fixture(scope="module")
def found(still: ul.Frames) -> ul.Receiver:
    """What is fitted to them."""
    return ul.Receiver.fit(still, counts=(16, 8))


@pytest.mark.parametrize("output", ["baseband", "rf"])
def test_what_a_receiver_adds_is_found_again(known: ul.RadarSpec, found: ul.Receiver, output: str) -> None:
    if output == "rf":
        spec = known.but(output="rf", bins=1504, dac_min=0, dac_max=2047)  # none of it is clipped
        found = ul.Receiver.fit(recorded(spec, at_rest(800)), counts=(16, 8))
    noise = found.radar.noise
    assert noise.thermal == pytest.approx(2e-3, rel=0.03)
    assert noise.phase_rad == pytest.approx(0.006, rel=0.08)  # 800 frames give a sigma of 4 %
    assert noise.amplitude == pytest.approx(0.003, rel=0.12)
    assert found.still.all()
    assert abs(found.misfit["noise"].value) < 0.15
    assert found.misfit["direct_path"].value < -25
    assert abs(found.misfit["phase_jitter"].value) < 0.7
    assert abs(found.misfit["phase_drift"].value) < 3


def test_moving_the_radar_parts_its_own_response_from_the_echoes_of_the_room(known: ul.RadarSpec) -> None:
    rest = at_rest(200)
    away = ul.Trajectory.line((0.3, 0.2, 0), (1.3, 1.0, 0.4), speed_m_s=0.1, rate_hz=25)
    t_ns = np.arange(len(rest) + len(away), dtype=np.int64) * 40_000_000
    path = ul.Trajectory(t_ns, *(np.concatenate([getattr(rest, name), getattr(away, name)])
                                 for name in ("position", "quat_xyzw", "velocity", "angular_velocity")))  # fmt: skip
    quiet = known.but(iterations=64, pulses_per_step=87)
    found = ul.Receiver.fit(recorded(quiet, path))
    assert 150 < found.still.sum() < 240
    assert found.moving.sum() > 200
    own = found.radar.noise.direct_path
    assert own.range_start_m + own.step_m * len(own.in_phase) == pytest.approx(0.5, abs=0.15)  # 8 bins, then a null
    alone = ul.simulate(
        ul.Scene.union([]), at_rest(1), known.but(noise=known.noise.but(thermal=0, amplitude=0, phase_rad=0))
    )
    again = ul.simulate(ul.Scene.union([]), at_rest(1), found.radar.but(
        noise=found.radar.noise.but(thermal=0, amplitude=0, phase_rad=0)))  # fmt: skip
    error = np.linalg.norm(again.samples - alone.samples) / np.linalg.norm(alone.samples)
    assert error < 0.02


@pytest.mark.parametrize("counts", [3, 4, 16])
def test_the_counts_are_read_from_the_lattice(counts: int) -> None:
    spec = ul.RadarSpec.preset("x4m05", iterations=counts, pulses_per_step=1)
    frames = recorded(spec, at_rest(200))
    from ullage.radar.receiver import unit

    values = replace(frames, samples=frames.samples.astype(complex) * unit(spec), unit="normalised")
    assert lattice_counts(values) == counts


@needs_data
def test_three_devices_give_what_was_measured_by_hand() -> None:
    first = ul.Receiver.fit(ul.open(DATA / "x4/xethru_datafloat_20190614_141837.dat", fps=17, range_start_m=0).frames())
    other = ul.Receiver.fit(ul.open(DATA / "x4/xethru_baseband_iq_20170913_150437.dat", fps=17).frames())
    pulson = ul.Receiver.fit(ul.open(DATA / "pulson440/rail_a").frames())
    assert first.radar.counts == 4
    assert first.radar.noise.thermal == pytest.approx(1.16e-3, rel=0.03)
    assert first.radar.noise.phase_rad == pytest.approx(0.0178, rel=0.05)
    assert other.radar.noise.phase_rad == pytest.approx(1.2e-3, rel=0.1)
    for found in (first, other, pulson):
        assert abs(found.misfit["noise"].value) < 0.2
        assert abs(found.misfit["phase_jitter"].value) < 0.6
        assert max(abs(found.misfit[f"correlation_lag_{k}"].value) for k in (1, 2, 3)) < 0.06
    assert 0.8 < first.radar.noise.direct_path.step_m * len(first.radar.noise.direct_path.in_phase) < 1.3
    assert "does not move" in other.notes[0]
    assert -7 < pulson.misfit["phase_drift"].value < -4.5  # its clock wanders by 5.8 mrad a frame; not simulated


PARTS = {
    "x4/xethru_datafloat_20190614_141837.dat": [(0, 500), (2000, 2200), (5000, 5400), (6200, 6600), (7500, 9128)],
    "x4/xethru_baseband_iq_20170913_150437.dat": [(0, 514), (0, 150), (150, 514), (200, 400), (300, 500)],
    "pulson440/rail_a": [(0, 100), (0, 200), (100, 500), (300, 600)],
    "pulson440/flight_a": [(0, 800), (0, 200), (200, 500), (500, 800)],
}
THERMAL = dict(zip(PARTS, (1.19e-3, 1.95e-3, 7.9e3, 9.65e3), strict=True))
"""Noise of each device, measured on the whole of its recording."""


MOVES = {(150, 514), (200, 400), (300, 500), (100, 500), (300, 600), (200, 500), (500, 800)}


@needs_data
@pytest.mark.filterwarnings("ignore::ullage.errors.UllageWarning")
@pytest.mark.parametrize("name", PARTS)
def test_parts_of_a_recording_give_its_noise_within_half_a_db_or_are_refused(name: str) -> None:
    whole = ul.open(DATA / name).frames()
    assert isinstance(whole, ul.Frames)
    for part in PARTS[name]:
        if part in MOVES:
            with pytest.raises(InputError, match="at rest"):
                ul.Receiver.fit(whole[slice(*part)])
            continue
        thermal = ul.Receiver.fit(whole[slice(*part)]).radar.noise.thermal
        assert abs(20 * np.log10(thermal / THERMAL[name])) < 0.5, part


@pytest.mark.parametrize("speed_m_s", [0.02, 0.1, 0.5])
def test_a_radar_that_never_stands_is_refused_and_not_fitted(known: ul.RadarSpec, speed_m_s: float) -> None:
    quiet = known.but(iterations=64, pulses_per_step=87)
    away = ul.Trajectory.line((-2, 0.2, 0), (2, 0.2, 0), speed_m_s=speed_m_s, rate_hz=25)
    with pytest.raises(InputError, match="at rest"):
        ul.Receiver.fit(recorded(quiet, away[: min(len(away), 160)]))


def test_noise_that_the_lattice_contradicts_is_refused(known: ul.RadarSpec) -> None:
    from ullage.radar.receiver import unit

    spec = ul.RadarSpec.preset("x4m05", iterations=4, pulses_per_step=1)
    loud = spec.but(noise=spec.noise.but(thermal=1.16e-2))
    frames = recorded(loud, at_rest(100))
    values = replace(frames, samples=frames.samples.astype(complex) * unit(spec), unit="normalised",
                     spec=ul.RadarSpec.preset("x4m05"))  # fmt: skip
    with pytest.raises(InputError, match="the noise by 20 dB from the 4 counts that the lattice shows"):
        ul.Receiver.fit(values)


def test_what_cannot_be_fitted_is_refused_in_one_line(still: ul.Frames) -> None:
    spec = still.spec
    away = ul.Trajectory.line((-2, 0.2, 0), (2, 0.2, 0), speed_m_s=2.0, rate_hz=25)
    real = recorded(spec.but(output="rf", bins=1504), at_rest(64))
    for frames, words in (
        (still[:20], "20 frames"),
        ({"a": still, "b": still}, "2 radars"),
        (ul.simulate(ul.scenes.room(), at_rest(64), spec, fidelity="thesis"), "without phase"),
        (recorded(spec.but(noise=spec.noise.but(thermal=1e-7)), away), "move|at rest|drift"),
        (replace(real, samples=np.clip(real.samples, -1e-4, 1e-4)), "saturated"),
    ):
        with pytest.raises(InputError, match=words) as refused:
            ul.Receiver.fit(frames)
        assert "\n" not in str(refused.value)


def test_a_fitted_radar_is_written_and_read_as_a_preset(found: ul.Receiver, tmp_path: Path) -> None:
    found.write(tmp_path / "mine.yaml")
    again = ul.RadarSpec.preset(str(tmp_path / "mine.yaml"))
    assert again == found.radar
    assert ul.RadarSpec.preset(str(tmp_path / "mine.yaml"), bins=50).bins == 50
    text = (tmp_path / "mine.yaml").read_text()
    assert text.startswith("# Measured on 800 frames at rest.")


@pytest.mark.parametrize(("text", "words"), [
    ("- 1\n- 2\n", "not the settings of a radar"), ("thermal: 3\n", "no such setting"), ("bins: 3\n", "bins"),
])  # fmt: skip
def test_a_file_that_is_no_radar_is_refused(tmp_path: Path, text: str, words: str) -> None:
    (tmp_path / "mine.yaml").write_text(text)
    with pytest.raises(InputError, match=words):
        ul.RadarSpec.preset(str(tmp_path / "mine.yaml"))


def test_every_measured_device_says_what_it_was_measured_on() -> None:
    devices = set(ul.RadarSpec.names()) - set(ul.RadarSpec.presets)
    assert {"x4-2019", "x4m300-2017", "pulson440"} <= devices
    for name in devices:
        assert ul.RadarSpec.preset(name).name == name
        assert "at rest" in (Path(ul.__file__).parent / "devices" / f"{name}.yaml").read_text()
