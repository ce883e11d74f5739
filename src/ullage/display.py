"""Pictures of data in notebooks; `ullage.view`, a higher layer, draws them on request."""

from __future__ import annotations

import importlib
from typing import Any


def plots() -> Any:
    """Import the module that draws data, at the first picture."""
    return importlib.import_module("ullage.view.plots")


class Displayed:
    """Mixin for data that notebooks show as a picture above its text."""

    __slots__ = ()

    def _repr_html_(self) -> str:
        return str(plots().html(self))
