"""Tasks on a real Dask cluster of processes: the same results, nothing lost to a kill, and clear refusals."""

from __future__ import annotations

import csv
import json
import os
import resource
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from importlib.util import find_spec
from pathlib import Path

import pytest
from process_table import alive

import ullage as ul
from ullage.experiments.cluster import each_done
from ullage.experiments.dataset import read_index

pytestmark = [pytest.mark.slow, pytest.mark.skipif(not find_spec("distributed"), reason="needs distributed")]

SWEEP = [
    *("sweep", "mine.yaml", "--over", "map.step_m=0.2,0.5", "--out", "runs"),
    *("-o", "flight.waypoints=[[0, 0, 1], [0.5, 0, 1]]", "-o", "flight.vehicle=ideal", "-o", "do=[detect, map]"),
]


def started(module: str, *words: str | Path, path: Path | None = None, cwd: Path | None = None) -> subprocess.Popen:
    env = os.environ | ({"PYTHONPATH": str(path)} if path else {})
    command = [sys.executable, "-m", f"distributed.cli.{module}", *map(str, words)]
    return subprocess.Popen(command, env=env, cwd=cwd, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)


def reached(there: Callable[[], bool]) -> bool:
    end = time.monotonic() + 300
    while not there() and time.monotonic() < end:
        time.sleep(0.02)
    return there()


def is_whole(file: Path) -> bool:
    """Whether a scheduler has written all of its file: it exists, empty, a moment before."""
    try:
        json.loads(file.read_text())
    except (FileNotFoundError, json.JSONDecodeError):
        return False
    return True


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
        assert reached(lambda: is_whole(file))
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


def test_a_local_cluster_leaves_the_environment_as_it_was() -> None:
    before = dict(os.environ)
    assert [result for _, result, _ in each_done(lambda task, log: task, [1], where=2)] == [1]
    assert dict(os.environ) == before


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


KINDS, N, FRAMES = ["office", "pillars"], 48, 4


def making(folder: Path, *words: str, **kept: object) -> subprocess.Popen:
    command = [
        sys.executable,
        "-m",
        "ullage",
        "dataset",
        *KINDS,
        "--n",
        str(N),
        "--frames",
        str(FRAMES),
        "--to",
        "set.zarr",
    ]
    return subprocess.Popen(
        [*command, *words], cwd=folder, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, **kept
    )


def shards(path: Path) -> int:
    return len(list(path.glob("index/*.parquet")))


def workers_of(pid: int) -> list[int]:
    """Worker processes that a client has started."""
    found = []
    for stat in Path("/proc").glob("[0-9]*/stat"):
        try:
            parent = int(stat.read_text().rsplit(")", 1)[1].split()[1])
            if parent == pid and b"spawn_main" in (stat.parent / "cmdline").read_bytes():
                found.append(int(stat.parent.name))
        except (OSError, ValueError):
            continue
    return found


@pytest.mark.skipif(not Path("/proc/self/stat").exists(), reason="needs /proc")
def test_nothing_is_lost_when_worker_client_and_scheduler_are_killed(tmp_path: Path) -> None:
    """One set after the other of these, and at the end the bits of a set made in one process."""
    path = tmp_path / "set.zarr"
    client = making(tmp_path, "--jobs", "2")
    try:
        assert reached(lambda: shards(path) >= 1)
        first = workers_of(client.pid)
        os.kill(first[0], signal.SIGKILL)
        assert reached(lambda: shards(path) >= 2)
        assert client.poll() is None, client.communicate()
        at_work = workers_of(client.pid)
    finally:
        client.kill()
        client.wait()
    assert reached(lambda: not any(map(alive, at_work)))  # workers end with their client
    assert 0 < len(read_index(path)) < N
    with scheduler(tmp_path, ["--nthreads", "1"]) as (address, process):
        client = making(tmp_path, "--scheduler", address)
        before = shards(path)
        assert reached(lambda: shards(path) > before)
        process.kill()
        _, words = client.communicate(timeout=300)
        assert client.returncode == 2
        assert "the scheduler is gone; what was finished is kept" in words
    assert before * 8 < len(read_index(path)) < N
    with scheduler(tmp_path, ["--nthreads", "1"]) as (address, _):
        client = making(tmp_path, "--scheduler", address)
        _, words = client.communicate(timeout=300)
        assert client.returncode == 0, words
    whole = ul.dataset(KINDS, tmp_path / "whole.zarr", n=N, frames=FRAMES, where=1)
    assert [row["k"] for row in read_index(path)] == list(range(N))
    assert read_index(path) == read_index(whole)
    assert same_arrays(path, whole)


def same_arrays(one: Path, other: Path) -> bool:
    import zarr

    mine, theirs = (dict(zarr.open_group(str(path), mode="r").arrays()) for path in (one, other))
    return mine.keys() == theirs.keys() and all(
        mine[name][...].tobytes() == theirs[name][...].tobytes() for name in mine
    )


@pytest.mark.usefixtures("heeded_signals")
def test_ctrl_c_ends_a_data_set_at_once_and_a_full_disk_is_one_line(tmp_path: Path) -> None:
    """Files may not grow beyond 64 kB at first, which the system reports as it does a full disk."""

    def small() -> None:
        resource.setrlimit(resource.RLIMIT_FSIZE, (1 << 16, 1 << 16))

    full = making(tmp_path, "--jobs", "1", preexec_fn=small)
    _, words = full.communicate(timeout=300)
    assert full.returncode == 2
    assert "set.zarr: cannot write: " in words
    assert "Traceback" not in words
    assert read_index(tmp_path / "set.zarr") == []
    pressed = making(tmp_path, "--jobs", "2", start_new_session=True)
    assert reached(lambda: shards(tmp_path / "set.zarr") >= 1)
    os.killpg(pressed.pid, signal.SIGINT)  # as a terminal does, to the workers too
    out, words = pressed.communicate(timeout=300)
    assert pressed.returncode == 130
    assert "run the same command again to go on" in out
    assert words == ""
    assert 0 < len(read_index(tmp_path / "set.zarr")) < N
