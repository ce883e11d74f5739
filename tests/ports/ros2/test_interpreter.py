"""IMC commands over UDP fly a ROS 2 drone of somebody else, and its odometry comes back as EstimatedState."""

from __future__ import annotations

import json
import math
import signal
from pathlib import Path

import pytest

from .network import ROOT, Network, result_of

pytestmark = [pytest.mark.ros2, pytest.mark.slow]
PILOT = ROOT / "tests/ports/imc/imc_pilot.py"


@pytest.mark.parametrize("takes", ["velocity", "pose"])
@pytest.mark.usefixtures("heeded_signals")
def test_a_controller_on_the_bus_flies_a_ros_drone_which_hovers_when_it_falls_silent(
    network: Network, tmp_path: Path, takes: str
) -> None:
    drone = network.ready("drone.py", "/drone1")
    pilot = network.start(PILOT)
    assert pilot.stdout is not None
    port = pilot.stdout.readline().strip()
    words = f"imc:udp://127.0.0.1:{port}?fly=ros2:/drone1&takes={takes}"
    interpreter = network.start("-m", "ullage", "run", words, "--do", "", "--out", tmp_path)
    seen = result_of(pilot, timeout=200)
    interpreter.send_signal(signal.SIGINT)
    out, err = interpreter.communicate(timeout=60)
    assert interpreter.returncode == 0, out + err
    assert "the controller has said nothing for 2.5 s: hovering" in err
    flown = result_of(drone, stop=True)

    assert [seen[step] for step in ("met", "risen", "arrived")] == [True] * 3, json.dumps(seen)
    assert seen["answer"] == 1  # success
    assert seen["speed"] == pytest.approx(0.4, abs=0.1)
    assert seen["silent_speed"] < 0.05
    assert seen["drift"] < 0.05
    assert seen["states"] > 100
    assert math.dist(seen["place"], flown["place"]) < 0.2  # what the controller hears is where the drone is
    kind = "twist" if takes == "velocity" else "pose"
    assert flown["counts"][kind] > 50
    assert flown["counts"]["pose" if takes == "velocity" else "twist"] == 0
    if takes == "velocity":
        assert flown["last"] == pytest.approx([0, 0, 0, 0], abs=0.02)  # left hovering
