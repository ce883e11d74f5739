"""How loops are compiled: by Numba's `njit`, with copies on disk that belong to all kernel sources together.

Numba alone compares only the file that a kernel stands in, and would go on using old code of the functions that this
kernel calls from other files.
"""

from __future__ import annotations

import hashlib
import os
import shutil
import sys
import threading
from collections.abc import Callable, Iterable
from functools import cache, partial
from pathlib import Path
from typing import Any

import numba


@cache
def cache_folder() -> Path | None:
    """Return the folder for compiled copies of these kernel sources, or None where no folder can be written.

    Its name is a digest of every kernel source, of the versions of Python and Numba, and of bounds checking. A change
    to any of these gives another folder. The folders used last stay; older ones are deleted.
    """
    here = Path(__file__).parent
    digest = hashlib.sha256(f"{sys.version} {numba.__version__} {numba.config.BOUNDSCHECK}".encode())
    for source in sorted(here.glob("*.py")):
        digest.update(source.name.encode() + b"\0" + source.read_bytes() + b"\0")
    user = Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache") / "ullage"
    places = [Path(numba.config.CACHE_DIR)] if numba.config.CACHE_DIR else [here / "__pycache__", user]
    for place in places:
        folder = place / f"kernels-{digest.hexdigest()[:16]}"
        try:
            folder.mkdir(parents=True, exist_ok=True)
            os.utime(folder)  # the folders used last are kept
        except OSError:
            continue
        if os.access(folder, os.W_OK):
            _delete_old(place)
            return folder
    return None


_KEPT = 4  # folders of compiled copies: going back and forth between a few versions compiles nothing again


def _delete_old(place: Path) -> None:
    """Delete all but the folders of compiled copies used last."""
    dated = []
    for folder in place.glob("kernels-*"):
        try:
            dated.append((folder.stat().st_mtime, folder))
        except OSError:  # another process deleted it
            continue
    for _, folder in sorted(dated, reverse=True)[_KEPT:]:
        shutil.rmtree(folder, ignore_errors=True)


def compiled(parts: Iterable[str]) -> bool:
    """Whether the kernels of each part are in the cache folder, as `mark_compiled` says; without Numba always."""
    folder = cache_folder()
    return bool(numba.config.DISABLE_JIT) or all(folder and (folder / f"{part}.compiled").exists() for part in parts)


def mark_compiled(part: str) -> None:
    """Record that all kernels of a part are in the cache folder."""
    if folder := cache_folder():
        (folder / f"{part}.compiled").touch()


_SETTING = threading.Lock()  # one thread at a time changes Numba's setting


def loop(**settings: Any) -> Callable[[Callable[..., Any]], Any]:
    """Compile a kernel that Python calls, and that lets other threads run; settings are options of `numba.njit`."""

    def compile_loop(function: Callable[..., Any]) -> Any:
        with _SETTING:
            before = numba.config.CACHE_DIR
            numba.config.CACHE_DIR = str(cache_folder() or before)
            try:
                return numba.njit(**{"cache": True, "nogil": True, "no_cfunc_wrapper": True, **settings})(function)
            finally:
                numba.config.CACHE_DIR = before

    return compile_loop


inner = partial(loop, no_cpython_wrapper=True)
"""Compiles a loop that only other loops call; Python must not."""
lean = partial(loop, _nrt=False)
"""As `loop`, for one that makes and returns no arrays: it counts no references to those it is handed.

Numba takes and drops one for about every array at every call of another loop, which took a third of the radar's time.
"""
core = partial(inner, _nrt=False)
"""As `inner`, for one that makes and returns no arrays."""
