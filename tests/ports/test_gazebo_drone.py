"""IMC commands over UDP fly a Gazebo drone on the real library of Gazebo Transport, a process that knows no ullage."""

from __future__ import annotations

import json
import math
import shutil
import signal
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

import ullage as ul
from conftest import compiled
from ullage.world.library import WORLDS

HERE = Path(__file__).parent
ROS = HERE.parents[1] / "integrations/ros2/ullage_ros"
DRONE, PILOT = HERE / "gazebo_drone.cpp", HERE / "imc/imc_pilot.py"


@pytest.fixture(scope="session")
def program(tmp_path_factory):
    """The drone, compiled from the few lines beside this file."""
    return compiled(DRONE, tmp_path_factory.mktemp("gazebo"))


@pytest.mark.slow
@pytest.mark.usefixtures("heeded_signals")
def test_a_controller_on_the_bus_flies_a_gazebo_drone_which_hovers_when_it_falls_silent(
    program, partition, ign_topic, tmp_path
):
    pipe = subprocess.PIPE
    drone = subprocess.Popen([program, "x3"], stdin=pipe, stdout=pipe, text=True)
    pilot = subprocess.Popen([sys.executable, PILOT], stdout=pipe, text=True)
    port = pilot.stdout.readline().strip()
    words = f"imc:udp://127.0.0.1:{port}?fly=gazebo:x3"
    command = [sys.executable, "-m", "ullage", "run", words, "--do", "", "--out", tmp_path]
    interpreter = subprocess.Popen(command, stdout=pipe, stderr=pipe, text=True)
    try:
        tool = ign_topic("-e", "-t", "/model/x3/cmd_vel", "-d", "20")
        seen = json.loads(pilot.communicate(timeout=200)[0].splitlines()[-1])
        tool.kill()
        interpreter.send_signal(signal.SIGINT)
        out, err = interpreter.communicate(timeout=60)
        flown = [float(word) for word in drone.communicate("", timeout=20)[0].split()]
    finally:
        for process in (drone, pilot, interpreter):
            process.kill()
    assert interpreter.returncode == 0, out + err
    assert [seen[step] for step in ("met", "risen", "arrived")] == [True] * 3, json.dumps(seen)
    assert seen["answer"] == 1
    assert seen["speed"] == pytest.approx(0.4, abs=0.1)
    assert max(seen["silent_speed"], seen["drift"]) < 0.05
    assert flown[0] > 50
    assert flown[1:4] == pytest.approx([0, 0, 0], abs=0.02)
    assert math.dist(seen["place"], flown[4:]) < 0.2
    assert "linear" in tool.stdout.read()  # Debian's own tool reads our commands


def test_a_gazebo_drone_takes_no_poses_and_has_a_name():
    pytest.importorskip("zmq")
    for place, words in (("fly=gazebo:x3&takes=pose", "take no poses"), ("fly=gazebo:", "no model")):
        with pytest.raises(ul.InputError, match=words):
            ul.open(f"imc:tcp://127.0.0.1:1?{place}")
    with pytest.raises(ul.InputError, match="no drone at 'imc:x'"):
        ul.open("imc:tcp://127.0.0.1:1?fly=imc:x")


@pytest.fixture
def gazebo(monkeypatch):
    """The module of ullage_ros that serves and flies the drone of the launch file."""
    pytest.importorskip("zmq")
    monkeypatch.syspath_prepend(ROS)
    return pytest.importorskip("ullage_ros.gazebo")


@pytest.mark.parametrize("name", ["ntnu-mapping", "cargo-hold"])
def test_the_world_for_gazebo_is_the_library_s_with_the_drone_at_its_start(gazebo, name, tmp_path):
    shipped, urdf = WORLDS[name], ROS / "urdf/quadrotor.urdf"
    file = gazebo.world_with_drone(name, urdf, tmp_path)
    both = ul.load_scene(file, search_path=[urdf.parent, shipped.path.parent])
    drone = [thing.name.startswith("quadrotor") for thing in both.objects]
    mine = np.isin(both.face_object, np.flatnonzero(drone))
    assert np.allclose(both.corners()[~mine], shipped.scene().corners())
    middle = both.corners()[mine].reshape(-1, 3)
    assert np.allclose((middle.min(0) + middle.max(0))[:2] / 2, shipped.start[:2], atol=0.01)
    assert list(both.rigs["quadrotor"].sensors) == ["front", "left", "back", "right", "down"]
    if shutil.which("ign"):
        told = subprocess.run(["ign", "sdf", "-k", file], capture_output=True, text=True, check=False)
        assert "Valid." in told.stdout + told.stderr


@pytest.mark.slow
def test_the_pilot_of_the_launch_file_flies_a_gazebo_drone_along_waypoints(gazebo, program, partition, capfd):
    pipe = subprocess.PIPE
    drone = subprocess.Popen([program, "quadrotor"], stdin=pipe, stdout=pipe, text=True)
    try:
        gazebo.fly([(0, 0, 1, 0), (1.0, 0.0, 1.0, 90)], speed_m_s=0.5)
        flown = [float(word) for word in drone.communicate("", timeout=20)[0].split()]
    finally:
        drone.kill()
    assert "waypoint 2 of 2 reached" in capfd.readouterr().out
    assert flown[1:4] == pytest.approx([0, 0, 0], abs=0.02)  # at the end it was told to hover
    assert math.dist(flown[4:], (1.0, 0.0, 1.0)) < 0.3
