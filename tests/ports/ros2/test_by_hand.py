"""The simulated multirotor is flown by a foreign ROS 2 node while radars and mapper run."""

from __future__ import annotations

import json
import signal
from pathlib import Path

import numpy as np
import pytest

import ullage as ul

from .network import Network, result_of

pytestmark = [pytest.mark.ros2, pytest.mark.slow]


@pytest.mark.parametrize(
    "words",
    [
        ("run", "ros2:?fly=ntnu-room&fidelity=thesis&node=drone", "-o", "map.method=elfes"),
        (
            *("fly", "ntnu-room", "--by", "ros2:?node=hand"),
            *("-o", "sensing.fidelity=thesis", "-o", "map.method=elfes"),
        ),
    ],
    ids=["run", "fly"],
)
@pytest.mark.usefixtures("heeded_signals")
def test_cmd_vel_moves_it_silence_stops_it_and_a_set_point_places_it(
    network: Network, tmp_path: Path, words: tuple[str, ...]
) -> None:
    pilot = network.start("pilot.py")
    drone = network.start("-m", "ullage", *words, "--to", "ros2:?node=out", "--out", tmp_path)
    heard = result_of(pilot)
    drone.send_signal(signal.SIGINT)
    out, err = drone.communicate(timeout=120)
    assert drone.returncode == 0, out + err
    seen = {name: np.array(value) for name, value in heard["seen"].items()}
    assert seen["moved"][0] - seen["start"][0] > 0.8
    assert seen["stopped"][0] > seen["moved"][0]  # half a second more, and the braking
    assert np.linalg.norm(seen["still"] - seen["stopped"]) < 0.1  # at 0.4 m/s it would be 0.4 m
    assert seen["arrived"] == pytest.approx([-2.0, -1.2, 1.5], abs=0.05)
    assert seen["imu"][0] == pytest.approx(9.81, abs=0.2)
    assert seen["sonar"][0] == pytest.approx(1.5, abs=0.05)
    assert heard["counts"]["raw_imu"] > 100
    run = next(path for path in tmp_path.iterdir() if path.name.startswith(("ros2-", "fly-")))
    assert set(ul.open(run / "frames.mcap").frames()) == {"front", "left", "back", "right"}
    assert json.loads((run / "metrics.json").read_text())["frames"]["value"] > 300
    assert (run / "map.yaml").exists()


@pytest.mark.usefixtures("heeded_signals")
def test_a_joystick_and_stamped_velocities_fly_it(network: Network, tmp_path: Path) -> None:
    stick = network.start("stick.py")
    words = ["-m", "ullage", "run", "ros2:?fly=ntnu-room&fidelity=thesis&node=drone&rate_hz=20"]
    drone = network.start(*words, "--do", "detect", "--to", "ros2:?node=out", "--out", tmp_path)
    seen = result_of(stick)
    drone.send_signal(signal.SIGINT)
    out, err = drone.communicate(timeout=60)
    assert drone.returncode == 0, out + err
    assert seen == {"rests while no button is held": True, "held": True, "let go": True, "stamped": True}
