"""Does several pieces of work at a time, each in a process of its own, and tells how far each is."""

from __future__ import annotations

import multiprocessing
import os
import signal
import threading
import time
from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import dataclass
from multiprocessing import connection
from multiprocessing.connection import Connection
from multiprocessing.process import BaseProcess
from pathlib import Path
from typing import Protocol

from ullage.errors import UllageError
from ullage.experiments.stop_signals import stop_as_ctrl_c

Tell = Callable[[int, str], None]
LOOK_S, GRACE_S = 0.3, 20.0
"""Time between looks, and that given to finish what it is at after Ctrl-C [s]."""


class Task(Protocol):
    """A piece of work that leaves a folder and knows when it is done."""

    @property
    def name(self) -> str:
        """Unlike any other's."""

    @property
    def title(self) -> str:
        """What people read."""

    @property
    def cost(self) -> float:
        """How long it takes, beside the others."""

    @property
    def folder(self) -> Path:
        """Where its results go."""

    @property
    def done(self) -> bool:
        """Whether they are there."""

    def do(self, say: Callable[[str], None]) -> None:
        """Does it anew, telling how far it is."""


@dataclass(slots=True)
class Running:
    """A task at work in a process of its own, and what it last reported."""

    task: Task
    process: BaseProcess
    reader: Connection
    text: str = ""
    failed: str = ""

    def read(self) -> str:
        """Title and progress of the task; reads what has come from its process since."""
        with suppress(EOFError, OSError):  # it has ended
            while self.reader.poll():
                failed, text = self.reader.recv()
                self.failed, self.text = (text, self.text) if failed else (self.failed, text)
        return ": ".join(filter(None, (self.task.title, self.text)))


def carry_out(tasks: Sequence[Task], *, jobs: int = 1, tell: Tell = lambda *_: None, again: bool = False) -> None:
    """Do every task that is not done, the longest first.

    Args:
        tasks: in the order of the report.
        jobs: how many at a time; 1: here, in order.
        tell: told the number done and what goes on.
        again: do those that are done once more.

    Raises:
        UllageError: one of them cannot be done.
        KeyboardInterrupt: Ctrl-C; results that were finished stay.
    """
    left = [task for task in tasks if again or not task.done]
    before = len(tasks) - len(left)
    if jobs < 2:
        for number, task in enumerate(left, before):

            def say(text: str, number: int = number, title: str = task.title) -> None:
                tell(number, f"{title}: {text}")

            task.do(say)
        tell(len(tasks), "done")
        return
    left.sort(key=lambda task: -task.cost)
    running: dict[str, Running] = {}
    try:
        while left or running:
            while left and len(running) < jobs:
                task = left.pop(0)
                running[task.name] = _start(task)
            time.sleep(LOOK_S)
            for name in [name for name, one in running.items() if not one.process.is_alive()]:
                _judge(running.pop(name))
            words = [one.read() for one in running.values()]
            tell(len(tasks) - len(left) - len(running), "; ".join(words) or "done")
    finally:
        _end([one.process for one in running.values()])


def _start(task: Task) -> Running:
    context = multiprocessing.get_context("spawn")
    reader, writer = context.Pipe(duplex=False)
    process = context.Process(target=work, args=(task, writer), daemon=True)
    process.start()
    writer.close()
    return Running(task, process, reader)


def work(task: Task, out: Connection) -> None:
    """Do a task in a process of its own: `(failed, text)` goes to the parent, and the parent's end ends it too."""
    signal.signal(signal.SIGINT, signal.default_int_handler)  # also where the parent ignores it
    threading.Thread(target=_end_with_parent, daemon=True).start()
    reported_s = 0.0

    def report_progress(text: str) -> None:
        nonlocal reported_s
        if time.monotonic() - reported_s > LOOK_S:
            reported_s = time.monotonic()
            out.send((False, text))

    with stop_as_ctrl_c():
        try:
            task.do(report_progress)
        except UllageError as error:
            out.send((True, str(error)))
            raise SystemExit(2) from None
        except KeyboardInterrupt:
            raise SystemExit(130) from None


def _end_with_parent() -> None:
    """End this process at once when its parent is gone, also by kill -9; a run then stays unfinished."""
    parent = multiprocessing.parent_process()
    if parent is not None:
        connection.wait([parent.sentinel])
        os._exit(1)


def _judge(running: Running) -> None:
    process = running.process
    process.join()
    running.read()
    if process.exitcode == 130:
        raise KeyboardInterrupt
    if process.exitcode != 0:
        what = running.failed or f"ended with code {process.exitcode}"
        raise UllageError(f"{running.task.title}: {what}")


def _end(processes: Sequence[BaseProcess]) -> None:
    """Ctrl-C for every process still at work, and after a while the end."""
    for process in processes:
        if process.pid is not None and process.is_alive():
            os.kill(process.pid, signal.SIGINT)
    until = time.monotonic() + GRACE_S
    for process in processes:
        process.join(max(until - time.monotonic(), 0.1))
        if process.is_alive():
            process.kill()
