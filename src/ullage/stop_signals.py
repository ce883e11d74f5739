"""Ctrl-C, SIGTERM and SIGHUP ask the work to end; loops read the flag between frames, so foreign code is never cut."""

from __future__ import annotations

import signal
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from types import FrameType
from typing import Any, Self

STOP = (signal.SIGTERM, signal.SIGHUP)
_raised: threading.Event | None = None
"""Set once a signal raised an exception within `stop_as_ctrl_c`; each block has its own, and None is outside all."""


def _raise(number: int, frame: FrameType | None) -> None:
    if _raised is not None:
        _raised.set()
    raise KeyboardInterrupt


class StopFlag:
    """Counts Ctrl-C, and SIGTERM and SIGHUP within `stop_as_ctrl_c`, in place of an exception; the last one raises.

    A `KeyboardInterrupt` raised inside numpy may come out as another error. A loop that holds this flag reads
    `requested` between two frames instead. It stays unset outside the main thread, and a signal that is ignored stays
    ignored.

    Args:
        raises_at: the signal that raises KeyboardInterrupt at once, since nobody reads the flag.
    """

    __slots__ = ("_before", "_raises_at", "count")

    def __init__(self, raises_at: int = 2) -> None:
        self.count, self._raises_at = 0, raises_at

    @property
    def requested(self) -> bool:
        """Whether a signal has come."""
        return self.count > 0

    def __enter__(self) -> Self:
        self._before: dict[int, Any] = {}
        if threading.current_thread() is threading.main_thread():
            known = {number: signal.getsignal(number) for number in (signal.SIGINT, *STOP)}
            # SIG_IGN: a shell starts background work so; SIG_DFL: nobody asked that this signal ends the work in order
            self._before = {n: signal.signal(n, self._request) for n, handler in known.items() if callable(handler)}
        return self

    def __exit__(self, *error: object) -> None:
        for number, handler in self._before.items():
            signal.signal(number, handler)

    def _request(self, number: int, frame: FrameType | None) -> None:
        self.count += 1
        if self.count >= self._raises_at:
            _raise(number, frame)


def raise_if_stopped() -> None:
    """Raise the KeyboardInterrupt of a signal within `stop_as_ctrl_c` again, where foreign code lost it.

    Python drops an exception that a signal raises while objects are deleted or C code calls back.

    Raises:
        KeyboardInterrupt: a signal raised one before.
    """
    if _raised is not None and _raised.is_set():
        raise KeyboardInterrupt


@contextmanager
def stop_as_ctrl_c() -> Iterator[None]:
    """Treat SIGTERM and SIGHUP as Ctrl-C within the block; a signal that the caller ignores (nohup) stays ignored.

    Raises:
        KeyboardInterrupt: Ctrl-C, also where foreign code that it cut made an error of its own of it.
    """
    global _raised  # noqa: PLW0603 - a signal handler has no other way to it
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    heeded = [number for number in STOP if signal.getsignal(number) is not signal.SIG_IGN]
    before = {number: signal.signal(number, _as_ctrl_c) for number in heeded}
    if signal.getsignal(signal.SIGINT) is signal.default_int_handler:
        before[signal.SIGINT] = signal.signal(signal.SIGINT, _raise)
    outer, _raised = _raised, (raised := threading.Event())
    try:
        yield
    except Exception as error:
        if raised.is_set():
            raise KeyboardInterrupt from error
        raise
    finally:
        _raised = outer
        for number, handler in before.items():
            signal.signal(number, handler if handler is not None else signal.SIG_DFL)


def _as_ctrl_c(number: int, frame: FrameType | None) -> None:
    """Call the current handler of Ctrl-C, so that code that defers it (a loop over frames) defers this too."""
    handler = signal.getsignal(signal.SIGINT)
    if callable(handler):
        handler(number, frame)
    else:  # a shell starts background work with Ctrl-C ignored
        _raise(number, frame)
