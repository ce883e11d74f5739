"""The explorer flies a foreign drone by its topics."""

from __future__ import annotations

import signal
import time
from pathlib import Path

import numpy as np
import pytest

import ullage as ul

from .network import Network, result_of

pytestmark = [pytest.mark.ros2, pytest.mark.slow]


@pytest.mark.usefixtures("heeded_signals")
@pytest.mark.parametrize("takes", ["velocity", "pose"])
def test_a_drone_explores_by_topics_and_hovers_after_ctrl_c(network: Network, tmp_path: Path, takes: str) -> None:
    drone = network.ready("drone.py", "/drone1")
    words = ("-m", "ullage", "explore", "ntnu-room", "--vehicle", f"ros2:/drone1?takes={takes}")
    flight = network.start(*words, "-o", "sensing.fidelity=thesis", "--out", tmp_path)
    time.sleep(25.0)
    flight.send_signal(signal.SIGINT)
    out, err = flight.communicate(timeout=120)
    assert flight.returncode in (0, 130), out + err
    heard = result_of(drone, stop=True)
    run = next(path for path in tmp_path.iterdir() if path.name.startswith("explore-"))
    frames = ul.open(run / "frames.mcap").frames()["front"]
    assert "The flight ended by hand" in (run / "verdict.txt").read_text()
    assert np.ptp(frames.poses.position[:, :2], axis=0).max() > 0.5
    assert heard["counts"]["twist" if takes == "velocity" else "pose"] > 50
    if takes == "velocity":
        assert heard["last"] == [0.0] * 4
