"""Fuzz every reader with damaged real inputs, by coverage: `python tests/fuzz/fuzz.py --seconds 300`.

Each reader runs in a process of its own under atheris (libFuzzer): an exception other than InputError, an input that
takes over ten seconds, or memory over the limit ends that process; its input is kept, and the reader goes on with the
next seed. The first seed is fixed, so `--runs` reads the same inputs each time.
"""

from __future__ import annotations

import argparse
import hashlib
import importlib
import os
import pkgutil
import re
import subprocess
import sys
import tempfile
import time
import warnings
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

LONGEST_S, MOST_MB = 10, 1500
"""Limits of one input; the memory is that of the process, 300 to 500 MB of it libraries."""

FINDINGS = Path("fuzz-findings")
INSTRUMENTED = ["ullage.config", "ullage.specs", "ullage.untrusted", "ullage.ports", "ullage.world", "ullage.grids"]


@dataclass
class Count:
    """What came of one reader."""

    name: str
    inputs: int = 0
    seconds: float = 0.0
    peak_mb: int = 0
    findings: list[str] = field(default_factory=list)

    def __str__(self) -> str:
        rate = self.inputs / max(self.seconds, 1e-9)
        text = f"{self.name:14} {self.inputs:>10,} inputs {rate:>8,.0f}/s {self.peak_mb:>6} MB"
        text += f"  {len(self.findings)} findings"
        return "\n".join([text, *(f"    {finding}" for finding in self.findings)])


def fuzz(name: str, seconds: float, runs: int, seed: int) -> Count:
    """Run one reader until its time or its number of inputs is over."""
    count, begun = Count(name), time.monotonic()
    while True:
        left = seconds - (time.monotonic() - begun)
        todo = runs - count.inputs if runs else 0
        if left < 1 or (runs and todo <= 0) or len(count.findings) >= 20:
            break
        words = ["--reader", name, "--child", "--seconds", str(int(left)), "--runs", str(todo), "--seed", str(seed)]
        done = subprocess.run(
            [sys.executable, __file__, *words], capture_output=True, text=True, errors="replace", check=False,
            env=os.environ | {"PYTHONHASHSEED": "0"},  # else coverage, and with it the inputs, differ from run to run
        )  # fmt: skip
        found = {key: int(value) for key, value in re.findall(r"stat::(\w+):\s+(\d+)", done.stderr)}
        count.inputs += found.get("number_of_executed_units", 0)
        count.peak_mb = max(count.peak_mb, found.get("peak_rss_mb", 0))
        seed += 1
        if done.returncode:
            count.findings.append(_finding(done.stdout + done.stderr))
            if "number_of_executed_units" not in found:
                break
    count.seconds = time.monotonic() - begun
    return count


def _finding(text: str) -> str:
    """The exception and the line of ours that raised it, or what libFuzzer says."""
    error = re.findall(r"^(?:\w+\.)*\w*(?:Error|Exception|Warning|Exit)\b.*", text, re.M)
    where = re.findall(r'File ".*?/(ullage/[^"]+)", line (\d+)', text)
    said = re.findall(r"ERROR: libFuzzer: (.*)", text)
    kept = re.findall(r"Test unit written to (\S+)", text)
    place = ":".join(where[-1]) if where else ""
    return " ".join([(error or said or [text[-300:]])[0][:160], place, *kept[-1:]])


def child(name: str, seconds: int, runs: int, seed: int) -> None:
    """Fuzz in this process; libFuzzer ends it."""
    import atheris

    warnings.simplefilter("ignore")
    for kernel in pkgutil.iter_modules(importlib.import_module("ullage.kernels").__path__, "ullage.kernels."):
        importlib.import_module(kernel.name)  # what is instrumented cannot be compiled
    with atheris.instrument_imports(include=INSTRUMENTED):
        import readers
    reader = next(reader for reader in readers.READERS if reader.name == name)
    home = Path(tempfile.mkdtemp(prefix=f"ullage-fuzz-{name}-", dir="/dev/shm" if Path("/dev/shm").is_dir() else None))
    corpus, kept = home / "corpus", FINDINGS.absolute() / name
    corpus.mkdir()
    kept.mkdir(parents=True, exist_ok=True)
    (home / "seeds").mkdir()
    seeds = reader.seeds(home / "seeds")
    for data in seeds:
        (corpus / hashlib.sha256(data).hexdigest()[:16]).write_bytes(data[: readers.LARGEST])
    # without a limit near the seeds inputs grow until each takes ten times as long as a seed
    longest = min(readers.LARGEST, max(4096, 4 * max(map(len, seeds), default=0)))
    work = home / "work"
    work.mkdir()
    reader.before(work)

    def one(data: bytes) -> None:
        readers.read_one(reader, data, work)

    options = [
        f"-max_total_time={seconds}", f"-seed={seed}", f"-timeout={LONGEST_S}", f"-rss_limit_mb={MOST_MB}",
        f"-max_len={longest}", "-print_final_stats=1", "-len_control=0", f"-artifact_prefix={kept}/",
        f"-dict={home / 'words'}", "-verbosity=0",
    ]  # fmt: skip
    if runs:
        options.append(f"-runs={runs}")
    (home / "words").write_text(readers.dictionary(b"".join(seeds)))
    atheris.Setup([sys.argv[0], *options, str(corpus)], one)
    atheris.Fuzz()


def main() -> int:
    """Fuzz the chosen readers and print the counts; 1 where something was found."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--reader", action="append", help="only this one; may be given several times")
    parser.add_argument("--seconds", type=float, default=300, help="for all readers together")
    parser.add_argument("--runs", type=int, default=0, help="inputs for each reader; 0: as many as the time allows")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--jobs", type=int, default=2)
    parser.add_argument("--child", action="store_true", help=argparse.SUPPRESS)
    given = parser.parse_args()
    sys.path.insert(0, str(Path(__file__).parent))
    if given.child:
        child(given.reader[0], int(given.seconds), given.runs, given.seed)
    import readers

    names = given.reader or [reader.name for reader in readers.READERS]
    each = given.seconds * given.jobs / len(names)
    found = 0
    with ThreadPoolExecutor(given.jobs) as pool:
        tasks: list[Any] = [pool.submit(fuzz, name, each, given.runs, given.seed) for name in names]
        for task in tasks:
            count = task.result()
            print(count, flush=True)
            found += len(count.findings)
    return 1 if found else 0


if __name__ == "__main__":
    sys.exit(main())
