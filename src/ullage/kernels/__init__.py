"""Numba loops over plain arrays: arrays in, arrays out, none of our types, no checks."""

from __future__ import annotations

import logging
from collections.abc import Iterator
from contextlib import contextmanager
from functools import cache
from importlib import import_module
from typing import Any


def compiled(stem: str) -> bool:
    """Whether a module of kernels has a copy compiled from its source as it is, wherever Numba keeps them."""
    module = import_module(f"{__name__}.{stem}")
    mine = [v for v in vars(module).values() if getattr(v, "__module__", "") == module.__name__]
    loops = [
        v.compiled() if hasattr(v, "compiled") else v for v in mine if hasattr(v, "compiled") or hasattr(v, "stats")
    ]
    return not loops or any(_kept(kernel) for kernel in loops)  # none: Numba is turned off


def _kept(kernel: Any) -> bool:
    """Whether Numba would take a copy of a kernel from disk: it knows the source by what is in it, not by its date."""
    return bool(kernel._cache._cache_file._load_index())


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
    logging.getLogger("ullage").warning("compiling kernels (once after installation)")
