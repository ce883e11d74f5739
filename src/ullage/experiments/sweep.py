"""Many runs of one scenario: every combination of some settings, each with several seeds, and a table of what came."""

from __future__ import annotations

import csv
import io
import itertools
import statistics
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path

from ullage.errors import InputError, UllageError
from ullage.experiments.catalog import find_scenario
from ullage.experiments.cluster import Outcome, Report, Where, carry_out
from ullage.experiments.folder import RunFolder, read_json, write_text
from ullage.experiments.runner import execute
from ullage.experiments.source_resolution import make_run
from ullage.untrusted import compose_yaml, load_yaml

Settings = tuple[tuple[str, str], ...]  # key, value as text
MOST = 10_000
"""Runs in a sweep."""


@dataclass(frozen=True, slots=True)
class Point:
    """One run of a sweep."""

    scenario: str
    settings: Settings  # those swept over
    options: tuple[str, ...]  # all that differs from the scenario
    seed: int
    folder: Path
    cost: float = 1.0

    @property
    def name(self) -> str:
        """Name of the folder."""
        return self.folder.name

    @property
    def title(self) -> str:
        """Settings that differ from the other runs."""
        return " ".join([*(f"{key}={value}" for key, value in self.settings), f"seed={self.seed}"])

    @property
    def done(self) -> bool:
        """Whether it is complete."""
        return RunFolder(self.folder).state == "complete"

    @property
    def metrics(self) -> dict[str, float | None]:
        """Metrics of the run."""
        return {name: metric["value"] for name, metric in read_json(self.folder / "metrics.json").items()}

    def do(self, log: Callable[[str], None]) -> None:
        """Run it, without pictures and without keeping the frames.

        Raises:
            KeyboardInterrupt: Ctrl-C.
        """
        job = make_run(self.scenario, options=self.options, out=self.folder.parent, force=True)
        seconds = job.flown.duration_s if job.flown is not None else 1.0
        report = execute(job, draw=False, progress=lambda s: log(f"{100 * s / seconds:.0f} %"))
        if report.outcome.interrupted:
            raise KeyboardInterrupt


@dataclass(frozen=True, slots=True)
class Sweep:
    """A sweep, as far as it got."""

    points: tuple[Point, ...]
    table: Path
    interrupted: bool
    failed: Mapping[str, UllageError] = field(default_factory=dict)  # why runs could not be made, by name

    @property
    def done(self) -> tuple[Point, ...]:
        """Existing runs."""
        return tuple(point for point in self.points if point.done)

    def summary(self, metric: str) -> dict[Settings, tuple[int, float, float]]:
        """For each combination: how many seeds gave the metric, its mean and its standard deviation.

        Raises:
            InputError: no run gave such a metric.
        """
        found: dict[Settings, list[float]] = {}
        for point in self.done:
            value = point.metrics.get(metric)
            if value is not None:
                found.setdefault(point.settings, []).append(value)
        if self.done and not found:
            known = ", ".join(sorted(self.done[0].metrics))
            raise InputError(f"no run gave {metric!r}", where="--metric", allowed=known)
        spread = {key: statistics.stdev(values) if len(values) > 1 else 0.0 for key, values in found.items()}
        return {key: (len(values), statistics.fmean(values), spread[key]) for key, values in found.items()}


def axis_of(text: str) -> tuple[str, list[str]]:
    """Key and values of `KEY=V1,V2`; a value may be a YAML list of its own.

    Raises:
        InputError: it is not of that form.
    """
    key, _, values = text.partition("=")
    allowed = "KEY=VALUE,VALUE as in map.step_m=0.1,0.2"
    try:
        load_yaml(f"[{values}]", where="--over")
    except InputError:
        raise InputError(f"cannot read {text!r}", where="--over", allowed=allowed) from None
    node = compose_yaml(f"[{values}]")
    if not key or node.id != "sequence" or not node.value:
        raise InputError(f"cannot read {text!r}", where="--over", allowed=allowed)
    return key, [f"[{values}]"[part.start_mark.index : part.end_mark.index] for part in node.value]


def plan(
    scenario: str, over: Mapping[str, Sequence[str]], *, seeds: int = 1, options: Sequence[str] = (), out: Path
) -> list[Point]:
    """Return all runs of a sweep after checks, without running them.

    Args:
        scenario: name or file.
        over: values, as text, of each setting swept over.
        seeds: runs of each combination, with seeds that follow the scenario's.
        options: `a.b=value` over the scenario, in all of them.
        out: folder of the runs.

    Raises:
        InputError: a setting is not the scenario's, a value not allowed, or there are too many.
    """
    combinations = [tuple(zip(over, values, strict=True)) for values in itertools.product(*over.values())]
    if len(combinations) * seeds > MOST:
        raise InputError(f"{len(combinations) * seeds} runs", where="sweep", allowed=f"at most {MOST}")
    first = find_scenario(scenario, options=options).seed
    points = []
    for settings in combinations:
        for seed in range(first, first + seeds):
            words = (*options, *(f"{key}={value}" for key, value in settings), f"seed={seed}")
            found = find_scenario(scenario, options=words)
            points.append(Point(scenario, settings, words, seed, out / f"{found.name}-{found.digest}"))
    return points


def sweep(
    points: Sequence[Point],
    *,
    out: Path,
    where: Where = 1,
    report_progress: Report = lambda *_: None,
    again: bool = False,
) -> Sweep:
    """Run the missing runs, several at a time, and write `sweep.csv` with a row for each run or its failure.

    Args:
        points: from `plan`.
        out: folder of the table.
        where: number of worker processes here, or address of a Dask scheduler whose workers see the same folders.
        report_progress: called with the number of finished runs and the current work.
        again: repeat existing runs; each old run stays until its new one is complete.

    Raises:
        UllageError: the cluster is gone; the table holds the runs that were finished.
    """
    outcome = Outcome({}, interrupted=False)
    try:
        outcome = carry_out(points, where=where, report_progress=report_progress, again=again)
    finally:
        table = out / "sweep.csv"
        if ended := [point for point in points if point.done or point.name in outcome.failed]:
            write_text(table, _rows(ended, outcome.failed))
    return Sweep(tuple(points), table, outcome.interrupted, outcome.failed)


def _rows(ended: Sequence[Point], failed: Mapping[str, UllageError]) -> str:
    rows = []
    for point in ended:
        row: dict[str, object] = {"run": point.name, **dict(point.settings), "seed": point.seed}
        rows.append(row | ({"failed": failed[point.name]} if point.name in failed else point.metrics))
    names = list(dict.fromkeys(name for row in rows for name in row))
    text = io.StringIO()
    writer = csv.DictWriter(text, names, lineterminator="\n")
    writer.writeheader()
    writer.writerows(rows)
    return text.getvalue()
