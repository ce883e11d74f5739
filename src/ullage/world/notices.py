"""Warnings about a world file: the first of each kind in full, the rest as one count."""

from __future__ import annotations

import warnings
from collections.abc import Iterator
from contextlib import contextmanager
from contextvars import ContextVar
from dataclasses import dataclass

from ullage.errors import UllageWarning


@dataclass(slots=True)
class _Notice:
    first: str
    count: int = 1


_open: ContextVar[dict[str, _Notice] | None] = ContextVar("_open", default=None)


@contextmanager
def one_notice_per_kind() -> Iterator[None]:
    """Collect the warnings of `notify` and emit one line for each kind at the end, also after an error."""
    if _open.get() is not None:  # the outer collection goes on
        yield
        return
    found: dict[str, _Notice] = {}
    token = _open.set(found)
    try:
        yield
    finally:
        _open.reset(token)
        for notice in found.values():
            more = f" ({notice.count - 1} more like this)" if notice.count > 1 else ""
            warnings.warn(notice.first + more, UllageWarning, stacklevel=4)


def notify(what: str, *, kind: str = "") -> None:
    """Warn about something that was ignored or assumed.

    Args:
        what: the full line, with its place.
        kind: kind of the line; only the first line of a kind is shown. Empty: the line is its own kind.
    """
    found = _open.get()
    if found is None:
        warnings.warn(what, UllageWarning, stacklevel=3)
    elif (key := kind or what) in found:
        found[key].count += 1
    else:
        found[key] = _Notice(what)
