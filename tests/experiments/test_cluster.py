"""Tasks on a real Dask cluster of processes: the same results, nothing lost to a kill, and clear refusals."""

from __future__ import annotations

import csv
import json
import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path

import pytest

import ullage as ul
from ullage.experiments.cluster import each_done

pytest.importorskip("distributed")
pytestmark = pytest.mark.slow

SWEEP = [
    *("sweep", "mine.yaml", "--over", "map.step_m=0.2,0.5", "--out", "runs"),
    *("-o", "flight.waypoints=[[0, 0, 1], [0.5, 0, 1]]", "-o", "flight.vehicle=ideal", "-o", "do=[detect, map]"),
]


def started(module: str, *words: str | Path, path: Path | None = None, cwd: Path | None = None) -> subprocess.Popen:
    env = os.environ | ({"PYTHONPATH": str(path)} if path else {})
    command = [sys.executable, "-m", f"distributed.cli.{module}", *map(str, words)]
    return subprocess.Popen(command, env=env, cwd=cwd, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)


def reached(there: Callable[[], bool]) -> bool:
    end = time.monotonic() + 120
    while not there() and time.monotonic() < end:
        time.sleep(0.02)
    return there()


@contextmanager
def scheduler(
    folder: Path, *workers: Sequence[str], path: Path | None = None
) -> Iterator[tuple[str, subprocess.Popen]]:
    """A scheduler and its workers, each a process; its address."""
    file = folder / "scheduler.json"
    file.unlink(missing_ok=True)
    first = started("dask_scheduler", "--host", "127.0.0.1", "--port", "0", "--no-dashboard", "--scheduler-file", file)
    others = []
    try:
        assert reached(file.exists)
        address = json.loads(file.read_text())["address"]
        common = "--no-dashboard", "--local-directory", folder
        others = [started("dask_worker", address, *common, *words, path=path, cwd=folder) for words in workers]
        if others:
            import distributed

            with distributed.Client(address, timeout=60) as client:
                client.wait_for_workers(len(others), timeout=60)
        yield address, first
    finally:
        for process in (*others, first):
            process.terminate()
        for process in (*others, first):
            try:
                process.wait(15)
            except subprocess.TimeoutExpired:
                process.kill()


def all_done(where: int | str) -> list[tuple]:
    return list(each_done(lambda task, log: task * task, [1, 2, 3], where=where))


def test_a_place_without_scheduler_is_refused() -> None:
    with pytest.raises(ul.InputError, match=r"tcp://127\.0\.0\.1:1: no scheduler there"):
        all_done("tcp://127.0.0.1:1")
    with pytest.raises(ul.InputError, match="nonsense://x: no scheduler there"):
        all_done("nonsense://x")


def test_workers_that_cannot_be_used_are_refused(tmp_path: Path) -> None:
    with scheduler(tmp_path) as (address, _), pytest.raises(ul.InputError, match="the scheduler has no workers"):
        all_done(address)
    with (
        scheduler(tmp_path, ["--nthreads", "2", "--no-nanny"]) as (address, _),
        pytest.raises(ul.InputError, match=r"has 2 threads.*one thread in each worker"),
    ):
        all_done(address)
    other = tmp_path / "other" / "ullage"
    other.mkdir(parents=True)
    (other / "__init__.py").write_text('__version__ = "0.0.9"\n')
    with (
        scheduler(tmp_path, ["--nthreads", "1", "--no-nanny"], path=other.parent) as (address, _),
        pytest.raises(ul.InputError, match=rf"has ullage 0\.0\.9; here is {ul.__version__}.*the same version"),
    ):
        all_done(address)


def test_results_and_errors_come_back_and_four_lost_workers_end_a_task() -> None:
    def work(task: str, log: Callable[[str], None]) -> str:
        if task == "refused":
            raise ul.InputError("no such wall", where="world")
        if task == "broken":
            raise ZeroDivisionError("by nought")
        if task == "deadly":
            os.kill(os.getpid(), signal.SIGKILL)
        return task.upper()

    found = {task: (result, str(error)) for task, result, error in each_done(
        work, ["fine", "refused", "broken", "deadly"], where=2)}  # fmt: skip
    assert found["refused"] == (None, "world: no such wall")
    assert found["broken"] == (None, "ZeroDivisionError: by nought")
    assert found["deadly"] == (None, "four workers ended during this task; too little memory?")
    assert found["fine"] == ("FINE", "None")


def test_a_scheduler_that_ends_is_one_line(tmp_path: Path) -> None:
    def work(task: int, log: Callable[[str], None]) -> int:
        time.sleep(600 if task else 0)
        return task

    with scheduler(tmp_path, ["--nthreads", "1"]) as (address, process):
        results = each_done(work, [0, 1], where=address)
        assert next(results)[0] == 0
        process.kill()
        with pytest.raises(ul.UllageError, match="the scheduler is gone; what was finished is kept"):
            next(results)


def test_a_sweep_gives_the_same_table_in_one_process_and_on_a_cluster(tmp_path: Path) -> None:
    """The workers run in another folder: names of files mean the same there."""
    for name in ("here", "there"):
        folder = tmp_path / name
        folder.mkdir()
        shown = subprocess.run(
            [sys.executable, "-m", "ullage", "config", "ntnu-plate"], capture_output=True, check=True
        )
        (folder / "mine.yaml").write_bytes(shown.stdout)
    words = [sys.executable, "-m", "ullage", *SWEEP]
    subprocess.run([*words, "--jobs", "1"], cwd=tmp_path / "here", check=True)
    with scheduler(tmp_path, ["--nthreads", "1"]) as (address, _):
        shown = subprocess.run(
            [*words, "--scheduler", address], cwd=tmp_path / "there", check=True, capture_output=True
        )
    assert b"2 of 2 runs" in shown.stdout
    here, there = (list(csv.DictReader((tmp_path / name / "runs" / "sweep.csv").open())) for name in ("here", "there"))
    assert len(here) == 2
    for row in (*here, *there):
        assert float(row.pop("real_time_factor")) > 0  # measures the machine
    assert here == there
    both = subprocess.run(
        [*words, "--scheduler", address, "--jobs", "2"], cwd=tmp_path, check=False, capture_output=True
    )
    assert both.returncode == 2
    assert b"--jobs or --scheduler" in both.stderr
