"""`ros2:` as a source: mapping on a robot's topics, radars on a robot that moves, and peers that die and come back."""

from __future__ import annotations

import json
import subprocess
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import ullage as ul
from ullage.ports import read_map
from ullage.ports.instruments.simulated import SimulatedX4

from .network import Network, result_of

pytestmark = pytest.mark.ros2
SPEAK = "ros2:?pace=1&node=speaker&listeners=1"


def lines_until(
    program: subprocess.Popen[str], wanted: Callable[[dict[str, Any]], bool], *, within_s: float = 90.0
) -> list[dict[str, Any]]:
    """What a program says up to the line that is wanted."""
    assert program.stdout is not None
    out, end = [], time.monotonic() + within_s
    while time.monotonic() < end:
        line = program.stdout.readline()
        assert line, program.communicate()[1]
        out.append(json.loads(line))
        if wanted(out[-1]):
            return out
    raise AssertionError(f"never came; heard {out[-5:]}")


@pytest.mark.slow
def test_mapping_on_topics_gives_what_the_flight_gives(network: Network, tmp_path: Path) -> None:
    address = "ros2:?poses=tf&idle_s=8&node=mapper"
    mapper = network.start("-m", "ullage", "run", address, "--out", tmp_path, "--to", "ros2:/mapped")
    listener = network.ready("hear.py", "/mapped/map=nav_msgs/msg/OccupancyGrid:latched")
    time.sleep(3.0)
    speaker = network.start("speak.py", "ros2:?pace=0.25&node=speaker&listeners=1")
    assert speaker.wait(120) == 0
    out, err = mapper.communicate(timeout=120)
    assert mapper.returncode == 0, out + err
    run = next(path for path in tmp_path.iterdir() if path.name.startswith("ros2-"))
    got = ul.open(run / "frames.mcap").frames()
    flown = flight()
    assert set(got) == set(flown)
    for name, frames in got.items():
        rows = np.searchsorted(flown[name].t_ns, frames.t_ns)
        assert rows[-1] >= len(flown[name]) - 3
        assert len(rows) > 15  # what was said before its topic was found is gone
        assert len(rows) >= rows[-1] - rows[0] - 1
        assert np.array_equal(frames.samples, flown[name].samples[rows])
        np.testing.assert_allclose(frames.poses.position, flown[name].poses.position[rows], atol=1e-6)
    omap = read_map(run / "map.yaml")
    assert omap.free.sum() > 100
    told_map = result_of(listener, stop=True)["last"]["/mapped/map"]
    assert told_map["data"]["length"] == omap.percent.size


def flight() -> dict[str, ul.Frames]:
    """What speak.py flies."""
    path = ul.Trajectory.line((-1, 0, 0), (1, 0, 0), 1.0, 17.0)
    frames = ul.simulate(ul.scenes.room(size_m=(6, 4, 3)), path, ul.Rig.preset("thesis-4"), fidelity="thesis", seed=3)
    assert isinstance(frames, dict)
    return frames


@pytest.mark.slow
def test_radars_follow_a_robot_and_each_may_die_and_come_back(network: Network) -> None:
    address = "ros2:/robot?simulate=ntnu-room&fidelity=thesis&node=radars"
    topics = {
        "/robot/radar/front/range": "sensor_msgs/msg/Range:sensor",
        "/robot/radar/left/frame": "ullage_msgs/msg/RadarFrame:sensor",
        "/tf": "tf2_msgs/msg/TFMessage:stream",
        "/tf_static": "tf2_msgs/msg/TFMessage:latched",
        "/robot/world": "visualization_msgs/msg/MarkerArray:latched",
        "/diagnostics": "diagnostic_msgs/msg/DiagnosticArray:stream",
    }
    asked = ["--all", *(f"{topic}={how}" for topic, how in topics.items())]
    early = network.ready("hear.py", *asked)
    robot = network.ready("move.py")
    radars = network.ready("take.py", address)
    lines = lines_until(radars, lambda line: line.get("sensor") == "front" and line["at"][0] > 2.01)
    assert any("poses come on /robot/odom" in line.get("said", "") for line in lines)
    before_ns = lines[-1]["t_ns"]

    robot.kill()  # the robot dies, and comes back where it began
    network.ready("move.py")
    lines = lines_until(radars, lambda line: line.get("t_ns", 0) > before_ns + 2_000_000_000)
    assert lines[-1]["at"][0] < 3.0

    assert set(result_of(early)["count"]) == set(topics)
    radars.kill()  # the radars die, and come back
    again = network.ready("take.py", address)
    lines_until(again, lambda line: line.get("sensor") == "front")
    got = result_of(network.ready("hear.py", *asked))  # who comes late hears of the world too
    assert set(got["count"]) == set(topics)
    out, err = again.communicate(timeout=60)
    assert again.returncode == 0, err
    last = json.loads(out.strip().splitlines()[-1])
    status = got["last"]["/diagnostics"]["status"][0]
    assert int({pair["key"]: pair["value"] for pair in status["values"]}["front: frames simulated"]) > 0
    nearest = got["last"]["/robot/radar/front/range"]["range"]
    far, near = 4.0 - 2.0 - 0.1, 4.0 - last["at"][0] - 0.1  # from where the robot set out, and from the last frame
    assert near - 0.3 < nearest < far + 0.3  # the last range heard may be of any time between: frames are best effort


def test_a_listener_outlives_the_one_it_listens_to(network: Network) -> None:
    listener = network.ready("take.py", "ros2:?node=listener")
    first = network.start("speak.py", f"{SPEAK}&linger_s=60")
    lines = lines_until(listener, lambda line: line.get("sensor") == "front" and line["t_ns"] > 1_200_000_000)
    first.kill()
    network.start("speak.py", SPEAK)
    before = lines[-1]["t_ns"]
    lines = lines_until(listener, lambda line: "a new track begins" in line.get("said", ""))
    lines = lines_until(listener, lambda line: line.get("sensor") == "front")
    assert lines[-1]["t_ns"] > before
    assert lines[-1]["at"] is not None
    listener.communicate(timeout=60)
    assert listener.returncode == 0


def test_a_robots_odometry_places_the_frames_of_an_instrument(network: Network, tmp_path: Path) -> None:
    pytest.importorskip("serial")
    x4 = SimulatedX4()
    network.ready("move.py")
    words = [
        "-m",
        "ullage",
        "run",
        f"x4:{x4.path}?fps=17&iterations=8&bins=96&duration_s=3&lag=0&mount={{yaw_deg: 90}}",
    ]
    to = tmp_path / "all.mcap"
    run = network.start(*words, "--poses", "ros2:robot?pose=odom", "--out", tmp_path / "runs", "--to", to)
    out, err = run.communicate(timeout=120)
    x4.close()
    assert run.returncode == 0, out + err
    parts = [piece["x4"] for piece in ul.open(to).stream()]
    assert sum(map(len, parts)) >= 45
    posed = next(part for part in reversed(parts) if part.poses is not None).believed
    assert 2.0 < posed.position[-1, 0] < 4.0
    assert posed.position[-1, 2] == pytest.approx(1.1)
    np.testing.assert_allclose(posed.world_from_body[-1][:3, 0], [0, 1, 0], atol=1e-9)
