"""The command line: a run between an autopilot and itself; what cannot be used is one line and exit code 2."""

from __future__ import annotations

import csv
import math
import socket
import time
from pathlib import Path

import pytest
from typer.testing import CliRunner

pytest.importorskip("pymavlink")

from mavlink_autopilot import Autopilot, local_poses
from test_mavlink_source import SDF

from ullage.cli import app
from ullage.errors import UllageError


@pytest.mark.parametrize(
    ("place", "words"),
    [
        ("udp://no.such.host.invalid:14550", "no such host"),
        ("udp://127.0.0.1:99999", "port '99999'"),
        ("serial:///dev/ttyNOPE9", "no such serial device"),
        ("udpin://127.0.0.1:{taken}", "Address already in use"),
        ("udp://127.0.0.1:9?vehicle=9&wait_s=0.2", "no HEARTBEAT of system 9"),
        ("udp://127.0.0.1:9?colour=red", "no option 'colour'"),
    ],
)
def test_a_sink_that_cannot_be_used_is_refused(tmp_path: Path, place: str, words: str) -> None:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as sock:
        sock.bind(("127.0.0.1", 0))
        to = "mavlink:" + place.format(taken=sock.getsockname()[1])
        found = CliRunner().invoke(app, ["run", "ntnu-plate", "--out", str(tmp_path), "--to", to])
    assert isinstance(found.exception, UllageError)
    assert found.exception.exit_code == 2
    assert words in str(found.exception)
    assert "\n" not in str(found.exception)


def test_a_run_takes_poses_from_an_autopilot_and_sends_it_distances(tmp_path: Path) -> None:
    """Without TIMESYNC frames keep the autopilot's time, so that no distance is late on a slow machine."""
    world = tmp_path / "wall.sdf"
    world.write_text(SDF)
    poses, ahead_ns = local_poses(lambda t_s: (0.0, 0.0, -1.0), math.radians(90)), 50 * 10**9 - time.monotonic_ns()
    with Autopilot(poses=poses, boot_ns=ahead_ns, timesync=False) as autopilot:
        place = f"mavlink:udp://127.0.0.1:{autopilot.port}"
        # lag=0: every frame, however slow this machine is
        source = f"{place}?world={world}&rig=single&rate_hz=20&duration_s=1&lag=0"
        to = ["--do", "obstacles", "--to", f"{place}?pace=0", "--out", str(tmp_path)]
        found = CliRunner().invoke(app, ["run", source, *to])
        assert found.exit_code == 0, found.output
        sent = [one.distances[0] for one in autopilot.of("OBSTACLE_DISTANCE")]
    rows = list(csv.DictReader((tmp_path / "latest" / "obstacles.csv").open()))
    assert len(sent) == len(rows) >= 20
    assert sent[-1] == pytest.approx(100 * float(rows[-1]["distance_m"]), abs=1)
    assert sent[-1] == pytest.approx(295, abs=10)
