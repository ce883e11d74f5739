"""Pictures of data in notebooks, drawn by a module of a higher layer that the package registers."""

from __future__ import annotations

import importlib
from typing import Any

_drawers: list[str] = []


def register_drawer(module: str) -> None:
    """Name the module that draws data. It is imported at the first picture."""
    _drawers[:] = [module]


def plots() -> Any:
    """Import the module that draws data."""
    return importlib.import_module(*_drawers)


class Displayed:
    """Mixin for data that notebooks show as a picture above its text."""

    __slots__ = ()

    def _repr_html_(self) -> str:
        return str(plots().html(self))
