"""The driver of the A121 against a simulated exploration server, by Acconeer's own library, and that server alone."""

from __future__ import annotations

import importlib.util
import json
import socket

import numpy as np
import pytest

import ullage as ul
from ullage.errors import InputError, MissingExtra
from ullage.geometry import C0
from ullage.ports.instruments.simulated import PEAK, SWING_M, SWINGS, SimulatedA121, faults_of

pytestmark = pytest.mark.filterwarnings("ignore::ullage.UllageWarning")
installed = importlib.util.find_spec("acconeer") is not None
needs_library = pytest.mark.skipif(not installed, reason="acconeer-exptool is not installed")
SPHERE_M = 2.7
"""Front of the simulated sphere."""


@pytest.fixture
def made(monkeypatch):
    """Make servers, and close them; a busy machine answers late."""
    place = ("127.0.0.1", 0)
    if installed:
        from acconeer.exptool import a121

        if not hasattr(a121.Client, "open"):  # such a version knows one port only
            place = ("127.61.10.1", 6110)
            monkeypatch.setattr("acconeer.exptool.a111._clients.links.BaseLink.DEFAULT_TIMEOUT", 60.0, raising=False)
        else:
            monkeypatch.setattr("acconeer.exptool._core.communication.BufferedLink.DEFAULT_TIMEOUT", 60.0)
    servers = []

    def make(faults="", *, at=place) -> SimulatedA121:
        servers.append(SimulatedA121(at[1], faults_of(faults), host=at[0]))
        return servers[-1]

    yield make
    for server in servers:
        server.close()


def at(server: SimulatedA121) -> str:
    return f"acconeer:{server.address.removesuffix(':6110')}"


@needs_library
def test_an_a121_gives_frames_with_the_phase_of_a_swing(made):
    server = made()
    with ul.open(f"{at(server)}?fps=40&bins=120&range_start_m=0.5&step_length=12&profile=1&duration_s=1.5") as source:
        frames = source.frames()
        lines = source._lines()
    assert len(frames) >= 40
    assert (frames.spec.name, frames.spec.bins, frames.spec.pulses_per_step) == ("a121", 120, 32)
    np.testing.assert_allclose(frames.range_m, 0.5 + 0.03 * np.arange(120), atol=1e-6)
    assert frames.spec.bandwidth_hz == pytest.approx(0.569 * C0 / 0.04)
    column = np.abs(frames.samples).mean(0).argmax()
    assert abs(frames.range_m[column] - SPHERE_M) < 0.05
    assert np.abs(frames.samples).max() <= PEAK + 1
    assert abs(np.median(np.diff(frames.t_ns)) - 25e6) < 2e6
    x_m = SWING_M * np.sin(2 * np.pi * np.arange(len(frames) + 1) / SWINGS)
    want = np.exp(4j * np.pi * np.diff(x_m) / frames.spec.wavelength_m)[: len(frames) - 1]  # it comes nearer by x
    got = frames.samples[1:, column] * frames.samples[:-1, column].conj()
    assert np.abs(np.angle(got * want.conj())).max() < 0.3
    assert any("24 deg C" in line for line in lines)


@needs_library
def test_faults_on_the_line_are_counted_and_cost_their_frames_only(made):
    with ul.open(f"{at(made('loss,duplicate,late'))}?fps=50&duration_s=3") as source:
        frames = source.frames()
        lost = source.counters.dropped("lost")
    assert 1 <= lost <= 6  # 150 frames: one of ten has a fault, one of three of these is a loss
    assert len(frames) + lost >= 140
    assert np.diff(frames.t_ns).min() > 10e6  # none comes twice


@needs_library
@pytest.mark.parametrize("why", ["garbage", "calibration"])
def test_a_line_that_breaks_and_a_sensor_that_calibrates_anew_are_opened_again(made, why):
    server = made("garbage" if why == "garbage" else "")
    said: list[str] = []
    source = ul.open(f"{at(server)}?fps=50&lag=0")
    source._log = said.append
    with source:
        for count, piece in enumerate(source.stream()):
            if count == 1 and why == "calibration":
                server.info["calibration_needed"] = True
            if any("measures again" in line for line in said):
                assert len(piece["a121"])
                break
    assert any("waiting for it" in line for line in said)
    assert why == "garbage" or any("calibrates anew" in line for line in said)


@needs_library
def test_flags_of_the_frames_are_said_at_the_end(made):
    server = made()
    server.info |= {"data_saturated": True, "frame_delayed": True}
    with ul.open(f"{at(server)}?fps=40&duration_s=0.5") as source:
        count = len(source.frames())
        lines = source._lines()
    assert count >= 10
    assert any("frames are saturated" in line for line in lines)
    assert any("frames came late: lower fps" in line for line in lines)


@needs_library
def test_what_the_sensor_cannot_do_is_said_in_one_line(made):
    place = at(made())
    socket.create_server(("127.61.10.2", 6110)).close()  # nobody listens there
    for target, words in {
        f"{place}?fps=1000&pulses_per_step=256": "the frame rate is too high for this sweep",
        f"{place}?bins=1000": r"ranges to 60.2 m.*to 1\d.\d m|ranges to 60.2 m.*to 2\d.\d m",
        f"{place}?profile=9": r"profile is '9'.*5",
        f"{place}?bandwidth_hz=1e9": r"bandwidth_hz cannot be set.*profile= and step_length=",
        "acconeer:radar:x": "'radar:x' is no address",
        "acconeer:127.61.10.2": r"acconeer:127.61.10.2: .*failed to connect.*exploration server",
    }.items():
        with pytest.raises(InputError, match=words):
            ul.open(target)


@pytest.mark.skipif(installed, reason="acconeer-exptool is installed")
def test_a_missing_library_is_named_with_its_extra():
    with pytest.raises(MissingExtra, match=r"acconeer.* is not installed.*ullage\[acconeer\]"):
        ul.open("acconeer:127.0.0.1")


def test_the_simulated_server_answers_by_lines_and_frames(made):
    server = made(at=("127.0.0.1", 0))
    host, port = server.address.split(":")
    with socket.create_connection((host, int(port))) as line, line.makefile("rwb", buffering=0) as file:

        def ask(**command):
            file.write(json.dumps(command).encode() + b"\n")
            return json.loads(file.readline())

        assert ask(cmd="get_system_info")["system_info"]["sensor"] == "a121"
        assert ask(cmd="get_sensor_info")["sensor_info"][0]["connected"]
        assert ask(cmd="fly")["status"] == "error"
        subsweep = {"start_point": 400, "step_length": 24, "num_points": 60, "hwaas": 8, "profile": 3}
        setup = ask(cmd="setup", groups=[[{"sensor_id": 1, "config": {"frame_rate": 50.0, "subsweeps": [subsweep]}}]])
        assert setup["metadata"][0][0]["frame_data_length"] == 60
        assert ask(cmd="start_streaming")["status"] == "start"
        for number in range(3):
            head = json.loads(file.readline())
            assert head["payload_size"] == 240
            assert head["result_info"][0][0]["tick"] == number * 20_000
            payload = b""
            while len(payload) < 240:
                payload += file.read(240 - len(payload))
            pairs = np.frombuffer(payload, "<i2").reshape(60, 2)
            assert abs(1.0 + 0.06 * np.abs(pairs @ [1, 1j]).argmax() - SPHERE_M) < 0.09
