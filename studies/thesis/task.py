"""Run one experiment of the thesis unless its results exist already."""

from __future__ import annotations

import hashlib
import json
import os
import shutil
import subprocess
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import ullage
from studies.thesis.plan import Experiment
from studies.thesis.results import Results, read_results
from studies.thesis.workspace import Workspace
from ullage.errors import InputError
from ullage.experiments.folder import Verdict, provenance, read_json, verdicts


@dataclass(frozen=True, slots=True)
class Chapter:
    """Finished experiment."""

    experiment: Experiment
    folder: Path
    results: Results
    verdicts: tuple[tuple[str, Verdict], ...]  # scenario, bound
    origin: str  # of what code, when, where
    took_s: float
    cpu_s: float


@dataclass(frozen=True, slots=True)
class Reproduction:
    """All finished experiments, and whether the run was interrupted."""

    folder: Path
    chapters: tuple[Chapter, ...]
    interrupted: bool
    report: Path

    @property
    def broken(self) -> list[str]:
        """List statements that do not hold and scenarios out of bounds, in words."""
        out = []
        for chapter in self.chapters:
            out += [
                f"{s.text}: {s.value:.4g} {s.unit}, wanted {s.wanted}"
                for s in chapter.results.statements
                if not s.holds
            ]
            out += [f"{name}: {v.text}" for name, v in chapter.verdicts if not v.inside]
        return out

    @property
    def counts(self) -> tuple[int, int]:
        """Count the statements and bounds that hold, and all of them."""
        flags = [s.holds for c in self.chapters for s in c.results.statements]
        flags += [v.inside for c in self.chapters for _, v in c.verdicts]
        return sum(flags), len(flags)


@dataclass(frozen=True, slots=True)
class ExperimentTask:
    """Experiment with its folder and settings."""

    experiment: Experiment
    root: Path
    recordings: Path
    quick: bool
    code: str  # that does it; known to the processes that do, so that code which changes meanwhile does not count

    @property
    def name(self) -> str:
        """The experiment's."""
        return self.experiment.name

    @property
    def title(self) -> str:
        """The experiment's."""
        return self.experiment.title

    @property
    def cost(self) -> float:
        """How long it takes, beside the others."""
        return self.experiment.small if self.quick else self.experiment.weight

    @property
    def folder(self) -> Path:
        """Folder of its results."""
        return self.root / self.name

    @property
    def mark(self) -> Path:
        """File that marks it as finished."""
        return self.folder / "results.json"

    @property
    def done(self) -> bool:
        """Whether its results exist, from this code, these scenarios and these recordings."""
        return self.mark.is_file() and read_json(self.mark).get("inputs") == self.inputs

    @property
    def inputs(self) -> str:
        """Return a hash of everything that its result depends on."""
        text = hashlib.sha256(json.dumps([self.experiment.name, self.quick, ullage.__version__, self.code]).encode())
        for path in self.experiment.reads(self.recordings):
            text.update(f"{path.name}:{path.stat().st_size if path.exists() else None}\n".encode())
        return text.hexdigest()[:16]

    def forget(self) -> None:
        """Remove its results."""
        shutil.rmtree(self.folder, ignore_errors=True)

    def do(self, log: Callable[[str], None]) -> None:
        """Run it again.

        Raises:
            InputError: the folder cannot be written.
        """
        self.forget()
        try:
            self.folder.mkdir(parents=True)
        except OSError as error:
            raise InputError(f"cannot write: {error.strerror}", where=self.folder, allowed="--out DIR") from None
        work = Workspace(self.folder, self.quick, log=log, recordings=self.recordings)
        wall, cpu, load = time.monotonic(), time.process_time(), os.getloadavg()[0]
        self.experiment.run(work)
        spent = {"took_s": time.monotonic() - wall, "cpu_s": time.process_time() - cpu}
        origin = provenance()
        made = {"commit": commit_now(), "date": origin["started"][:10], "load": round(max(load, os.getloadavg()[0]), 1)}
        work.results.write(
            self.mark, inputs=self.inputs, quick=self.quick, machine=origin["machine"], made=made, **spent
        )

    def chapter(self) -> Chapter:
        """Return its results."""
        results, tree = read_results(self.mark), read_json(self.mark)
        judged = [(Path(run).name, verdict) for run in results.scenarios for verdict in verdicts(self.folder / run)]
        return Chapter(
            self.experiment, self.folder, results, tuple(judged), origin_of(tree), tree["took_s"], tree["cpu_s"]
        )


def commit_now() -> str:
    """Return the commit of the source tree, with a plus where files differ from it; unknown outside a checkout."""
    try:
        text = subprocess.run(
            ["git", "describe", "--always", "--dirty=+", "--exclude=*"],
            cwd=Path(__file__).parent, capture_output=True, text=True, check=True, timeout=10,
        ).stdout  # fmt: skip
    except (OSError, subprocess.SubprocessError):
        return "unknown"
    return text.strip()


def origin_of(tree: Mapping[str, Any]) -> str:
    """Return in a line of what code, when, where and under which load results were made."""
    made, machine = tree.get("made", {}), tree["machine"]
    size = "Small run (`--quick`)" if tree["quick"] else "Whole run"
    load = f", load {made['load']:g} on {machine['cores']} cores" if "load" in made else ""
    cpu = f"; {tree['cpu_s']:.0f} s of CPU in {tree['took_s']:.0f} s" if tree.get("cpu_s") else ""
    by = f" of commit {made['commit']}, {made['date']}" if made else ""
    return f"{size}{by}, on {machine['processor']}{load}{cpu}."


def code_now() -> str:
    """Return a hash of the package's code, scenarios and worlds, and of this study's code."""
    text = hashlib.sha256()
    for root in (Path(ullage.__file__).parent, Path(__file__).parent):
        for path in sorted(p for kind in ("*.py", "*.yaml", "*.sdf", "*.obj") for p in root.rglob(kind)):
            text.update(f"{path.relative_to(root)}\n".encode())
            text.update(path.read_bytes())
    return text.hexdigest()
