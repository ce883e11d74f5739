"""A live run that is stopped or killed keeps its recording and its map."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest
from imc_peer import Peer
from waiting import until

import ullage as ul
from ullage.experiments.folder import RunFolder
from ullage.ports import read_map


def flight(folder: Path) -> bytes:
    path = ul.Trajectory.line((-1, 0, 0), (1, 0, 0), 0.5, 25)
    path = ul.Trajectory(path.t_ns + time.time_ns(), path.position, path.quat_xyzw)
    frames = ul.simulate(ul.scenes.room((6, 4, 3)), path, ul.RadarSpec.preset("x4m05", fps=25), fidelity="thesis")
    with ul.sink(folder / "Data.lsf", distance="off") as log:
        log.write({"front": frames})
    return (folder / "Data.lsf").read_bytes()


@pytest.mark.parametrize("number", [pytest.param(signal.SIGTERM, marks=pytest.mark.slow), signal.SIGKILL])
def test_a_live_run_that_is_stopped_keeps_recording_and_map(tmp_path: Path, number: signal.Signals) -> None:
    pieces, runs = [flight(tmp_path)], tmp_path / "runs"
    with Peer(tick=lambda _: pieces.pop() if pieces else b"") as peer:
        small = ("-o", "map.method=elfes", "-o", "map.reach_m=4", "-o", "map.step_m=0.2")
        command = [sys.executable, "-m", "ullage", "run", f"imc:{peer.place}", *small]
        process = subprocess.Popen(command, cwd=tmp_path, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True)
        until(lambda: list(runs.glob(".*.draft/map.yaml")) or process.poll() is not None)
        time.sleep(1.0)  # the recording is at most half a second behind
        process.send_signal(number)
        printed, _ = process.communicate(timeout=100)
    (folder,) = (p for p in runs.iterdir() if p.name.strip(".").startswith("imc-") and p.is_dir())
    if number == signal.SIGKILL:
        assert RunFolder(folder).state == "unfinished"
        assert not (runs / "latest").exists()
    else:
        assert process.returncode == 0, printed
        assert "interrupted" in printed
        assert RunFolder(folder).state == "interrupted"
        assert folder.samefile(runs / "latest")
        assert {"metrics.json", "report.html", "metadata.yaml"} <= set(os.listdir(folder))
    assert len(ul.open(str(folder)).frames()) > 10
    assert (read_map(folder / "map.yaml").percent >= 0).any()
