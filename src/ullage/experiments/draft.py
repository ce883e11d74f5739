"""Drafts of run folders: a run is written next to its final place and swapped in when it is complete.

`runs/.NAME-HASH8.draft` holds the run until then, and `runs/.NAME-HASH8.lock` is locked while its process lives. A kill
leaves the draft, with `"state": "running"` in its provenance.json; no process holds its lock then.
"""

from __future__ import annotations

import fcntl
import os
import shutil
import socket
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path

from ullage.errors import InputError
from ullage.experiments.folder import (
    FINISHED,
    RUNS,
    draft_of,
    lock_of,
    provenance,
    state_of,
    write_json,
)
from ullage.ports.registry import check_folder

PATIENCE_S = 0.5  # processes that a killed run had started end within it, and with them its lock [s]


@dataclass(slots=True)
class Draft:
    """A run folder in the making, held by this process."""

    final: Path
    lock: int  # file descriptor

    @property
    def path(self) -> Path:
        """Folder to write to."""
        return draft_of(self.final)

    def finish(self, *, interrupted: bool = False) -> Path:
        """Put the run in its final place, point `latest` at it and let go.

        Args:
            interrupted: the run holds only what came by then. It does not replace a complete run.

        Returns:
            Where the run is now.

        Raises:
            InputError: the place cannot be written; the run stays in its draft folder.
        """
        try:
            if interrupted and state_of(self.final) == "complete":
                return self.path
            with _writing(self.final):
                _swap_in(self.final)
                point_latest(self.final)
            return self.final
        finally:
            self.release()

    def discard(self) -> None:
        """Remove the draft and let go."""
        shutil.rmtree(self.path, ignore_errors=True)
        self.release()

    def release(self) -> None:
        """Release the folder; the contents of the draft stay."""
        if self.lock >= 0:
            with suppress(OSError):
                lock_of(self.final).unlink(missing_ok=True)
            fcntl.flock(self.lock, fcntl.LOCK_UN)  # also for processes that were forked meanwhile
            os.close(self.lock)
            self.lock = -1


def begin_run(name: str, digest: str, *, root: Path | None = None, force: bool = False) -> Draft:
    """Make a draft folder for the run `NAME-DIGEST` under `root`; nothing that is complete is touched.

    Raises:
        InputError: the run exists and `force` is not set, another process writes it, or the place cannot be written.
    """
    final = place_of(name, digest, root=root)
    check_free(final, force=force)
    with _writing(final):
        final.parent.mkdir(parents=True, exist_ok=True)
        draft = Draft(final, _lock(final))
    try:
        with _writing(final):
            _settle(final)
            check_free(final, force=force)
            if draft.path.exists():
                shutil.rmtree(draft.path)
            (draft.path / "figures").mkdir(parents=True)
        write_json(draft.path / "provenance.json", provenance() | running())
    except BaseException:
        draft.release()
        raise
    return draft


def place_of(name: str, digest: str, *, root: Path | None = None) -> Path:
    """Return the final place of the run `NAME-DIGEST`."""
    return (RUNS if root is None else root) / f"{name}-{digest}"


def check_free(final: Path, *, force: bool = False) -> None:
    """Check that a run may be written there; an unfinished run may be replaced.

    Raises:
        InputError: a finished run is there and `force` is not set, or the folder cannot be written.
    """
    if not force and final.exists() and state_of(final) in FINISHED:
        raise InputError("this run exists", where=final, allowed="--force to run it again, or another name or setting")
    check_folder(final)


def running() -> dict[str, object]:
    """Return the mark of a run that this process writes."""
    return {"state": "running", "pid": os.getpid(), "host": socket.gethostname()}


def point_latest(final: Path) -> None:
    """Point `latest` at a run, in one step."""
    link = final.parent / f".latest-{os.getpid()}"
    link.unlink(missing_ok=True)
    link.symlink_to(final.name)
    link.replace(final.parent / "latest")


def _lock(final: Path) -> int:
    """Lock a run's folder for this process.

    Raises:
        InputError: a living process holds it.
    """
    path, until = lock_of(final), time.monotonic() + PATIENCE_S
    while True:
        lock = os.open(path, os.O_RDWR | os.O_CREAT, 0o666)
        try:
            fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
            if _is_file(lock, path):
                os.truncate(lock, 0)
                os.write(lock, f"{os.getpid()}\n".encode())
                return lock
            os.close(lock)  # its former owner has removed the file since
        except BlockingIOError:
            holder = os.read(lock, 32).decode(errors="replace").strip() or "unknown"
            os.close(lock)
            if time.monotonic() > until:
                raise InputError(
                    f"process {holder} is writing this run", where=final, allowed="wait for it, or --out DIR"
                ) from None
            time.sleep(0.05)


def _is_file(lock: int, path: Path) -> bool:
    try:
        return os.path.samestat(os.fstat(lock), path.stat())
    except FileNotFoundError:
        return False


def _old_of(final: Path) -> Path:
    return final.with_name(f".{final.name}.old")


def _swap_in(final: Path) -> None:
    """Rename draft to final, and remove the previous folder."""
    old = _old_of(final)
    if final.exists():
        if old.exists():
            shutil.rmtree(old)
        final.rename(old)
    draft_of(final).rename(final)
    shutil.rmtree(old, ignore_errors=True)


def _settle(final: Path) -> None:
    """Finish a swap that a kill cut short: the run is then under its draft's or its old name."""
    draft, old = draft_of(final), _old_of(final)
    if not final.exists() and old.exists():
        (draft if state_of(draft) in FINISHED else old).rename(final)
    shutil.rmtree(old, ignore_errors=True)


@contextmanager
def _writing(final: Path) -> Iterator[None]:
    try:
        yield
    except OSError as error:
        raise InputError(
            f"cannot write: {error.strerror}", where=final, allowed="a folder that can be written, --out DIR"
        ) from None
