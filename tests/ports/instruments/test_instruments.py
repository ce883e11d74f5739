"""Drivers against simulated instruments that answer byte by byte, with faults: pseudo terminal and loopback."""

from __future__ import annotations

import socket
import warnings

import numpy as np
import pytest

import ullage as ul
from ullage.errors import InputError
from ullage.ports.instruments.simulated import SimulatedMrm, SimulatedX4, faults_of
from ullage.ports.instruments.source import InstrumentClock

pytest.importorskip("serial")
pytestmark = pytest.mark.filterwarnings("ignore::ullage.UllageWarning")
SPHERE_M = 2.7
"""Front of the simulated sphere."""


@pytest.fixture(autouse=True)
def patient(monkeypatch):
    """A busy machine answers late: only what a test keeps silent gives no answer."""
    for driver in ("x4", "mrm"):
        monkeypatch.setattr(f"ullage.ports.instruments.{driver}.ANSWER_S", 120.0)
        monkeypatch.setattr(f"ullage.ports.instruments.{driver}.SILENCE_S", 120.0)


@pytest.fixture
def x4():
    module = SimulatedX4()
    yield module
    module.close()


@pytest.fixture
def mrm():
    radar = SimulatedMrm()
    yield radar
    radar.close()


def swing_m(frames: ul.Frames) -> float:
    """The motion of the strongest echo near the sphere by its phase, from end to end [m]."""
    near = abs(frames.range_m - SPHERE_M) < 0.2
    column = np.flatnonzero(near)[np.argmax(np.abs(frames.samples[:, near]).mean(0))]
    phase = np.unwrap(np.angle(frames.samples[:, column]))
    return float(np.ptp(phase) * frames.spec.wavelength_m / (4 * np.pi))


def test_an_x4_module_gives_frames_with_the_phase_of_a_swing(x4):
    with ul.open(f"x4:{x4.path}?fps=40&iterations=8&bins=100&range_start_m=0.4&duration_s=1.2") as source:
        frames = source.frames()
    assert len(frames) >= 40
    assert frames.spec.bins == 100
    assert abs(frames.range_m[0] - 0.4) < 0.03  # the module rounds to whole bins, and says so
    assert abs(frames.range_m[np.abs(frames.samples[:, 10:]).mean(0).argmax() + 10] - SPHERE_M) < 0.06
    assert abs(swing_m(frames) - 0.04) < 0.002
    assert abs(np.median(np.diff(frames.t_ns)) - 25e6) < 2e6


def test_a_pulson_gives_scans_on_the_ranges_that_it_was_asked_for(mrm):
    with ul.open(f"mrm:{mrm.address}?fps=20&bins=600&range_start_m=0.5&duration_s=1") as source:
        frames = source.frames()
    assert len(frames) >= 16
    assert frames.spec.bins == 672  # whole groups of 96
    assert abs(frames.range_m[0] - 0.5) < 1e-3
    moving = frames.samples.std(0)  # what its own ring-down is not
    assert abs(frames.range_m[moving.argmax()] - SPHERE_M) < 0.1
    assert frames.samples.dtype == np.float32


@pytest.mark.parametrize("kind", ["x4", "mrm"])
def test_faults_on_the_line_are_counted_and_cost_their_frames_only(kind):
    faults, quick = faults_of("loss,duplicate,late,garbage"), "iterations=8&" if kind == "x4" else ""
    device = SimulatedX4(faults) if kind == "x4" else SimulatedMrm(faults=faults)
    try:
        with ul.open(f"{kind}:{device.path if kind == 'x4' else device.address}?fps=50&{quick}duration_s=3") as source:
            frames = source.frames()
            lost = source.counters.dropped("lost")
    finally:
        device.close()
    assert 1 <= lost <= 6  # 150 frames: one of ten has a fault, one of four of these is a loss
    assert len(frames) + lost >= 140
    assert (np.diff(frames.t_ns) > 0).all()
    assert np.isfinite(frames.samples).all()


def test_a_module_that_was_unplugged_is_waited_for(tmp_path):
    place, x4 = tmp_path / "ttyACM0", SimulatedX4()
    place.symlink_to(x4.path)
    told: list[str] = []
    source = ul.open(f"x4:{place}?fps=50&iterations=8&lag=0")
    source._log = told.append
    again = None
    with source:
        for count, piece in enumerate(source.stream()):
            if count == 2:
                x4.close()
                place.unlink()
                again = SimulatedX4()
                place.symlink_to(again.path)
            if any("measures again" in line for line in told):
                assert len(piece["x4"])
                break
    again.close()
    assert any("waiting for it" in line for line in told)


def test_what_is_no_radar_is_said_in_one_line(tmp_path, x4, monkeypatch):
    monkeypatch.setattr("ullage.ports.instruments.mrm.ANSWER_S", 0.05)
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as silent:
        silent.bind(("127.0.0.1", 0))
        for target, words in {
            "x4:/dev/nothing": r"x4:/dev/nothing: no such device .*dev/tty",
            "x4:": "no device is named",
            f"x4:{x4.path}?volume=11": r"no option 'volume'.*fps",
            f"x4:{x4.path}?fps=-3": "fps",
            f"x4:{x4.path}?fps=100&iterations=64&pulses_per_step=87": "refuses fps 100: it cannot do it",
            f"x4:{x4.path}?output=rf": r"rf at 7.29e\+09 Hz.*baseband at",
            f"x4:{x4.path}?stagger_div=17": r"stagger_div is 17.*one pulse interval",
            f"mrm:127.0.0.1:{silent.getsockname()[1]}": "no answer when asked for a pause",
            "mrm:radar:x": "'radar:x' is no address",
            "mrm:127.0.0.1?pulses_per_step=100": r"100 pulses a sample.*64, 128",
        }.items():
            with pytest.raises(InputError, match=words):
                ul.open(target)
    with pytest.raises(InputError, match="not something to write to"):
        ul.sink("x4:/dev/ttyACM0")
    with pytest.raises(InputError, match="no fault 'fire'"):
        faults_of("loss,fire")


def test_a_device_in_use_is_said_so(x4):
    with ul.open(f"x4:{x4.path}?duration_s=1"), pytest.raises(InputError, match="in use: another program has it open"):
        ul.open(f"x4:{x4.path}")


def test_frames_of_an_instrument_go_through_run_into_a_recording(x4, tmp_path):
    with ul.open(f"x4:{x4.path}?fps=50&iterations=8&duration_s=1") as source, warnings.catch_warnings():
        warnings.simplefilter("ignore")
        ul.run(source, sinks=[ul.sink(tmp_path / "bench.mcap")])
    again = ul.open(tmp_path / "bench.mcap").frames()
    assert len(again) >= 40
    assert again.spec.name == "x4m05"


@pytest.mark.parametrize("drift", [0.0, 3e-4])
def test_the_clock_keeps_the_even_steps_of_the_counter(drift):
    rng = np.random.default_rng(3)
    device_s = np.arange(2000) / 17
    true_s = 1000 + device_s * (1 + drift)
    late = rng.exponential(3e-3, 2000) + np.where(rng.random(2000) < 0.02, 0.2, 0.0)
    clock = InstrumentClock()
    got = np.array([clock.at(d, t) for d, t in zip(device_s, true_s + late, strict=True)])
    wrong = got[500:] - true_s[500:]
    assert np.std(wrong) < 0.6e-3  # arrivals scatter by 28 ms
    assert np.ptp(wrong) < 4e-3
    assert abs(clock.drift_ppm * 1e-6 - drift) < 5e-5
    assert 1e-3 < clock.jitter_s < 10e-3


def test_a_clock_that_starts_anew_follows_the_instrument():
    clock = InstrumentClock()
    for k in range(100):
        clock.at(k / 17, 5 + k / 17)
    assert clock.at(0.0, 50.0) == 50.0
