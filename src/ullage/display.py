"""What data show of themselves in a notebook; `ullage.view`, a higher layer, draws it when it is asked for."""

from __future__ import annotations

import importlib
from typing import Any


def plots() -> Any:
    """The module that draws data, loaded when the first picture is asked for."""
    return importlib.import_module("ullage.view.plots")


class Displayed:
    """Something that notebooks show as a picture above its short text."""

    __slots__ = ()

    def _repr_html_(self) -> str:
        return str(plots().html(self))
