"""The scenarios that come with ullage, by name."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

from ullage.config import Scenario, is_set_by, read_scenario
from ullage.errors import InputError, shown
from ullage.world.sdf_resolve import SEARCH_VARIABLES, search_folders

FOLDER = Path(__file__).parent / "scenarios"


def scenario_names() -> list[str]:
    """Names of the shipped scenarios."""
    return sorted(path.stem for path in FOLDER.glob("*.yaml"))


def find_scenario(name_or_path: str, *, options: Sequence[str] = ()) -> Scenario:
    """A shipped scenario by name, or one from a YAML file.

    Files and folders that a YAML file names lie beside it, in the current folder, or in a folder of the environment's
    search path. Options may name any.

    Raises:
        InputError: no such scenario, the file cannot be used, or it names a file out of reach.
    """
    shipped = FOLDER / f"{name_or_path}.yaml"
    if "/" not in name_or_path and shipped.is_file():
        return read_scenario(shipped, options=options)
    if Path(name_or_path).suffix in {".yaml", ".yml"}:
        scenario = read_scenario(name_or_path, options=options)
        return _with_files(scenario, Path(name_or_path), options)
    raise InputError(f"no scenario {name_or_path!r}", allowed="a .yaml file or one of " + ", ".join(scenario_names()))


def _with_files(scenario: Scenario, file: Path, options: Sequence[str]) -> Scenario:
    """The scenario with the files that it names found, each within reach."""
    world = scenario.world
    folders = tuple(_found(folder, "world.search_path", file, options) for folder in world.search_path)
    antenna = scenario.sensing.changes.get("antenna")
    table = antenna.get("file") if isinstance(antenna, dict) else None
    out = scenario
    if world.file or folders:
        place = _found(world.file, "world.file", file, options, near=folders) if world.file else ""
        out = out.but(world=world.but(file=place, search_path=folders))
    if isinstance(antenna, dict) and isinstance(table, str):
        where = _found(table, "sensing.changes.antenna.file", file, options)
        changes: dict[str, Any] = {**scenario.sensing.changes, "antenna": {**antenna, "file": where}}
        out = out.but(sensing=scenario.sensing.but(changes=changes))
    return out


def _found(name: str, field: str, file: Path, options: Sequence[str], *, near: Sequence[str] = ()) -> str:
    """The path of a file or folder that a scenario file names; what an option names is taken as it is.

    Raises:
        InputError: it lies out of reach.
    """
    if is_set_by(options, field):
        return name
    home = file.absolute().parent
    roots = [root.resolve() for root in (home, Path.cwd(), *search_folders(near))]
    try:
        path = home / name if not Path(name).exists() or (home / name).exists() else Path(name)
        inside = any(path.resolve().is_relative_to(root) for root in roots)
    except (OSError, ValueError):  # a name that is too long, or has a zero byte
        raise InputError(f"{field} is {shown(name)}", where=file, allowed="the name of a file") from None
    if not inside:
        allowed = f"a file beside the scenario, in the current folder or in ${SEARCH_VARIABLES[0]}; or -o {field}=PATH"
        raise InputError(f"{field} {shown(name)} reaches out of the search path", where=file, allowed=allowed)
    return name if path.resolve() == Path(name).resolve() else str(Path(file).parent / name)
