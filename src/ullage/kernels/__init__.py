"""Numba loops over plain arrays: arrays in, arrays out, none of our types, no checks."""

from __future__ import annotations

import sys
from collections.abc import Iterator
from contextlib import contextmanager
from functools import cache
from importlib import import_module
from pathlib import Path


def compiled(stem: str) -> bool:
    """Whether a module of kernels has a compiled copy newer than its source, wherever Numba keeps them."""
    module = import_module(f"{__name__}.{stem}")
    source = Path(str(module.__file__))
    mine = (v for v in vars(module).values() if getattr(v, "__module__", "") == module.__name__)
    kept = next((v.stats.cache_path for v in mine if hasattr(v, "stats")), None)
    if kept is None:  # Numba is turned off
        return True
    copies = (p.stat().st_mtime for p in Path(kept).glob(f"{stem}.*.nbi"))
    return max(copies, default=0.0) > source.stat().st_mtime


@contextmanager
def telling() -> Iterator[None]:
    """While it lasts, the first kernel that must be compiled is told of on the error stream, once in a process."""
    from numba.core import event

    class Telling(event.Listener):  # type: ignore[misc]
        def on_start(self, event: object) -> None:
            data = getattr(event, "data", {})
            if str(getattr(data.get("dispatcher"), "__module__", "")).startswith(__name__):
                _tell()

        def on_end(self, event: object) -> None:
            pass

    with event.install_listener("numba:compile", Telling()):
        yield


@cache
def _tell() -> None:
    print("ullage: compiling kernels (once after installation)", file=sys.stderr, flush=True)
