"""Ctrl-C, SIGTERM and SIGHUP ask the work to end; loops read the flag between frames, so foreign code is never cut."""

from __future__ import annotations

import signal
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from types import FrameType
from typing import Any, Self

STOP = (signal.SIGTERM, signal.SIGHUP)


class StopFlag:
    """Flag that the first Ctrl-C within its block sets; a second one raises KeyboardInterrupt at once.

    A `KeyboardInterrupt` raised inside numpy may come out as another error. A loop that holds this flag reads
    `requested` between two frames instead. It stays unset outside the main thread and where Ctrl-C is ignored.
    """

    __slots__ = ("_before", "requested")

    def __init__(self) -> None:
        self.requested = False

    def __enter__(self) -> Self:
        self._before: Any = None
        if threading.current_thread() is threading.main_thread():
            before = signal.getsignal(signal.SIGINT)
            if callable(before):  # not SIG_IGN: a shell starts background work with Ctrl-C ignored
                self._before = signal.signal(signal.SIGINT, self._request)
        return self

    def __exit__(self, *error: object) -> None:
        if self._before is not None:
            signal.signal(signal.SIGINT, self._before)

    def _request(self, number: int, frame: FrameType | None) -> None:
        if self.requested:
            raise KeyboardInterrupt
        self.requested = True


@contextmanager
def stop_as_ctrl_c() -> Iterator[None]:
    """Treat SIGTERM and SIGHUP as Ctrl-C within the block; a signal that the caller ignores (nohup) stays ignored."""
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    heeded = [number for number in STOP if signal.getsignal(number) is not signal.SIG_IGN]
    before = {number: signal.signal(number, _as_ctrl_c) for number in heeded}
    try:
        yield
    finally:
        for number, handler in before.items():
            signal.signal(number, handler if handler is not None else signal.SIG_DFL)


def _as_ctrl_c(number: int, frame: FrameType | None) -> None:
    """Call the current handler of Ctrl-C, so that code that defers it (a loop over frames) defers this too."""
    handler = signal.getsignal(signal.SIGINT)
    if callable(handler):
        handler(number, frame)
    else:  # a shell starts background work with Ctrl-C ignored
        raise KeyboardInterrupt
