"""The launch files, started by the real `launch` where it is installed: what each promises is heard.

`integrations/ros2/README.md` tells how to get `launch` without a ROS 2 of its own; no wheel holds it.
"""

from __future__ import annotations

import os
import shutil
import signal
import subprocess
from pathlib import Path
from typing import Any

import pytest

from ullage.ports.live import Address
from ullage.ports.ros2.options import SinkOptions

from .network import ROOT, Network, interpreter, result_of

pytestmark = pytest.mark.ros2
PACKAGE = ROOT / "integrations/ros2/ullage_ros"
FILES = sorted(file.name for file in (PACKAGE / "launch").glob("*.launch.py"))
RADARS = (
    *(
        topic
        for name in ("front", "left", "back", "right")
        for topic in (
            f"/radar/{name}/frame=ullage_msgs/msg/RadarFrame:sensor",
            f"/radar/{name}/profile=sensor_msgs/msg/PointCloud2:sensor",
            f"/radar/{name}/range=sensor_msgs/msg/Range:sensor",
            f"/radar/{name}/settings=ullage_msgs/msg/RadarSettings:latched",
        )
    ),
    "/tf=tf2_msgs/msg/TFMessage:stream",
    "/tf_static=tf2_msgs/msg/TFMessage:latched",
    "/path=nav_msgs/msg/Path:latched",
    "/world=visualization_msgs/msg/MarkerArray:latched",
    "/diagnostics=diagnostic_msgs/msg/DiagnosticArray:stream",
    "/map=nav_msgs/msg/OccupancyGrid:latched",
)
FLOWN = (
    "/radar/front/frame=ullage_msgs/msg/RadarFrame:sensor",
    "/radar/front/profile=sensor_msgs/msg/PointCloud2:sensor",
    "/radar/front/range=sensor_msgs/msg/Range:sensor",
    "/radar/front/settings=ullage_msgs/msg/RadarSettings:latched",
    "/tf=tf2_msgs/msg/TFMessage:stream",
    "/tf_static=tf2_msgs/msg/TFMessage:latched",
    "/odom=nav_msgs/msg/Odometry:stream",
    "/truth/odom=nav_msgs/msg/Odometry:stream",
    "/path=nav_msgs/msg/Path:latched",
    "/world=visualization_msgs/msg/MarkerArray:latched",
    "/clock=rosgraph_msgs/msg/Clock:stream",
    "/diagnostics=diagnostic_msgs/msg/DiagnosticArray:stream",
    "/map=nav_msgs/msg/OccupancyGrid:latched",
    "/image=sensor_msgs/msg/Image:latched",
    "/image/amplitude=sensor_msgs/msg/Image:latched",
)
LONG = ("cargo_hold", "cluttered_room", "ntnu_mapping")
"""These are flown at ten times real time; of the others, diagnostics would then be over before they began."""
DESCRIBE = """
import json, sys
from launch import LaunchContext
from launch.actions import DeclareLaunchArgument, ExecuteProcess
from launch.launch_description_sources import get_launch_description_from_python_launch_file
from launch.utilities import perform_substitutions
out = {}
for file in sys.argv[1:]:
    context, started = LaunchContext(), []
    for entity in get_launch_description_from_python_launch_file(file).entities:
        if isinstance(entity, DeclareLaunchArgument):
            entity.execute(context)
        elif entity.condition is None or entity.condition.evaluate(context):
            if not hasattr(entity, "node_executable") and isinstance(entity, ExecuteProcess):
                started.append([perform_substitutions(context, word) for word in entity.cmd])
            else:
                started.append([entity.node_package, entity.node_executable])
    out[file.rpartition("/")[2]] = started
print(json.dumps(out))
"""


@pytest.fixture(scope="module")
def installed(tmp_path_factory: pytest.TempPathFactory) -> dict[str, str]:
    """What setup.bash would set for ullage_ros, installed as colcon does; with it the command `ullage`."""
    python = interpreter()
    if (
        python is None
        or subprocess.run([python, "-c", "import launch_ros.actions"], check=False, capture_output=True).returncode
    ):
        pytest.skip("no launch beside rclpy: integrations/ros2/README.md says how to get it")
    place = tmp_path_factory.mktemp("ullage_ros")
    shutil.copytree(PACKAGE, place / "source")
    words = [
        "install",
        "--prefix",
        place / "install",
        "--single-version-externally-managed",
        "--record",
        place / "list",
    ]
    subprocess.run([python, "setup.py", "-q", *words], cwd=place / "source", check=True, capture_output=True)
    command = place / "bin/ullage"
    command.parent.mkdir()
    command.write_text(f'#!/bin/sh\nexec {python} -m ullage "$@"\n')
    command.chmod(0o755)
    library = next((place / "install/lib").glob("python3*/site-packages"))
    return {
        "PYTHONPATH": f"{ROOT / 'src'}:{library}", "PATH": f"{command.parent}:{os.environ['PATH']}",
        "AMENT_PREFIX_PATH": f"{place / 'install'}:{python.parent.parent}", "HOME": str(place),
        "ULLAGE_LAUNCH": str(place / "install/share/ullage_ros/launch"),
    }  # fmt: skip


@pytest.mark.usefixtures("heeded_signals")
def test_every_launch_file_starts_what_it_says(network: Network, installed: dict[str, str]) -> None:
    files = [f"{installed['ULLAGE_LAUNCH']}/{name}" for name in FILES]
    started = result_of(network.start("-c", DESCRIBE, *files, **installed))
    assert started.pop("radars.launch.py") == [["ullage_ros", "radar_simulator"], ["ullage_ros", "radar_mapping"]]
    gazebo = [["ullage_ros", "gazebo_server"], ["ullage_ros", "gazebo_pilot"]]
    *nodes, (_, _, radars, *_) = started.pop("gazebo_flight.launch.py")
    assert nodes == gazebo
    assert Address.of(radars).scheme == "gazebo"
    for name, commands in started.items():
        scenario = name.partition(".")[0].replace("_", "-")
        address = "ros2:?linger_s=60&pace=1&frame_prefix=&remap="
        assert commands == [["ullage", "run", scenario, "--force", "--out", "runs", "--to", address]]
        assert SinkOptions(**Address.of(address).options).frame_prefix == ""


def end(launched: subprocess.Popen[str]) -> str:
    """Ctrl-C, which a terminal gives to all that was started; what it said."""
    os.killpg(launched.pid, signal.SIGINT)
    out, err = launched.communicate(timeout=60)
    return out + err


def test_radars_on_a_robot_that_others_move_and_the_map_of_what_they_see(
    network: Network, installed: dict[str, str]
) -> None:
    robot = network.ready("move.py")
    listener = network.ready("hear.py", "--all", *RADARS)
    words = ("pose:=/robot/odom", "fidelity:=thesis")
    launched = network.start("start.py", f"{installed['ULLAGE_LAUNCH']}/radars.launch.py", *words, **installed)
    got = result_of(listener)
    said = end(launched)
    robot.kill()
    assert got["last"]["/map"]["info"]["width"] in (200, 201)
    assert "Traceback" not in said
    assert said.count("process has finished cleanly") == 2, said
    assert "failed to terminate" not in said, said


@pytest.mark.parametrize(
    "name",
    [
        pytest.param(file.partition(".")[0], marks=[] if file.startswith("ntnu_pole") else pytest.mark.slow)
        for file in FILES
        if file not in ("radars.launch.py", "gazebo_flight.launch.py")
    ],
)
def test_a_scenario_flies_by_itself_and_everything_is_heard(
    name: str, network: Network, installed: dict[str, str], tmp_path: Path
) -> None:
    listener = network.ready("hear.py", "--all", *FLOWN)
    file = f"{installed['ULLAGE_LAUNCH']}/{name}.launch.py"
    pace = 10 if name in LONG else 1
    launched = network.start("start.py", file, f"pace:={pace}", cwd=tmp_path, **installed)
    got: Any = result_of(listener, timeout=300)
    said = end(launched)
    assert set(got["count"]) == {topic.partition("=")[0] for topic in FLOWN}
    assert "Traceback" not in said, said
    assert "failed to terminate" not in said, said
