"""The scenarios that come with ullage: families, their variants by law and hand, and every name of each."""

from __future__ import annotations

import difflib
import re
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any

from ullage.config import Scenario, is_set_by, read_scenario, split_source
from ullage.errors import InputError, shown
from ullage.world.sdf_resolve import SEARCH_VARIABLES, search_folders

FOLDER = Path(__file__).parent / "scenarios"
CLOSE = 0.6
"""Least likeness of a name to one that is suggested in its place, 0 to 1."""
_PARTS = re.compile(r"-physical|(?P<hand>-by-hand)|-(?P<cells>\d+cm)$")

LAWS = {"thesis": "the method of 2018", "physical": "ullage's method"}
"""Laws of the echoes, and what reports call their methods."""


@dataclass(frozen=True, slots=True, order=True)
class Variant:
    """One shipped scenario as a member of its family."""

    family: str
    law: str = "thesis"
    by_hand: bool = False
    cells: str = ""  # size of the map's cells, where the name has one

    @staticmethod
    @cache
    def of(name: str) -> Variant:
        """Return the family, law, hand and cells of a shipped scenario."""
        parts = {match.lastgroup: match[match.lastgroup or 0] for match in _PARTS.finditer(name)}
        law = find_scenario(name).sensing.fidelity
        return Variant(_PARTS.sub("", name), law, "hand" in parts, parts.get("cells", ""))

    @property
    def words(self) -> str:
        """Its family and options as one writes them after `ullage run`."""
        family = f"{self.family}-{self.cells}" if self.cells else self.family
        return " ".join([family, *(["--law physical"] * (self.law == "physical")), *(["--by-hand"] * self.by_hand)])


def scenario_names() -> list[str]:
    """Names of the shipped scenarios, one for each variant."""
    return sorted(path.stem for path in FOLDER.glob("*.yaml"))


def families() -> dict[str, list[Variant]]:
    """The variants of each family, by the family's name."""
    out: dict[str, list[Variant]] = {}
    for variant in sorted(map(Variant.of, scenario_names())):
        out.setdefault(variant.family, []).append(variant)
    return out


def variant_name(name: str, *, law: str | None = None, by_hand: bool = False) -> str:
    """Give the name of a shipped scenario's variant.

    Args:
        name: a family or any other shipped scenario; a file or a recording only without `law` and `by_hand`.
        law: of the echoes, thesis or physical; None: that of the name.
        by_hand: flown by hand.

    Raises:
        InputError: there is no such law or variant, or `name` is no shipped scenario.
    """
    if law is None and not by_hand:
        return name
    if law is not None and law not in LAWS:
        raise InputError(f"no law {law!r}", where="--law", allowed=", ".join(LAWS))
    names = {Variant.of(known): known for known in scenario_names()}
    if name not in names.values():
        option = "--law" if law is not None else "--by-hand"
        what = f"{name!r} is no shipped scenario{suggestion(name, families())}"
        raise InputError(what, where=option, allowed=f"one of {', '.join(families())}, or no {option}")
    given = Variant.of(name)
    wanted = Variant(given.family, law or given.law, by_hand or given.by_hand, given.cells)
    if wanted not in names:
        allowed = ", ".join(known.words for known in families()[given.family])
        raise InputError(f"no scenario {wanted.words!r}", allowed=allowed)
    return names[wanted]


def suggestion(name: str, known: Iterable[str]) -> str:
    """Suggest the known name nearest to a wrong one, as the end of a sentence; nothing where none is near."""
    near = difflib.get_close_matches(name, list(known), 1, CLOSE)
    return f"; did you mean {near[0]!r}?" if near else ""


def find_scenario(name_or_path: str, *, options: Sequence[str] = ()) -> Scenario:
    """Return a shipped scenario by name, or one from a YAML file.

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
    what = f"no scenario {name_or_path!r}{suggestion(name_or_path, scenario_names())}"
    raise InputError(what, allowed=f"a .yaml file or one of {', '.join(families())}; ullage list shows their options")


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


def _with_files(scenario: Scenario, file: Path, options: Sequence[str]) -> Scenario:
    """Return the scenario with the files that it names resolved and checked against its search path."""
    world = scenario.world
    folders = tuple(_found(folder, "world.search_path", file, options) for folder in world.search_path)
    antenna = scenario.sensing.changes.get("antenna")
    table = antenna.get("file") if isinstance(antenna, dict) else None
    out = scenario
    if world.file or folders:
        name, arguments = split_source(world.file)
        place = _found(name, "world.file", file, options, near=folders) if name else ""
        out = out.but(world=world.but(file=place + arguments, search_path=folders))
    if isinstance(antenna, dict) and isinstance(table, str):
        where = _found(table, "sensing.changes.antenna.file", file, options)
        changes: dict[str, Any] = {**scenario.sensing.changes, "antenna": {**antenna, "file": where}}
        out = out.but(sensing=scenario.sensing.but(changes=changes))
    return out


def _found(name: str, field: str, file: Path, options: Sequence[str], *, near: Sequence[str] = ()) -> str:
    """Return the path of a file or folder that a scenario file names; a path from an option stays unchanged.

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
