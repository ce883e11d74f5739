"""Several cores at one task: threads first, and copies of this process where Python's one lock would hold them up.

A copy made by `fork` has the prepared scene and the compiled kernels at once. joblib's processes start anew and load
both; those of `concurrent.futures` can be forked, but the pool breaks when one of them is killed. Here its work goes
on in a thread.
"""

from __future__ import annotations

import contextlib
import gc
import multiprocessing
import os
import queue
import signal
import sys
import threading
from collections.abc import Callable
from concurrent.futures import Future, ThreadPoolExecutor
from multiprocessing.connection import Connection
from typing import Any, Generic, TypeVar

T = TypeVar("T")
PAYS_S = 2.0
"""Work of so many CPU seconds is worth a copy of this process for each core."""


def cores() -> int:
    """How many this process may use; OMP_NUM_THREADS bounds it, as Dask sets it in its workers."""
    usable = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
    bound = os.environ.get("OMP_NUM_THREADS", "")
    return min(usable, int(bound)) if bound.isdecimal() and int(bound) else usable


class WorkerPool(Generic[T]):
    """Computes in as many threads as there are cores; once `fork` is called, in copies of this process.

    A thread that has a copy only waits for it. A copy that is ended from outside is done without.

    Args:
        compute: does one piece; what it gives goes through a pipe.
        workers: how many pieces are computed at once; None: as many as there are cores.
    """

    def __init__(self, compute: Callable[..., T], *, workers: int | None = None) -> None:
        self._compute, self._workers = compute, workers or cores()
        self._pool = ThreadPoolExecutor(max_workers=self._workers)
        self._idle: queue.SimpleQueue[_Copy] = queue.SimpleQueue()
        self._copies: list[_Copy] = []

    @property
    def pids(self) -> list[int]:
        """Numbers of the processes that are copies of this one."""
        return [copy.pid for copy in self._copies]

    def submit(self, *words: Any) -> Future[T]:
        """Start one piece."""
        return self._pool.submit(self._do, *words)

    def fork(self) -> None:
        """Make the copies. Nothing may be under way: what another thread locks stays locked in a copy for ever."""
        if self._workers < 2 or sys.platform != "linux" or multiprocessing.current_process().daemon:
            return
        self._copies = [_Copy(self._compute) for _ in range(self._workers)]
        for copy in self._copies:
            self._idle.put(copy)

    def close(self) -> None:
        """End, without what has not been started."""
        self._pool.shutdown(wait=True, cancel_futures=True)
        for copy in self._copies:
            copy.close()

    def _do(self, *words: Any) -> T:
        try:
            copy = self._idle.get_nowait()
        except queue.Empty:
            return self._compute(*words)
        try:
            found: T = copy.ask(*words)
        except (EOFError, OSError):
            return self._compute(*words)
        self._idle.put(copy)
        return found


class _Copy:
    """A forked process that knows what this one knew when it was made."""

    def __init__(self, compute: Callable[..., Any]) -> None:
        context = multiprocessing.get_context("fork")
        self._line, far = context.Pipe()
        self._process = context.Process(target=_serve, args=(far, compute, os.getpid()), daemon=True)
        self._process.start()
        self.pid = self._process.pid or 0
        far.close()

    def ask(self, *words: Any) -> Any:
        self._line.send(words)
        good, found = self._line.recv()
        if not good:
            raise found
        return found

    def close(self) -> None:
        with contextlib.suppress(OSError):  # it may have gone already
            self._line.send(None)
        self._process.join(5)
        if self._process.is_alive():
            self._process.kill()
            self._process.join()
        self._line.close()


def _serve(line: Connection, compute: Callable[..., Any], parent: int) -> None:
    """In the copy: one piece after the other, until told to end."""
    _die_with(parent)
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C is for the process that was started
    signal.signal(signal.SIGTERM, signal.SIG_DFL)
    gc.freeze()  # what is the parent's is not to be taken apart here
    threading.current_thread().name = "ullage-copy"
    while (words := line.recv()) is not None:
        try:
            answer = True, compute(*words)
        except Exception as error:
            answer = False, error
        line.send(answer)


def _die_with(parent: int) -> None:
    """Where the parent is killed, nobody else would end this process."""
    import ctypes

    ctypes.CDLL(None).prctl(1, signal.SIGKILL)  # PR_SET_PDEATHSIG
    if os.getppid() != parent:  # it was killed before
        os.kill(os.getpid(), signal.SIGKILL)
