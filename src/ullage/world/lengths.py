"""Checks of the numbers that a user gives for a scene."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ullage.errors import InputError

LARGEST_M = 1e5
"""No length of a scene may exceed this [m]."""


def number(name: str, value: Any, where: str) -> float:
    """Return a finite number within the largest scene.

    Raises:
        InputError: the value is not such a number.
    """
    if isinstance(value, bool | str | bytes):
        raise InputError(f"{name} is {value!r}", where=where, allowed="a number")
    try:
        out = float(value)
    except (TypeError, ValueError):
        raise InputError(f"{name} is {value!r}", where=where, allowed="a number") from None
    if not abs(out) <= LARGEST_M:
        raise InputError(f"{name} is {out}", where=where, allowed=f"a finite number within +-{LARGEST_M:g}")
    return out


def length(name: str, value: Any, where: str) -> float:
    """Return a length above zero [m].

    Raises:
        InputError: the value is not such a number.
    """
    out = number(name, value, where)
    if not out >= 1e-6:
        raise InputError(f"{name} is {out}", where=where, allowed="above zero (at least 1e-6 m)")
    return out


def lengths(name: str, values: Any, count: int, where: str) -> NDArray[np.float64]:
    """Return `count` lengths above zero [m].

    Raises:
        InputError: the count differs, or a value is not a length.
    """
    if isinstance(values, str | bytes) or not isinstance(values, Sequence | np.ndarray) or len(values) != count:
        raise InputError(f"{name} is {values!r}", where=where, allowed=f"{count} lengths in metres")
    return np.array([length(f"{name}[{i}]", value, where) for i, value in enumerate(values)])
