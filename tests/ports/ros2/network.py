"""Real ROS 2 in processes of its own, on the loopback of a network namespace of its own where that is allowed."""

from __future__ import annotations

import json
import os
import random
import shutil
import signal
import subprocess
import threading
import time
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import pytest

ROOT = Path(__file__).parents[3]
HERE = Path(__file__).parent


def interpreter() -> Path | None:
    """A Python with rclpy: named by ULLAGE_ROS2_PYTHON, or that of .venv-ros2."""
    named = os.environ.get("ULLAGE_ROS2_PYTHON", "")
    place = Path(named) if named else ROOT / ".venv-ros2/bin/python"
    return place if place.exists() else None


@dataclass
class Network:
    """Starts programs that hear each other and nobody else."""

    python: Path
    prefix: list[str]
    domain: int
    running: list[subprocess.Popen[str]] = field(default_factory=list)

    def start(self, *words: str | Path, cwd: Path = ROOT, **extra: str) -> subprocess.Popen[str]:
        """Start the ROS 2 Python with these arguments; a name.py is one of this folder."""
        command = [str(HERE / w) if str(w).endswith(".py") and (HERE / w).exists() else str(w) for w in words]
        there = dict(os.environ) | {
            "PYTHONPATH": str(ROOT / "src"), "ROS_DOMAIN_ID": str(self.domain), "FASTDDS_BUILTIN_TRANSPORTS": "UDPv4",
            "ROS_AUTOMATIC_DISCOVERY_RANGE": "LOCALHOST", "PYTHONUNBUFFERED": "1",
            "FASTDDS_DEFAULT_PROFILES_FILE": str(ROOT / "integrations" / "ros2" / "fastdds_discovery.xml"),
        } | extra  # fmt: skip
        started = subprocess.Popen(
            [*self.prefix, str(self.python), *command], env=there, text=True, cwd=cwd,
            stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=subprocess.PIPE,
            start_new_session=True,
        )  # fmt: skip
        self.running.append(started)
        return started

    def ready(self, *words: str | Path, **extra: str) -> subprocess.Popen[str]:
        """Start, and wait for its first line."""
        started = self.start(*words, **extra)
        assert started.stdout is not None
        line = started.stdout.readline()
        assert line, started.communicate()[1]
        return started


def result_of(started: subprocess.Popen[str], *, stop: bool = False, timeout: float = 120.0) -> Any:
    """What a program said in its last line, as JSON, once it has ended (or been asked to, by the end of its input)."""
    early = ""
    if not stop:  # read as it speaks, since its end may be longer than a pipe holds, and leave its input open
        late = threading.Timer(timeout, started.kill)
        late.start()
        assert started.stdout is not None
        early = started.stdout.read()
        late.cancel()
    out, err = started.communicate(timeout=timeout)
    out = early + out
    assert started.returncode == 0, out + err
    return json.loads(out.strip().splitlines()[-1])


@pytest.fixture(scope="session")
def namespace() -> Iterator[list[str]]:
    """Words before a command that put it into a network of its own; none where that is not allowed."""
    script = "ip link set lo up && ip link set lo multicast on && ip route add 239.0.0.0/8 dev lo; echo up; sleep 3600"
    if not all(map(shutil.which, ("unshare", "nsenter", "ip"))):
        yield []
        return
    holder = subprocess.Popen(["unshare", "-n", "sh", "-c", script], stdout=subprocess.PIPE, text=True)
    assert holder.stdout is not None
    up = holder.stdout.readline().strip() == "up"
    yield ["nsenter", "-t", str(holder.pid), "-n"] if up else []
    holder.terminate()
    holder.wait()


@pytest.fixture(scope="module")
def network(namespace: list[str]) -> Iterator[Network]:
    """Somewhere for ROS 2 programs to meet."""
    python = interpreter()
    if python is None:
        pytest.skip("no ROS 2 wheels: .ci/run makes .venv-ros2, or set ULLAGE_ROS2_PYTHON")
    made = Network(python, namespace, random.Random(os.getpid() + time.monotonic_ns()).randrange(1, 100))
    yield made
    for started in made.running:
        if started.poll() is None:
            os.killpg(started.pid, signal.SIGKILL)  # what it started too
        started.communicate()
