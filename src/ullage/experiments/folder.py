"""One object for a run folder: where it lies, its state, who writes it, and how it takes its place.

A run is written to `runs/.NAME-HASH8.draft` and swapped in when it is complete. Until then its process locks
`runs/.NAME-HASH8.lock`. A kill leaves the draft, with `"state": "running"` in its provenance.json; no process holds
its lock then. `verdicts` compares its metrics with the bounds that its scenario sets.
"""

from __future__ import annotations

import fcntl
import json
import os
import platform
import shutil
import socket
import sys
import time
from collections.abc import Mapping
from contextlib import AbstractContextManager, suppress
from dataclasses import dataclass, field
from datetime import UTC, datetime
from importlib.metadata import version
from pathlib import Path
from typing import Any, Literal, Self

from ullage.config import Bound, read_scenario
from ullage.data import Metric
from ullage.errors import InputError
from ullage.files import write_whole, writing
from ullage.ports.registry import check_folder
from ullage.untrusted import reason

RUNS = Path("runs")
PATIENCE_S = 0.5  # processes that a killed run had started end within it, and with them its lock [s]
State = Literal["complete", "interrupted", "running", "unfinished"]


@dataclass(slots=True)
class RunFolder:
    """Folder of a run; a plain folder that `begin` never saw is written in place.

    Attributes:
        path: where the run is now: its final place, or its draft beside that.
        origin: versions, machine, command and time of the run that this process writes.
    """

    path: Path
    origin: dict[str, Any] = field(default_factory=dict)
    _lock: int = -1  # file descriptor while this process writes a draft

    @classmethod
    def of(cls, name: str, digest: str, *, root: Path | None = None) -> Self:
        """Return the final place of the run `NAME-DIGEST`."""
        return cls((RUNS if root is None else root) / f"{name}-{digest}")

    @classmethod
    def find(cls, text: str | Path) -> Self:
        """Find a run by path, by name under runs/, or "latest"; an unfinished run by its final name too.

        Raises:
            InputError: there is no such run.
        """
        places = (Path(text), RUNS / str(text))
        for place in (*places, *(cls(p)._beside("draft") for p in places if p.name)):
            if (place / "scenario.yaml").is_file() or (place / "provenance.json").is_file():
                return cls(place.resolve() if place.is_symlink() else place)
        known = sorted({run.final.name for run in cls.all_in(RUNS)})
        raise InputError(
            f"no run {str(text)!r}", allowed="a run folder" + (f", one of {', '.join(known[-8:])}" if known else "")
        )

    @classmethod
    def all_in(cls, root: Path) -> list[Self]:
        """Every run under `root`, the unfinished ones by their drafts, in order of their names."""
        found = (mark.parent for mark in [*root.glob("*/provenance.json"), *root.glob(".*.draft/provenance.json")])
        return sorted(
            {p: cls(p) for p in found if not p.is_symlink()}.values(), key=lambda r: (r.final.name, r.path.name)
        )

    @property
    def final(self) -> Path:
        """Its final place."""
        name = self.path.name
        return self.path.with_name(name[1:-6]) if name.startswith(".") and name.endswith(".draft") else self.path

    @property
    def state(self) -> State:
        """State of the run, from its provenance.json and from the lock of a process that writes it."""
        about = self._about()
        state = about.get("state")
        if state == "running":
            return "running" if self._locked() else "unfinished"
        if state in ("complete", "interrupted"):
            return "complete" if state == "complete" else "interrupted"
        if state or "refused" in about or not (self.path / "metrics.json").is_file():
            return "unfinished"
        return "interrupted" if about.get("interrupted") else "complete"  # from a version without states

    @property
    def finished(self) -> bool:
        """Whether the run has all its files; an interrupted one holds what came by then."""
        return self.state in ("complete", "interrupted")

    def describe(self) -> str:
        """Describe its state in a few words, with the reason or the process if known."""
        state, about = self.state, self._about()
        if state == "running":
            return f"running, process {about.get('pid')} on {about.get('host')}"
        return f"unfinished: {about['refused']}" if state == "unfinished" and "refused" in about else state

    def check_free(self, *, force: bool = False) -> None:
        """Check that a run may be written here; an unfinished run may be replaced.

        Raises:
            InputError: a finished run is there and `force` is not set, or the folder cannot be written.
        """
        there = type(self)(self.final)
        if not force and there.path.exists() and there.finished:
            allowed = "--force to run it again, or another name or setting"
            raise InputError("this run exists", where=self.final, allowed=allowed)
        check_folder(self.final)

    def begin(self, *, force: bool = False) -> Self:
        """Lock the run and make its draft folder; nothing that is complete is touched.

        Raises:
            InputError: the run exists and `force` is not set, another process writes it, or it cannot be written.
        """
        self.check_free(force=force)
        with self._writing():
            self.final.parent.mkdir(parents=True, exist_ok=True)
            self._lock = self._take_lock()
        try:
            with self._writing():
                self._settle()
                self.check_free(force=force)
                draft = self._beside("draft")
                if draft.exists():
                    shutil.rmtree(draft)
                (draft / "figures").mkdir(parents=True)
            self.path = draft
            self.mark_running()
        except BaseException:
            self.release()
            raise
        return self

    def mark_running(self) -> None:
        """Write the mark of a run that this process writes, and where it comes from."""
        self.origin = provenance()
        self.mark(state="running", pid=os.getpid(), host=socket.gethostname())

    def mark(self, **about: Any) -> None:
        """Write provenance.json: where the run comes from, and what is said of it."""
        write_json(self.path / "provenance.json", {**self.origin, **about})

    def finish(self, *, interrupted: bool = False) -> Path:
        """Put the run in its final place, point `latest` at it and let go.

        Args:
            interrupted: the run holds only what came by then. It does not replace a complete run.

        Returns:
            Where the run is now.

        Raises:
            InputError: the place cannot be written; the run stays in its draft folder.
        """
        if self._lock < 0:
            return self.path
        try:
            if not (interrupted and type(self)(self.final).state == "complete"):
                with self._writing():
                    self.path = self._swap_in()
            return self.path
        finally:
            self.release()

    def discard(self) -> None:
        """Remove the folder, in which nothing is worth keeping, and let go."""
        shutil.rmtree(self.path, ignore_errors=True)
        self.release()

    def release(self) -> None:
        """Let go of the folder; its contents stay."""
        if self._lock >= 0:
            with suppress(OSError):
                self._beside("lock").unlink(missing_ok=True)
            fcntl.flock(self._lock, fcntl.LOCK_UN)  # also for processes that were forked meanwhile
            os.close(self._lock)
            self._lock = -1

    def _beside(self, kind: str) -> Path:
        """Return the draft, the lock or the old folder beside the final place."""
        return self.final.with_name(f".{self.final.name}.{kind}")

    def _about(self) -> dict[str, Any]:
        with suppress(InputError):
            about = read_json(self.path / "provenance.json")
            return about if isinstance(about, dict) else {}
        return {}

    def _locked(self) -> bool:
        try:
            with self._beside("lock").open("rb") as file:
                fcntl.flock(file, fcntl.LOCK_SH | fcntl.LOCK_NB)
        except BlockingIOError:
            return True
        except OSError:
            return False
        return False

    def _take_lock(self) -> int:
        """Lock the folder for this process.

        Raises:
            InputError: a living process holds it.
        """
        path, until = self._beside("lock"), time.monotonic() + PATIENCE_S
        while True:
            lock = os.open(path, os.O_RDWR | os.O_CREAT, 0o666)
            try:
                fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
                if os.fstat(lock).st_nlink:
                    os.truncate(lock, 0)
                    os.write(lock, f"{os.getpid()}\n".encode())
                    return lock
                os.close(lock)  # its former owner has removed the file since
            except BlockingIOError:
                holder = os.read(lock, 32).decode(errors="replace").strip() or "unknown"
                os.close(lock)
                if time.monotonic() > until:
                    raise InputError(
                        f"process {holder} is writing this run", where=self.final, allowed="wait for it, or --out DIR"
                    ) from None
                time.sleep(0.05)

    def _swap_in(self) -> Path:
        """Rename the draft to its final place, remove the previous folder, and point `latest` at the run."""
        old, final = self._beside("old"), self.final
        if final.exists():
            if old.exists():
                shutil.rmtree(old)
            final.rename(old)
        self.path.rename(final)
        shutil.rmtree(old, ignore_errors=True)
        link = final.parent / f".latest-{os.getpid()}"
        link.unlink(missing_ok=True)
        link.symlink_to(final.name)
        link.replace(final.parent / "latest")
        return final

    def _settle(self) -> None:
        """Finish a swap that a kill cut short: the run is then under its draft's or its old name."""
        draft, old = self._beside("draft"), self._beside("old")
        if not self.final.exists() and old.exists():
            (draft if type(self)(draft).finished else old).rename(self.final)
        shutil.rmtree(old, ignore_errors=True)

    def _writing(self) -> AbstractContextManager[None]:
        return writing(self.final, allowed="a folder that can be written, --out DIR")


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


@dataclass(frozen=True, slots=True)
class Verdict:
    """Metric with its bound."""

    name: str
    value: float | None
    bound: Bound

    @property
    def inside(self) -> bool:
        """Whether the metric is known and within its bound."""
        return self.bound.holds(self.value)

    @property
    def text(self) -> str:
        """Metric, value and bound in one line."""
        ends = ((">=", self.bound.min), ("<=", self.bound.max))
        limits = " and ".join(f"{sign} {end:g}" for sign, end in ends if end is not None)
        value = "unknown" if self.value is None else f"{self.value:.4g}"
        return f"{self.name} {value}, wanted {limits or 'known'}"


def verdicts(folder: Path) -> list[Verdict]:
    """Compare every bound of the run's scenario with its metric.

    Raises:
        InputError: the run lacks its scenario or metrics.
    """
    expect = read_scenario(folder / "scenario.yaml").expect
    metrics = read_json(folder / "metrics.json")
    return [Verdict(name, (metrics.get(name) or {}).get("value"), bound) for name, bound in expect.items()]
