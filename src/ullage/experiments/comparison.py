"""Repeat a flight with the echoes and the map of another law, for a fair comparison."""

from __future__ import annotations

import tempfile
from collections.abc import Sequence
from pathlib import Path

from ullage.config import Scenario
from ullage.errors import InputError
from ullage.experiments.catalog import families, find_scenario, scenario_names, variant_name
from ullage.experiments.folder import RunFolder
from ullage.experiments.run import Compared, of_scenario
from ullage.experiments.runner import execute
from ullage.experiments.simulated import prepare

NAMES = {"thesis": "the method of 2018", "physical": "ullage's method"}


def rival_scenario(source: str, law: str, *, options: Sequence[str] = ()) -> Scenario:
    """Find the scenario of the same family with another law, reduced to its map.

    Args:
        source: name of a shipped scenario.
        law: of the other scenario, thesis or physical.
        options: `a.b=value` over both scenarios.

    Raises:
        InputError: there is no such law or variant, or the flights differ.
    """
    if source not in scenario_names():
        raise InputError(f"{source!r} is no shipped scenario", where="--compare", allowed=", ".join(families()))
    scenario = find_scenario(source, options=options)
    rival = find_scenario(variant_name(source, law=law), options=options).but(do=("map",), expect={})
    for part in ("world", "flight", "seed"):
        if getattr(scenario, part) != getattr(rival, part):
            raise InputError(f"{rival.name} has another {part}", where="--compare", allowed="the same flight")
    return rival


def fly_again(rival: Scenario, law: str) -> Compared:
    """Run a scenario for its scores alone; nothing is kept on the disk."""
    with tempfile.TemporaryDirectory(prefix="ullage-") as folder:
        report = execute(of_scenario(RunFolder(Path(folder)), prepare(rival)), log=lambda _: None, draw=False)
    return Compared(NAMES[law], rival.name, report.metrics)
