"""Runs the thesis' experiments one after another, each once: what is done is kept and not done again."""

from __future__ import annotations

import hashlib
import json
import shutil
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

import ullage
from ullage.errors import InputError
from ullage.experiments.folder import provenance, read_json, write_json
from ullage.experiments.judge import Verdict, verdicts
from ullage.experiments.reproduce.bench import Bench
from ullage.experiments.reproduce.findings import Findings, read_findings
from ullage.experiments.reproduce.plan import Experiment

Tell = Callable[[int, str], None]
RECORDINGS = Path("../shared/data")
"""Where the real recordings lie beside a checkout."""


@dataclass(frozen=True, slots=True)
class Chapter:
    """One experiment that is done."""

    experiment: Experiment
    folder: Path
    findings: Findings
    verdicts: tuple[tuple[str, Verdict], ...]  # scenario, bound
    took_s: float
    again: bool  # taken from an earlier call


@dataclass(frozen=True, slots=True)
class Reproduction:
    """All that was done, and whether it was cut short."""

    folder: Path
    chapters: tuple[Chapter, ...]
    interrupted: bool
    report: Path

    @property
    def broken(self) -> list[str]:
        """Statements that do not hold and scenarios out of their bounds, in words."""
        out = []
        for chapter in self.chapters:
            out += [
                f"{s.text}: {s.value:.4g} {s.unit}, wanted {s.wanted}"
                for s in chapter.findings.statements
                if not s.holds
            ]
            out += [f"{name}: {v.text}" for name, v in chapter.verdicts if not v.inside]
        return out

    @property
    def counts(self) -> tuple[int, int]:
        """Statements and bounds that hold, and all of them."""
        flags = [s.holds for c in self.chapters for s in c.findings.statements]
        flags += [v.inside for c in self.chapters for _, v in c.verdicts]
        return sum(flags), len(flags)


def reproduce(
    out: Path,
    wanted: Sequence[Experiment],
    *,
    recordings: Path = RECORDINGS,
    quick: bool = False,
    fresh: bool = False,
    tell: Tell = lambda *_: None,
) -> Reproduction:
    """Run every experiment that is not yet done, then write the report.

    Args:
        out: folder of the results; one folder for each experiment, report.html above them.
        wanted: which.
        recordings: folder of the real recordings; what needs those that are not there is left out.
        quick: small, in two minutes.
        fresh: do again what is done.
        tell: told the number of experiments done and what goes on.

    Raises:
        InputError: the folder cannot be written.
    """
    root = out / ("quick" if quick else "whole")
    chapters: list[Chapter] = []
    interrupted = False
    try:
        for number, experiment in enumerate(wanted):

            def say(text: str, number: int = number, title: str = experiment.title) -> None:
                tell(number, f"{title}: {text}")

            chapters.append(_chapter(experiment, root, recordings, quick, fresh, say))
            tell(number + 1, experiment.title)
    except KeyboardInterrupt:
        interrupted = True
    return _finished(root, chapters, interrupted, quick, len(wanted))


def _chapter(
    experiment: Experiment, root: Path, recordings: Path, quick: bool, fresh: bool, say: Callable[[str], None]
) -> Chapter:
    folder = root / experiment.name
    mark = folder / "findings.json"
    inputs = fingerprint(experiment, quick, recordings)
    again = not fresh and mark.is_file() and read_json(mark).get("inputs") == inputs
    if not again:
        shutil.rmtree(folder, ignore_errors=True)
        try:
            folder.mkdir(parents=True)
        except OSError as error:
            raise InputError(f"cannot write: {error.strerror}", where=folder, allowed="--out DIR") from None
        bench = Bench(folder, quick, say, recordings)
        started = time.monotonic()
        experiment.run(bench)
        bench.findings.write(mark, inputs=inputs, took_s=time.monotonic() - started, machine=provenance()["machine"])
    findings = read_findings(mark)
    judged = [(Path(run).name, verdict) for run in findings.scenarios for verdict in verdicts(folder / run)]
    return Chapter(experiment, folder, findings, tuple(judged), read_json(mark)["took_s"], again)


def fingerprint(experiment: Experiment, quick: bool, recordings: Path) -> str:
    """Stands for all that an experiment's result hangs on: this code, the scenarios, the recordings, quick or not."""
    text = hashlib.sha256(json.dumps([experiment.name, quick, ullage.__version__]).encode())
    here = Path(ullage.__file__).parent
    for path in sorted(p for kind in ("*.py", "*.yaml", "*.sdf", "*.obj") for p in here.rglob(kind)):
        text.update(f"{path.relative_to(here)}\n".encode())
        text.update(path.read_bytes())
    for path in experiment.reads(recordings):
        text.update(f"{path}:{path.stat().st_size if path.exists() else None}\n".encode())
    return text.hexdigest()[:16]


def _finished(root: Path, chapters: list[Chapter], interrupted: bool, quick: bool, wanted: int) -> Reproduction:
    from ullage.experiments.reproduce.page import write_page

    done = Reproduction(root, tuple(chapters), interrupted, root / "report.html")
    root.mkdir(parents=True, exist_ok=True)
    write_page(done, quick=quick, wanted=wanted)
    write_json(root / "verdict.json", {
        "holding": done.counts[0], "statements": done.counts[1], "broken": done.broken, "interrupted": interrupted,
        "experiments": {c.experiment.name: {"took_s": c.took_s} for c in chapters},
    })  # fmt: skip
    return done
