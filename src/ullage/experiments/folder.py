"""Run folders: one for each set of settings, with everything the run gave."""

from __future__ import annotations

import json
import os
import platform
import shutil
import sys
from collections.abc import Mapping
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

from ullage.data import Metric
from ullage.errors import InputError

RUNS = Path("runs")


def make_folder(name: str, digest: str, *, root: Path | None = None, force: bool = False) -> Path:
    """A fresh folder `NAME-DIGEST` under `root`, with `latest` pointing at it.

    Raises:
        InputError: the folder exists and `force` is not set, or the place cannot be written.
    """
    place = (RUNS if root is None else root) / f"{name}-{digest}"
    try:
        if place.exists():
            if not force:
                raise InputError(
                    "this run exists", where=place, allowed="--force to run it again, or another name or setting"
                )
            shutil.rmtree(place)
        (place / "figures").mkdir(parents=True)
        draft = place.parent / f".latest-{os.getpid()}"
        draft.symlink_to(place.name)
        draft.replace(place.parent / "latest")
    except OSError as error:
        raise InputError(
            f"cannot write: {error.strerror}", where=place, allowed="a folder that can be written, --out DIR"
        ) from None
    return place


def find_folder(text: str | Path) -> Path:
    """A run folder by path, by name under runs/, or "latest".

    Raises:
        InputError: there is none.
    """
    for place in (Path(text), RUNS / str(text)):
        if (place / "scenario.yaml").is_file() or (place / "provenance.json").is_file():
            return place.resolve() if place.is_symlink() else place
    known = sorted(p.parent.name for p in RUNS.glob("*/provenance.json")) if RUNS.is_dir() else []
    raise InputError(
        f"no run {str(text)!r}", allowed="a run folder" + (f", one of {', '.join(known[-8:])}" if known else "")
    )


def write_text(path: Path, text: str) -> None:
    """Write a file whole or not at all.

    Raises:
        InputError: the disk is full or the place cannot be written.
    """
    draft = path.with_name(f".{path.name}")
    try:
        draft.write_text(text, encoding="utf-8")
        draft.replace(path)
    except OSError as error:
        raise InputError(f"cannot write: {error.strerror}", where=path) from None


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
    except (OSError, ValueError) as error:
        raise InputError(f"cannot read: {error}", where=path) from None


def provenance() -> dict[str, Any]:
    """What made the run: versions, machine, command, time."""
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
