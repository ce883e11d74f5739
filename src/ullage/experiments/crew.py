"""Does several pieces of work at a time, each in a process of its own, and tells how far each is."""

from __future__ import annotations

import multiprocessing
import os
import signal
import time
from collections.abc import Callable, Sequence
from multiprocessing.process import BaseProcess
from pathlib import Path
from typing import Protocol

from ullage.errors import UllageError
from ullage.experiments.folder import write_text

Tell = Callable[[int, str], None]
STATUS, FAILED = "status.txt", "failed.txt"
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


def carry_out(tasks: Sequence[Task], *, jobs: int = 1, tell: Tell = lambda *_: None) -> None:
    """Do every task that is not done, the longest first.

    Args:
        tasks: in the order of the report.
        jobs: how many at a time; 1: here, in order.
        tell: told the number done and what goes on.

    Raises:
        UllageError: one of them cannot be done.
        KeyboardInterrupt: Ctrl-C; results that were finished stay.
    """
    left = [task for task in tasks if not task.done]
    before = len(tasks) - len(left)
    if jobs < 2:
        for number, task in enumerate(left, before):

            def say(text: str, number: int = number, title: str = task.title) -> None:
                tell(number, f"{title}: {text}")

            task.do(say)
        tell(len(tasks), "done")
        return
    left.sort(key=lambda task: -task.cost)
    running: dict[str, tuple[Task, BaseProcess]] = {}
    try:
        while left or running:
            while left and len(running) < jobs:
                task = left.pop(0)
                running[task.name] = task, _start(task)
            time.sleep(LOOK_S)
            for name in [name for name, (_, process) in running.items() if not process.is_alive()]:
                _judge(*running.pop(name))
            words = [": ".join(filter(None, (task.title, _read(task.folder / STATUS)))) for task, _ in running.values()]
            tell(len(tasks) - len(left) - len(running), "; ".join(words) or "done")
    finally:
        _end([process for _, process in running.values()])


def _start(task: Task) -> BaseProcess:
    process = multiprocessing.get_context("spawn").Process(target=work, args=(task,), daemon=True)
    process.start()
    return process


def work(task: Task) -> None:
    """What each process does: the task, its state in a file."""
    told = 0.0
    signal.signal(signal.SIGINT, signal.default_int_handler)  # also where the parent ignores it

    def say(text: str) -> None:
        nonlocal told
        if time.monotonic() - told > LOOK_S:
            told = time.monotonic()
            write_text(task.folder / STATUS, text)

    try:
        task.do(say)
    except UllageError as error:
        task.folder.mkdir(parents=True, exist_ok=True)
        write_text(task.folder / FAILED, str(error))
        raise SystemExit(2) from None
    except KeyboardInterrupt:
        raise SystemExit(130) from None


def _judge(task: Task, process: BaseProcess) -> None:
    process.join()
    if process.exitcode == 130:
        raise KeyboardInterrupt
    if process.exitcode != 0:
        what = _read(task.folder / FAILED) or f"ended with code {process.exitcode}"
        raise UllageError(f"{task.title}: {what}")


def _read(path: Path) -> str:
    try:
        return path.read_text(encoding="utf-8")
    except OSError:
        return ""


def _end(processes: Sequence[BaseProcess]) -> None:
    """Ctrl-C for every process still at work, and after a while the end."""
    for process in processes:
        if process.pid is not None and process.is_alive():
            os.kill(process.pid, signal.SIGINT)
    until = time.monotonic() + GRACE_S
    for process in processes:
        process.join(max(until - time.monotonic(), 0.1))
        if process.is_alive():
            process.terminate()
