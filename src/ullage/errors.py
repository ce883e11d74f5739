"""What can go wrong, and how it is said: one line with what, where and what is allowed."""

from __future__ import annotations

import importlib
from pathlib import Path
from types import ModuleType
from typing import Any

LONGEST = 1200
"""Characters of a message: what a file holds may be of any length."""


def one_line(text: str, *, most: int = LONGEST) -> str:
    """Text without line breaks and control characters, its middle left out where it is too long."""
    if not text.isprintable():
        text = "".join(c if c.isprintable() else " " if c.isspace() else f"\\x{ord(c):02x}" for c in text[: 4 * most])
        text = " ".join(text.split())
    return text if len(text) <= most else f"{text[: most // 2]} ... {text[-most // 3 :]}"


def shown(value: Any, *, most: int = 80) -> str:
    """A value as Python writes it, on one line and of limited length."""
    try:
        return one_line(repr(value), most=most)
    except (ValueError, RecursionError):  # an integer of thousands of digits, a list that holds itself
        return f"<{type(value).__name__}>"


class UllageError(Exception):
    """Anything ullage refuses; the command line prints it as one line and exits with `exit_code`."""

    exit_code = 2


class InputError(UllageError):
    """A value or a file that cannot be used.

    Args:
        what: what is wrong, in plain words.
        where: file, with `line` appended where known, or the name of an argument or field.
        line: line number in `where` [1 = first].
        allowed: what would be accepted.
        field: the path to the setting, group by group, for whoever can tell its line.
    """

    def __init__(
        self,
        what: str,
        *,
        where: str | Path | None = None,
        line: int | None = None,
        allowed: str = "",
        field: tuple[str | int, ...] = (),
    ) -> None:
        place = "" if where is None else f"{where}:{line}: " if line is not None else f"{where}: "
        super().__init__(one_line(f"{place}{what}" + (f" (allowed: {allowed})" if allowed else "")))
        self.what, self.where, self.line, self.allowed, self.field = what, where, line, allowed, field


class NotRecorded(InputError):
    """A file that can be read does not hold the readings that are asked of it."""


class CalibrationError(InputError):
    """A recording that does not decide where its clock and range zero are; nothing is guessed."""

    exit_code = 1


class MissingExtra(UllageError):
    """A library that an optional part needs is not installed."""


class UllageWarning(UserWarning):
    """Something was ignored or assumed; the work goes on."""


class DamageWarning(UllageWarning):
    """Messages of a recording were damaged and left out; the rest is used, and the command ends with exit code 2."""


def need(module: str, *, extra: str = "") -> ModuleType:
    """Import an optional library, or say in one line how to get it.

    Raises:
        MissingExtra: the library is not installed.
    """
    try:
        return importlib.import_module(module)
    except ImportError as error:
        package = f"'ullage[{extra}]'" if extra else module.partition(".")[0]
        raise MissingExtra(f"{module} is not installed; get it with: pip install {package}") from error
