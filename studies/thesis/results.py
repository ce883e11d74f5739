"""Results of an experiment of the thesis: statements with numbers and bounds, figures, tables."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

from ullage.experiments.folder import read_json, write_json


@dataclass(frozen=True, slots=True)
class Statement:
    """Statement of the thesis, or of this project, with the number that decides it."""

    text: str
    where: str  # section, figure or table of the thesis; "beyond" where it is about what came after
    value: float
    unit: str = ""
    low: float | None = None
    high: float | None = None

    @property
    def holds(self) -> bool:
        """Whether the number is known and within its bounds."""
        if not math.isfinite(self.value):
            return False
        return (self.low is None or self.value >= self.low) and (self.high is None or self.value <= self.high)

    @property
    def wanted(self) -> str:
        """Bounds in words."""
        limits = [
            f">= {self.low:g}" if self.low is not None else "",
            f"<= {self.high:g}" if self.high is not None else "",
        ]
        return " and ".join(limit for limit in limits if limit) or "known"


@dataclass(frozen=True, slots=True)
class ShownFigure:
    """Figure: its file in the experiment's folder, the thesis' figure that it reproduces, and its caption."""

    file: str
    figure: str  # as "figure 6.3"; "" where the thesis has none
    caption: str


@dataclass(frozen=True, slots=True)
class Table:
    """Rows of text under a header."""

    title: str
    head: tuple[str, ...]
    rows: tuple[tuple[str, ...], ...]
    note: str = ""


@dataclass(frozen=True, slots=True)
class Difference:
    """Result of the thesis that differs here, with its cause or "unknown"."""

    where: str  # section, figure or table of the thesis
    thesis: str
    here: str
    cause: str


@dataclass(slots=True)
class Results:
    """All results of one experiment."""

    statements: list[Statement] = field(default_factory=list)
    figures: list[ShownFigure] = field(default_factory=list)
    tables: list[Table] = field(default_factory=list)
    numbers: dict[str, float] = field(default_factory=dict)  # for the experiments that follow
    scenarios: list[str] = field(default_factory=list)  # folders of the runs, under the experiment's own
    notes: list[str] = field(default_factory=list)  # sentences for the report
    differences: list[Difference] = field(default_factory=list)
    not_compared: list[str] = field(default_factory=list)  # results of the thesis without a counterpart here, and why
    skipped: str = ""  # why there are no results

    def add_statement(
        self,
        text: str,
        where: str,
        value: float,
        unit: str = "",
        *,
        low: float | None = None,
        high: float | None = None,
    ) -> None:
        """Add a statement."""
        self.statements.append(Statement(text, where, float(value), unit, low, high))

    def add_difference(self, where: str, thesis: str, here: str, cause: str) -> None:
        """Add a result that differs from the thesis'."""
        self.differences.append(Difference(where, thesis, here, cause))

    def add_figure(self, path: Path, figure: str, caption: str) -> None:
        """Add a figure of the experiment's folder."""
        self.figures.append(ShownFigure(path.name, figure, caption))

    def add_table(self, title: str, head: Sequence[str], rows: Sequence[Sequence[str]], *, note: str = "") -> None:
        """Add a table."""
        self.tables.append(Table(title, tuple(head), tuple(tuple(row) for row in rows), note))

    def write(self, path: Path, **also: Any) -> None:
        """Write JSON atomically; numbers that are not finite become null."""
        write_json(path, _plain({**asdict(self), **also}))


def read_results(path: Path) -> Results:
    """Read the results of an experiment.

    Raises:
        InputError: the file is missing or broken.
    """
    tree = read_json(path)
    return Results(
        [
            Statement(**{**row, "value": math.nan if row["value"] is None else row["value"]})
            for row in tree["statements"]
        ],
        [ShownFigure(**row) for row in tree["figures"]],
        [
            Table(row["title"], tuple(row["head"]), tuple(map(tuple, row["rows"])), row["note"])
            for row in tree["tables"]
        ],
        {name: math.nan if value is None else value for name, value in tree["numbers"].items()},
        tree["scenarios"],
        tree["notes"],
        [Difference(**row) for row in tree.get("differences", [])],
        tree.get("not_compared", []),
        tree["skipped"],
    )


def _plain(tree: Any) -> Any:
    if isinstance(tree, Mapping):
        return {key: _plain(value) for key, value in tree.items()}
    if isinstance(tree, list | tuple):
        return [_plain(value) for value in tree]
    return None if isinstance(tree, float) and not math.isfinite(tree) else tree
