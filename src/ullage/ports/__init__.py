"""Recordings, map files, instruments and live ports: frames come in, and results go out.

`registry` chooses a reader or writer by the name of its file; `live` does so by the scheme of an address. Each live
port is a package with its entry points in `port`. The names here are loaded when first used.
"""

from __future__ import annotations

import importlib
from typing import Any

_HOMES = {
    "RailSource": "ports.tracked",
    "Sink": "flow",
    "Source": "ports.protocol",
    "open": "ports.registry",
    "read_map": "ports.registry",
    "sink": "ports.registry",
    "write_map": "ports.registry",
}

__all__ = sorted(_HOMES)


def __getattr__(name: str) -> Any:
    if name not in _HOMES:
        raise AttributeError(f"module 'ullage.ports' has no attribute {name!r}")
    return getattr(importlib.import_module(f"ullage.{_HOMES[name]}"), name)


def __dir__() -> list[str]:
    return __all__
