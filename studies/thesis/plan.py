"""List the experiments of the thesis, in its order."""

from __future__ import annotations

import importlib
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from ullage.errors import InputError

if TYPE_CHECKING:
    from studies.thesis.workspace import Workspace


@dataclass(frozen=True, slots=True)
class Experiment:
    """Experiment of the thesis; its module in this folder has a `run(work)`."""

    name: str
    title: str
    section: str  # of the thesis
    quick: bool = True  # also done in small
    weight: float = 1.0  # relative duration
    small: float = 1.0  # and in small

    def run(self, work: Workspace) -> None:
        """Run the experiment; its results and figures go to the workspace."""
        importlib.import_module(f"studies.thesis.{self.name}").run(work)

    def reads(self, recordings: Path) -> list[Path]:
        """Return the recordings that it reads, whether they exist or not."""
        module = importlib.import_module(f"studies.thesis.{self.name}")
        return [recordings / name for name in getattr(module, "READS", ())]


EXPERIMENTS: tuple[Experiment, ...] = (
    Experiment("baseline", "The thesis' method, term by term", "4.2 to 5.3", weight=0.5, small=0.5),
    Experiment("detection", "Radar object detection", "6.1", weight=5, small=3),
    Experiment("room", "Mapping the NTNU room", "6.2", weight=4, small=4),
    Experiment("hall", "Mapping the cluttered room", "6.2", weight=8, small=1),
    Experiment("hold", "The cargo hold", "6.3", weight=9, small=2),
    Experiment("causes", "Causes of the differences", "7.1 to 7.3", weight=4, small=2),
    Experiment("tables", "Speed, CPU and memory", "tables 6.1 to 6.4", weight=4, small=1.5),
    Experiment("budget", "The mapping node on board", "table 5.1", weight=4, small=3),
    Experiment("speeds", "Doppler, speed and frame rate", "7.1", weight=12, small=1.5),
    Experiment("methods", "Every way of mapping, five flights", "beyond", weight=16, small=1.5),
    Experiment("volumes", "Maps in three dimensions, five flights", "beyond", quick=False, weight=25),
    Experiment("images", "Every way of imaging, five flights", "beyond", weight=2, small=0.5),
    Experiment("rail", "A real rail beside a simulated one", "real", quick=False, weight=9),
    Experiment("rest", "A real X4 at rest beside a simulated one", "real"),
)
"""In the order in which they are done and reported."""


def wanted(quick: bool, only: Sequence[str]) -> list[Experiment]:
    """Return the requested experiments in order.

    Raises:
        InputError: there is no experiment of such a name.
    """
    known = [experiment.name for experiment in EXPERIMENTS]
    if unknown := set(only) - set(known):
        raise InputError(f"no experiment {min(unknown)!r}", where="--only", allowed=", ".join(known))
    return [e for e in EXPERIMENTS if (e.name in only if only else e.quick or not quick)]
