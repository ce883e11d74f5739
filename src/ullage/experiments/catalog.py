"""The scenarios that come with ullage, by name."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from ullage.config import Scenario, read_scenario
from ullage.errors import InputError

FOLDER = Path(__file__).parent / "scenarios"


def scenario_names() -> list[str]:
    """Names of the shipped scenarios."""
    return sorted(path.stem for path in FOLDER.glob("*.yaml"))


def find_scenario(name_or_path: str, *, options: Sequence[str] = ()) -> Scenario:
    """A shipped scenario by name, or one from a YAML file.

    Raises:
        InputError: no such scenario, or the file cannot be used.
    """
    shipped = FOLDER / f"{name_or_path}.yaml"
    if "/" not in name_or_path and shipped.is_file():
        return read_scenario(shipped, options=options)
    if Path(name_or_path).suffix in {".yaml", ".yml"}:
        return read_scenario(name_or_path, options=options)
    raise InputError(f"no scenario {name_or_path!r}", allowed="a .yaml file or one of " + ", ".join(scenario_names()))
