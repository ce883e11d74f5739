"""Recordings, map files, instruments and live ports: frames come in, and results go out.

`registry` chooses a reader or writer by the name of its file; `live` does so by the scheme of an address. Each live
port is a package with its entry points in `port`. The names here are loaded when first used.
"""

from __future__ import annotations

import importlib
from typing import Any

_HOMES = {
    "RailSource": "tracked",
    "Sink": "protocol",
    "Source": "protocol",
    "open": "registry",
    "read_map": "registry",
    "sink": "registry",
    "write_map": "registry",
}

__all__ = sorted(_HOMES)


def __getattr__(name: str) -> Any:
    if name not in _HOMES:
        raise AttributeError(f"module 'ullage.ports' has no attribute {name!r}")
    return getattr(importlib.import_module(f"ullage.ports.{_HOMES[name]}"), name)


def __dir__() -> list[str]:
    return __all__
