"""What built-in functions give for types of arguments, worked out once and not for every call of every kernel.

To type `a[i] * b` Numba tries each implementation that anybody registered for getitem and mul, one after the other, and
keeps nothing: 13700 times for the radar's kernels, of which 880 differ. It took a quarter of the time to compile them.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

from numba.core.targetconfig import ConfigStack
from numba.core.types.functions import BaseFunction

ASKED = BaseFunction.get_call_type
WRAPPERS = {"no_cpython_wrapper", "no_cfunc_wrapper", "release_gil"}
"""Flags that change nothing inside a kernel."""


@contextmanager
def remembered() -> Iterator[None]:
    """While it lasts, Numba remembers what it found for a function, types of arguments and compiler flags."""
    if BaseFunction.get_call_type is not ASKED:  # another thread sees to it
        yield
        return
    found: dict[Any, Any] = {}
    flags = _Flags()

    def get_call_type(function: Any, context: Any, args: Any, kws: Any) -> Any:
        key = (function.key, context, tuple(args), tuple(kws.items()), flags.name())
        if key not in found:  # what cannot be typed raises, and is asked again
            signature = ASKED(function, context, args, kws)
            if signature is None:
                return None
            found[key] = signature, function.get_impl_key(signature)
        signature, function._impl_keys[signature.args] = found[key]
        return signature

    _answer_by(get_call_type)
    try:
        yield
    finally:
        _answer_by(ASKED)


def _answer_by(get_call_type: Any) -> None:
    owner: Any = BaseFunction
    owner.get_call_type = get_call_type


class _Flags:
    """A name for the compiler's flags: those of one kernel are one object, and slow to compare."""

    def __init__(self) -> None:
        self._of: Any = None
        self._name = ""

    def name(self) -> str:
        now = ConfigStack.top_or_none()
        if now is not self._of or not self._name:
            told = {} if now is None else now.values()
            self._of, self._name = now, repr(sorted((k, v) for k, v in told.items() if k not in WRAPPERS))
        return self._name
