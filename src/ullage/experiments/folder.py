"""Run folders: one for each set of settings, with everything the run gave."""

from __future__ import annotations

import fcntl
import json
import os
import platform
import sys
from collections.abc import Mapping
from contextlib import suppress
from datetime import UTC, datetime
from pathlib import Path
from typing import Any, Literal

from ullage.data import Metric
from ullage.errors import InputError
from ullage.files import write_whole
from ullage.untrusted import reason

RUNS = Path("runs")
State = Literal["complete", "interrupted", "running", "unfinished"]
FINISHED = ("complete", "interrupted")
"""States of a run that has all its files; an interrupted one holds what came by then."""


def draft_of(final: Path) -> Path:
    """Return the folder of a run until it is complete."""
    return final.with_name(f".{final.name}.draft")


def final_of(folder: Path) -> Path:
    """Return the final place of a run, from that or from its draft."""
    name = folder.name
    return folder.with_name(name[1:-6]) if name.startswith(".") and name.endswith(".draft") else folder


def lock_of(final: Path) -> Path:
    """Return the file that a process locks while it writes a run."""
    return final.with_name(f".{final.name}.lock")


def state_of(folder: Path) -> State:
    """Return the state of a run, from its provenance.json and from the lock of a process that writes it."""
    try:
        about = read_json(folder / "provenance.json")
    except InputError:
        about = {}
    about = about if isinstance(about, dict) else {}
    state = about.get("state")
    if state in FINISHED:
        return "complete" if state == "complete" else "interrupted"
    if state == "running":
        return "running" if _locked(final_of(folder)) else "unfinished"
    if state or "refused" in about or not (folder / "metrics.json").is_file():
        return "unfinished"
    return "interrupted" if about.get("interrupted") else "complete"  # from a version without states


def describe(folder: Path) -> str:
    """Describe the state of a run in a few words, with the reason or the process if known."""
    state = state_of(folder)
    if state in FINISHED:
        return state
    with suppress(InputError, AttributeError):
        about = read_json(folder / "provenance.json")
        if state == "running":
            return f"running, process {about.get('pid')} on {about.get('host')}"
        return f"unfinished: {about['refused']}" if "refused" in about else state
    return state


def _locked(final: Path) -> bool:
    try:
        with lock_of(final).open("rb") as file:
            fcntl.flock(file, fcntl.LOCK_SH | fcntl.LOCK_NB)
    except BlockingIOError:
        return True
    except OSError:
        return False
    return False


def runs_in(root: Path) -> list[Path]:
    """Every run folder under `root`, the unfinished ones by their drafts, in order of their names."""
    found = (mark.parent for mark in [*root.glob("*/provenance.json"), *root.glob(".*.draft/provenance.json")])
    return sorted({p for p in found if not p.is_symlink()}, key=lambda p: (final_of(p).name, p.name))


def find_folder(text: str | Path) -> Path:
    """A run folder by path, by name under runs/, or "latest"; an unfinished run is found by its final name too.

    Raises:
        InputError: there is no such run.
    """
    places = (Path(text), RUNS / str(text))
    for place in (*places, *(draft_of(p) for p in places if p.name)):
        if (place / "scenario.yaml").is_file() or (place / "provenance.json").is_file():
            return place.resolve() if place.is_symlink() else place
    known = sorted({final_of(folder).name for folder in runs_in(RUNS)})
    raise InputError(
        f"no run {str(text)!r}", allowed="a run folder" + (f", one of {', '.join(known[-8:])}" if known else "")
    )


def write_text(path: Path, text: str) -> None:
    """Write a file whole or not at all.

    Raises:
        InputError: the disk is full or the place cannot be written.
    """
    write_whole(path, lambda out: out.write(text.encode()))


def write_json(path: Path, tree: Any) -> None:
    """Write plain values as JSON, whole or not at all."""
    write_text(path, json.dumps(tree, indent=2, allow_nan=False, default=str) + "\n")


def read_json(path: Path) -> Any:
    """Plain values from a JSON file.

    Raises:
        InputError: it is missing or broken.
    """
    try:
        return json.loads(path.read_text(encoding="utf-8"))
    except (OSError, ValueError, RecursionError) as error:
        raise InputError(f"cannot read: {reason(error)}", where=path) from None


def provenance() -> dict[str, Any]:
    """Return the origin of a run: versions, machine, command, time."""
    from importlib.metadata import version

    import ullage

    libraries = ("numpy", "scipy", "numba", "embreex", "mujoco", "rosbags", "mcap")
    return {
        "ullage": ullage.__version__,
        "python": sys.version.split()[0],
        "libraries": {name: version(name) for name in libraries},
        "machine": {"system": platform.platform(), "processor": _processor(), "cores": os.cpu_count()},
        "command": [Path(sys.argv[0]).name, *sys.argv[1:]],
        "started": datetime.now(UTC).isoformat(timespec="seconds"),
    }


def _processor() -> str:
    try:
        for line in Path("/proc/cpuinfo").read_text().splitlines():
            if line.startswith("model name"):
                return line.split(":", 1)[1].strip()
    except OSError:
        pass
    return platform.processor() or platform.machine()


def metric_tree(metrics: Mapping[str, Metric]) -> dict[str, Any]:
    """Metrics as plain values, null where a number is not finite."""
    return {
        name: {"value": m.value if abs(m.value) < float("inf") else None, "unit": m.unit}
        for name, m in sorted(metrics.items())
    }
