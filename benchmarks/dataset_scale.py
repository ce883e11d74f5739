"""What training sets cost, and whether kills lose anything: figures for docs/datasets.md.

    python benchmarks/dataset_scale.py cost [--samples 2]      CPU seconds a sample by kind and bounces
    python benchmarks/dataset_scale.py scaling [--n 120]       wall seconds by one and by two workers, in turn
    python benchmarks/dataset_scale.py memory [--n 1000]       memory of one process while it makes samples
    python benchmarks/dataset_scale.py kills [--n 500]         a worker, the client and the scheduler are killed in turn
    python benchmarks/dataset_scale.py overhead [--n 2000]     scheduler and index: empty tasks, and rows, a second

CPU seconds count, not wall seconds: a busy machine gives the same figures. Only `scaling` needs a quiet machine.
"""

from __future__ import annotations

import argparse
import json
import os
import resource
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from contextlib import closing
from pathlib import Path

import numpy as np

import ullage as ul
from ullage.experiments.cluster import each_done
from ullage.experiments.dataset import read_index
from ullage.experiments.samples import SampleSpec, sample


def resident_mb(pid: int | str = "self") -> float:
    """Memory of a process that is in use now [MB]."""
    text = Path(f"/proc/{pid}/status").read_text()
    return next(int(line.split()[1]) / 1e3 for line in text.splitlines() if line.startswith("VmRSS"))


def cost(given: argparse.Namespace) -> None:
    """Print CPU seconds a sample; the first sample of each kind warms caches and does not count."""
    print("| kind | bounces | samples | CPU s a sample | samples a core-hour |\n|---|---|---|---|---|")
    for kind in given.kinds.split(","):
        for bounces in (1, 2, 3)[: given.bounces]:
            spec = SampleSpec.of([kind], seed=given.seed, frames=given.frames, bounces=[bounces])
            spent = []
            for k in range(given.samples + 1):
                start = time.process_time()
                sample(spec, k)
                spent.append(time.process_time() - start)
            mean = float(np.mean(spent[1:]))
            print(f"| {kind} | {bounces} | {given.samples} | {mean:.2f} | {3600 / mean:.0f} |", flush=True)


def memory(given: argparse.Namespace) -> None:
    """Print memory of one process at each tenth of the samples, and the size on disk."""
    marks: list[float] = []

    def progress(done: int, n: int, text: str) -> None:
        if text.endswith("done") and done * 10 >= n * len(marks):
            marks.append(resident_mb())
            print(f"{done:6d} samples: {marks[-1]:.0f} MB", flush=True)

    with tempfile.TemporaryDirectory(dir=given.folder) as folder:
        start = time.process_time()
        path = ul.dataset(given.kinds.split(","), Path(folder) / "set.zarr", n=given.n, frames=given.frames,
                          seed=given.seed, where=1, progress=progress)  # fmt: skip
        spent = time.process_time() - start
        print(f"{size_of(path) / given.n / 1e3:.0f} kB a sample; {spent / given.n:.2f} CPU s a sample")


def scaling(given: argparse.Namespace) -> None:
    """Print samples a wall second by one worker on one core and by two workers, in turn, once all kinds were met."""
    rates: dict[int, list[float]] = {1: [], 2: []}
    every = os.sched_getaffinity(0)
    for workers in (1, 2):
        done: dict[int, float] = {}  # when so many samples were first there
        os.sched_setaffinity(0, set(sorted(every)[:workers]))
        begun = cpu_s()
        with tempfile.TemporaryDirectory(dir=given.folder) as folder:
            ul.dataset(given.kinds.split(","), Path(folder) / "set.zarr", n=given.n, frames=given.frames,
                       seed=given.seed, where=workers,
                       progress=lambda n, *_, done=done: done.setdefault(n, time.perf_counter()))  # fmt: skip
        first = next(n for n in sorted(done) if n >= given.n // 3)
        rates[workers].append((max(done) - first) / (done[max(done)] - done[first]))
        print(f"{workers} workers: {rates[workers][-1]:.3f} samples a second, "
              f"{(cpu_s() - begun) / given.n:.2f} CPU s a sample, start included", flush=True)  # fmt: skip
    os.sched_setaffinity(0, every)
    print(f"two workers over one: {np.mean(rates[2]) / np.mean(rates[1]):.2f}")


def cpu_s() -> float:
    """CPU time of this process and of those it started that have ended [s]."""
    return sum(sum(resource.getrusage(who)[:2]) for who in (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN))


def size_of(path: Path) -> int:
    """Bytes of all files in a folder."""
    return sum(file.stat().st_size for file in path.rglob("*") if file.is_file())


def kills(given: argparse.Namespace) -> None:
    """Make a data set through three kills, and compare samples with those made anew in this process."""
    kinds = given.kinds.split(",")
    with tempfile.TemporaryDirectory(dir=given.folder) as folder:
        path = Path(folder) / "set.zarr"
        words = ["dataset", *kinds, "--n", str(given.n), "--frames", str(given.frames), "--to", str(path)]
        command = [sys.executable, "-m", "ullage", *words, "--seed", str(given.seed)]
        client = subprocess.Popen([*command, "--jobs", "2"])
        wait_for(path, given.n // 4)
        os.kill(workers_of(client.pid)[0], signal.SIGKILL)
        print("killed a worker at", have(path), flush=True)
        wait_for(path, given.n // 2)
        client.kill()
        client.wait()
        print("killed the client at", have(path), flush=True)
        with_scheduler(
            folder, lambda address, scheduler: lose(path, [*command, "--scheduler", address], scheduler, given)
        )
        subprocess.run([*command, "--jobs", "2"], check=True)
        check(path, given)


def lose(path: Path, command: list[str], scheduler: subprocess.Popen, given: argparse.Namespace) -> None:
    """Kill the scheduler at three quarters."""
    client = subprocess.Popen(command)
    wait_for(path, 3 * given.n // 4)
    scheduler.kill()
    print("killed the scheduler at", have(path), "exit code of the client:", client.wait(), flush=True)


def with_scheduler(folder: str, act: Callable[[str, subprocess.Popen], None]) -> None:
    """Start a scheduler and two workers as processes, and end them."""
    file = Path(folder) / "scheduler.json"
    common = [sys.executable, "-m"]
    begun = [subprocess.Popen([*common, "distributed.cli.dask_scheduler", "--host", "127.0.0.1", "--port", "0",
                               "--no-dashboard", "--scheduler-file", str(file)])]  # fmt: skip
    while not file.exists():
        time.sleep(0.1)
    address = json.loads(file.read_text())["address"]
    begun.append(subprocess.Popen([*common, "distributed.cli.dask_worker", address, "--nworkers", "2", "--nthreads",
                                   "1", "--no-dashboard", "--local-directory", folder]))  # fmt: skip
    time.sleep(20)
    try:
        act(address, begun[0])
    finally:
        for process in begun:
            process.terminate()


def have(path: Path) -> int:
    """Samples that are in the index."""
    return len(read_index(path)) if path.exists() else 0


def wait_for(path: Path, count: int) -> None:
    """Wait until so many samples are there."""
    while have(path) < count:
        time.sleep(0.5)


def workers_of(pid: int) -> list[int]:
    """Worker processes of a client."""
    found = subprocess.run(["pgrep", "-P", str(pid), "-f", "spawn_main"], capture_output=True, text=True, check=True)
    return [int(word) for word in found.stdout.split()]


def check(path: Path, given: argparse.Namespace) -> None:
    """Compare every row, and some samples bit by bit, with samples made in this process."""
    import zarr

    rows, group = read_index(path), zarr.open_group(str(path), mode="r")
    spec = SampleSpec.of(given.kinds.split(","), seed=given.seed, frames=given.frames, bounces=[1])
    numbers = np.random.default_rng(0).choice(given.n, min(given.compared, given.n), replace=False)
    equal = 0
    for k in map(int, numbers):
        arrays, row = sample(spec, k)
        equal += rows[k] == row and all(
            group[name][k].tobytes() == np.asarray(values, group[name].dtype).tobytes()
            for name, values in arrays.items()
        )
    complete = [row["k"] for row in rows] == list(range(given.n))
    print(f"{len(rows)} rows, complete: {complete}; {equal} of {len(numbers)} samples made anew have the same bits")
    if not complete or equal != len(numbers):
        raise SystemExit(1)


def nothing(task: int, log: Callable[[str], None]) -> int:
    """An empty task."""
    return task


def overhead(given: argparse.Namespace) -> None:
    """Print the rate of empty tasks through a local cluster, and of rows read from an index."""
    start = time.process_time()
    with closing(each_done(nothing, range(given.n), where=2)) as results:
        next(results)
        begun, spent = time.perf_counter(), time.process_time()
        count = sum(1 for _ in results)
    wall, cpu = time.perf_counter() - begun, time.process_time() - spent
    print(
        f"{count} empty tasks: {1e3 * cpu / count:.2f} ms CPU in the scheduler and client, {count / wall:.0f} a second"
    )
    print(f"start and stop: {time.process_time() - start - cpu:.1f} s CPU")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("what", choices=("cost", "scaling", "memory", "kills", "overhead"))
    parser.add_argument("--kinds", default=",".join(ul.worlds.KINDS))
    parser.add_argument("--n", type=int, default=500)
    parser.add_argument("--samples", type=int, default=2)
    parser.add_argument("--bounces", type=int, default=3, help="up to so many")
    parser.add_argument("--frames", type=int, default=64)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--compared", type=int, default=40)
    parser.add_argument("--folder", default=None)
    given = parser.parse_args()
    {"cost": cost, "scaling": scaling, "memory": memory, "kills": kills, "overhead": overhead}[given.what](given)


if __name__ == "__main__":
    main()
