"""Run the thesis' experiments, each once: finished results are kept and not computed again."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from studies.thesis.plan import Experiment
from studies.thesis.report import write_page
from studies.thesis.task import Chapter, ExperimentTask, Reproduction, code_now
from ullage.errors import UllageError
from ullage.experiments.cluster import Report, carry_out
from ullage.experiments.folder import write_json

RECORDINGS = Path("../shared/data")
"""Where the real recordings lie beside a checkout."""


def reproduce(
    out: Path,
    wanted: Sequence[Experiment],
    *,
    recordings: Path = RECORDINGS,
    quick: bool = False,
    fresh: bool = False,
    jobs: int | None = 1,
    report_progress: Report = lambda *_: None,
) -> Reproduction:
    """Run every unfinished experiment, then write the report.

    Args:
        out: folder of the results; one folder for each experiment, report.html above them.
        wanted: which.
        recordings: folder of the real recordings; experiments without their recordings are left out.
        quick: small, three to four CPU-minutes; experiments that the plan does not mark as quick are left out.
        fresh: repeat finished experiments.
        jobs: worker processes on this machine; 1: this process; None: one for each core. More than one needs Dask.
        report_progress: called with the number of finished experiments and the current work.

    Raises:
        UllageError: an experiment failed; results of the others are kept.
    """
    root = out / ("quick" if quick else "whole")
    code = code_now()
    tasks = [ExperimentTask(experiment, root, recordings, quick, code) for experiment in wanted]
    if fresh:
        for task in tasks:
            task.forget()
    outcome = carry_out(tasks, where=jobs, report_progress=report_progress)
    for task in tasks:
        if why := outcome.failed.get(task.name):
            raise UllageError(f"{task.title}: {why}")
    return _finished(root, [task.chapter() for task in tasks if task.done], outcome.interrupted, quick, len(wanted))


def _finished(root: Path, chapters: list[Chapter], interrupted: bool, quick: bool, wanted: int) -> Reproduction:
    done = Reproduction(root, tuple(chapters), interrupted, root / "report.html")
    root.mkdir(parents=True, exist_ok=True)
    write_page(done, quick=quick, wanted=wanted)
    write_json(root / "verdict.json", {
        "holding": done.counts[0], "statements": done.counts[1], "broken": done.broken, "interrupted": interrupted,
        "experiments": {c.experiment.name: {"took_s": c.took_s, "cpu_s": c.cpu_s} for c in chapters},
    })  # fmt: skip
    return done
