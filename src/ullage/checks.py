"""Check the values that a caller hands over, before anything is computed with them."""

from __future__ import annotations

import warnings
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ullage.arrays import Floats, Longs
from ullage.errors import InputError, UllageWarning, shown

_RIGID = 1e-6
"""Largest deviation from a rotation, of any product of two axes."""
LONGEST_STEP_S = 1e5
"""Usual time between two frames or poses; a longer one is of a clock in nanoseconds [s]."""


def number(name: str, value: Any, where: str, *, above: float = -np.inf, allowed: str = "a finite number") -> float:
    """Return one finite number above a bound.

    Args:
        name: of the argument.
        value: what was given for it.
        where: the function that takes it.
        above: the bound, not allowed itself.
        allowed: how the message names what is allowed.

    Raises:
        InputError: the value is text, a truth value, several values, not finite, or not above the bound.
    """
    out = np.nan
    if isinstance(value, int | float | np.number | np.ndarray) and not isinstance(value, bool) and np.ndim(value) == 0:
        out = float(value) if np.isrealobj(value) else np.nan
    if not (np.isfinite(out) and out > above):
        raise InputError(f"{name} is {shown(_plain(value))}", where=where, allowed=allowed)
    return out


def whole(name: str, value: Any, where: str, *, low: int, high: int = 2**63 - 1, allowed: str = "") -> int:
    """Return one whole number within bounds.

    Raises:
        InputError: the value is no integer, or out of bounds.
    """
    if not isinstance(value, int | np.integer) or isinstance(value, bool) or not low <= value <= high:
        every = allowed or f"a whole number {low} to {high}"
        raise InputError(f"{name} is {shown(_plain(value))}", where=where, allowed=every)
    return int(value)


def array(name: str, value: Any, dtype: Any = np.float64) -> NDArray[Any]:
    """Return numbers as a contiguous array of one type; the same array where it is one already.

    Raises:
        InputError: the value holds text, rows of unequal length or masked numbers, complex ones where real ones are
            wanted, or fractions where integers are wanted.
    """
    if type(value) is np.ndarray and value.dtype == dtype:
        return np.asarray(value, order="C")
    given = as_given(name, value)
    if given.dtype.kind == "c" and np.dtype(dtype).kind != "c":
        raise InputError(f"{name} is complex", where=name, allowed="real numbers")
    try:
        if given.dtype.kind in "biufcO":
            out = np.asarray(given, dtype, order="C")
            if out.dtype.kind != "i" or np.array_equal(out, given):
                return out
    except (TypeError, ValueError, OverflowError):
        pass
    raise InputError(f"{name} is {shown(value)}", where=name, allowed="an array of numbers")


def is_in_nanoseconds(seconds: Floats, where: str | Path) -> bool:
    """Return whether times given as seconds (n) count nanoseconds, with a warning; infinite and NaN are left out."""
    steps = np.abs(np.diff(seconds[np.isfinite(seconds)]))
    if not steps.size or np.median(steps) <= LONGEST_STEP_S:
        return False
    warnings.warn(f"{where}: times are taken as nanoseconds, not seconds", UllageWarning, stacklevel=5)
    return True


def times_ns(name: str, value: Any) -> Longs:
    """Return times as whole nanoseconds; dates and durations of numpy are converted from their own unit.

    Raises:
        InputError: the value holds no times, or times beyond 292 years.
    """
    if type(value) is np.ndarray and value.dtype == np.int64:
        return np.asarray(value, order="C")
    given = as_given(name, value)
    if given.dtype.kind in "mM" and not np.isnat(given).any():
        return np.asarray(given.astype(f"{given.dtype.kind}8[ns]").astype(np.int64), order="C")
    if given.dtype.kind not in "biu":
        given = np.rint(array(name, given))
    if not ((given >= -(2.0**63)) & (given < 2.0**63)).all():  # also NaN
        raise InputError(f"{name} has a time that is not finite, or beyond 292 years", where=name,
                         allowed="whole nanoseconds")  # fmt: skip
    return np.asarray(given, np.int64, order="C")


def instance(name: str, value: Any, kind: type, where: str) -> None:
    """Refuse a value of another type.

    Raises:
        InputError: it is one.
    """
    if not isinstance(value, kind):
        raise InputError(f"{name} is a {type(value).__name__}", where=where, allowed=f"a {kind.__name__}")


def rigid(name: str, value: Any, where: str) -> Floats:
    """Return a rigid transform (4, 4).

    Raises:
        InputError: the shape differs, or the axes are not of unit length, at right angles and right-handed.
    """
    out = array(name, value)
    allowed = "a (4, 4) transform: three right-handed axes of unit length, and a place [m]"
    if out.shape != (4, 4) or not np.isfinite(out).all():
        raise InputError(f"{name} has shape {out.shape}, or is not finite", where=where, allowed=allowed)
    axes = out[:3, :3]
    if np.abs(axes.T @ axes - np.eye(3)).max() > _RIGID or np.abs(out[3] - (0, 0, 0, 1)).max() > _RIGID:
        raise InputError(f"{name} is not rigid", where=where, allowed=allowed)
    if np.linalg.det(axes) < 0:
        raise InputError(f"{name} is left-handed", where=where, allowed=allowed)
    return out


def as_given(name: str, value: Any) -> NDArray[Any]:
    """What numpy makes of a value.

    Raises:
        InputError: rows of unequal length, or masked numbers.
    """
    if np.ma.is_masked(value):
        raise InputError(f"{name} has masked values", where=name, allowed="a number in each place")
    try:
        return np.asarray(value)
    except (TypeError, ValueError, OverflowError):
        raise InputError(f"{name} is {shown(value)}", where=name, allowed="an array of numbers") from None


def _plain(value: Any) -> Any:
    """A scalar of numpy as Python's own, which a message shows without its type."""
    return value.item() if isinstance(value, np.generic) else value
