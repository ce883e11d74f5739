"""Whose rclpy is used: the one that a sourced ROS 2 puts on PYTHONPATH; or one line where there is none."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from pathlib import Path

import pytest

from .network import ROOT, Network, interpreter, result_of

WHOSE = "import json, rclpy, ullage; print(json.dumps([rclpy.__file__, ullage.__file__]))"


def plain() -> Path:
    """The Python that runs the tests: it has ullage, and no rclpy of its own."""
    found = subprocess.run([sys.executable, "-c", "import rclpy"], capture_output=True, check=False, env=bare())
    if found.returncode == 0:
        pytest.skip("this environment has an rclpy of its own")
    return Path(sys.executable)


def bare(**extra: str) -> dict[str, str]:
    """The environment without any ROS 2."""
    kept = {name: value for name, value in os.environ.items() if not name.startswith(("ROS_", "AMENT_", "RMW_"))}
    return kept | {"PYTHONPATH": str(ROOT / "src")} | extra


def sourced(python: Path) -> dict[str, str]:
    """What a setup.bash sets, for the packages in the environment of this Python."""
    ask = (
        "import json, os, site, sys; print(json.dumps([site.getsitepackages()[0], sys.prefix, "
        "{k: v for k, v in os.environ.items() if k in ('AMENT_PREFIX_PATH', 'LD_LIBRARY_PATH')}]))"
    )
    out = subprocess.run([python, "-c", ask], capture_output=True, text=True, check=True, env=bare())
    packages, prefix, heard = json.loads(out.stdout)
    libraries = f"{prefix}/lib:{heard.get('LD_LIBRARY_PATH', '')}".rstrip(":")
    return {
        "PYTHONPATH": f"{ROOT / 'src'}:{packages}", "LD_LIBRARY_PATH": libraries,
        "AMENT_PREFIX_PATH": heard.get("AMENT_PREFIX_PATH", prefix),
    }  # fmt: skip


@pytest.mark.ros2
def test_the_rclpy_of_a_sourced_environment_is_used(network: Network) -> None:
    python = interpreter()
    assert python is not None
    there = sourced(python)
    ours = Network(plain(), network.prefix, network.domain)
    rclpy, ullage = result_of(ours.start("-c", WHOSE, **there))
    assert Path(rclpy).is_relative_to(python.parent.parent)
    assert Path(ullage).is_relative_to(ROOT)
    listener = network.ready(
        "hear.py", "/radar/front/frame=ullage_msgs/msg/RadarFrame:sensor", "/tf=tf2_msgs/msg/TFMessage:stream"
    )
    speaker = ours.start("speak.py", "ros2:?pace=1&linger_s=1&listeners=1", **there)
    out, err = speaker.communicate(timeout=120)
    assert speaker.returncode == 0, out + err
    assert result_of(listener, stop=True)["count"]["/radar/front/frame"] > 20


def test_without_any_rclpy_one_line_says_how_to_get_it(tmp_path: Path) -> None:
    for words in (["ros2:"], ["ntnu-pole", "--force", "--to", "ros2:"]):
        run = [plain(), "-m", "ullage", "run", *words]
        got = subprocess.run(run, capture_output=True, text=True, check=False, env=bare(), cwd=tmp_path, timeout=120)
        assert got.returncode == 2
        said = [line for line in got.stderr.splitlines() if line.strip()]
        assert len(said) == 1, got.stderr
        assert "rclpy" in said[0]
        assert "pip install 'ullage[ros2]'" in said[0]
