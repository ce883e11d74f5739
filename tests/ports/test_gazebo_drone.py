"""IMC commands over UDP fly a Gazebo drone on the real library of Gazebo Transport, a process that knows no ullage."""

from __future__ import annotations

import json
import math
import signal
import subprocess
import sys
from pathlib import Path

import pytest
from conftest import compiled

import ullage as ul

HERE = Path(__file__).parent
DRONE, PILOT = HERE / "gazebo_drone.cpp", HERE / "imc/imc_pilot.py"


@pytest.fixture(scope="session")
def program(tmp_path_factory):
    """The drone, compiled from the few lines beside this file."""
    return compiled(DRONE, tmp_path_factory.mktemp("gazebo"))


@pytest.mark.slow
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
