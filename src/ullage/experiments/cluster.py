"""Run many independent tasks: in this process, or on a Dask cluster of this machine or of many."""

from __future__ import annotations

import itertools
import logging
import os
import signal
import threading
import time
import uuid
from collections.abc import Callable, Generator, Iterator, Sequence
from contextlib import chdir, closing, contextmanager, suppress
from dataclasses import dataclass
from functools import partial
from queue import SimpleQueue
from typing import Any, Protocol

import ullage
from ullage.errors import InputError, UllageError, need, one_line
from ullage.radar.worker_pool import cores

Where = int | str | None
"""Worker processes here (1: this process, without Dask; None: one for each core), or a scheduler's address."""
Log = Callable[[str], None]
Work = Callable[[Any, Log], Any]
Done = tuple[Any, Any, UllageError | None]

CONNECT_S = 5
RESTART_S = 60  # longest wait for lost workers to come back, at the end
AHEAD = 1  # tasks submitted for each worker: one that waited behind a task that kills its worker would be blamed too
GONE = "the scheduler is gone; what was finished is kept, and the same command goes on"
EVENT_S = 0.5  # least time between two reports of one worker


def each_done(
    work: Work, tasks: Sequence[Any], *, where: Where = None, log: Log = lambda _: None
) -> Generator[Done, None, None]:
    """Yield (task, result, error) as the tasks end; a task whose worker is lost is given to another worker.

    Args:
        work: called with a task and a function that takes lines of progress; its exception is the task's error.
        tasks: the work, in the order in which it is started.
        where: number of local worker processes, or address of a Dask scheduler.
        log: called with the dashboard's address and with what the workers report.

    Raises:
        InputError: there is no scheduler, it has no workers, or they cannot be used.
        MissingExtra: Dask is needed and not installed.
        UllageError: the scheduler is gone.
    """
    if where == 1 or not tasks:
        yield from _in_order(work, tasks, log)
        return
    with _connected(where) as client:
        log(f"dashboard at {client.dashboard_link}" if client.dashboard_link else "running on Dask")
        yield from _on_cluster(client, work, tasks, log)


def _in_order(work: Work, tasks: Sequence[Any], log: Log) -> Generator[Done, None, None]:
    """Do the tasks in this process, one after another."""
    for task in tasks:
        try:
            result = work(task, log)
        except Exception as error:
            yield task, None, reason_of(error)
        else:
            yield task, result, None


def reason_of(error: Exception) -> UllageError:
    """Convert a task's error to one of ullage's errors."""
    if isinstance(error, UllageError):
        return error
    if type(error).__name__ == "KilledWorker":  # Dask gives a task up after four
        return UllageError("four workers ended during this task; too little memory?")
    return UllageError(one_line(f"{type(error).__name__}: {error}"))


@contextmanager
def _connected(where: int | str | None) -> Iterator[Any]:
    """Connect to a Dask cluster; a local one is started here and stopped at the end."""
    distributed: Any = need("distributed", extra="scale")
    logging.getLogger("distributed").setLevel(logging.CRITICAL)  # losses are handled here, and are no news to users
    if not isinstance(where, str):
        count = where or cores()
        with _own_environment():
            local = distributed.LocalCluster(
                n_workers=count,
                threads_per_worker=1,
                dashboard_address="127.0.0.1:0",
                memory_limit=0,  # one task's memory is bounded; to write it to disk would only slow it
                preload=[__name__],
                silence_logs=logging.CRITICAL,
            )
            with local, distributed.Client(local) as client:
                client.wait_for_workers(count)
                yield client
                with suppress(TimeoutError):  # Dask cannot close a worker that it is just starting again
                    client.wait_for_workers(count, timeout=RESTART_S)
        return
    try:
        client = distributed.Client(where, timeout=CONNECT_S)
    except (OSError, ValueError) as error:
        words = str(error).splitlines()[0] if str(error) else type(error).__name__
        raise InputError(
            f"no scheduler there: {words}", where=where, allowed="the address of a Dask scheduler"
        ) from None
    with client:
        _check_workers(client, where)
        yield client


@contextmanager
def _own_environment() -> Iterator[None]:
    """Restore the environment at the end: Dask sets OMP_NUM_THREADS in this process to pass it to its workers."""
    kept = dict(os.environ)
    try:
        yield
    finally:
        os.environ.clear()
        os.environ.update(kept)


def dask_setup(worker: Any) -> None:
    """Leave Ctrl-C to the client in a local worker, which would else end before the client closes the cluster."""
    if threading.current_thread() is threading.main_thread():
        signal.signal(signal.SIGINT, signal.SIG_IGN)


def _check_workers(client: Any, where: str) -> None:
    """Refuse a cluster without workers, with several threads in a worker, or with another version of ullage."""

    def installed() -> str | None:  # a local function travels whole: a worker need not know this module
        try:
            import ullage as found
        except ImportError:
            return None
        return str(found.__version__)

    threads = client.nthreads()
    if not threads:
        raise InputError("the scheduler has no workers", where=where, allowed="one worker or more")
    for worker, version in client.run(installed).items():
        if version != ullage.__version__:
            what = "no ullage" if version is None else f"ullage {version}"
            raise InputError(f"worker {worker} has {what}; here is {ullage.__version__}", where=where,
                             allowed="the same version everywhere")  # fmt: skip
        if threads.get(worker, 1) > 1:
            raise InputError(f"worker {worker} has {threads[worker]} threads", where=where,
                             allowed="one thread in each worker: dask worker --nworkers N --nthreads 1")  # fmt: skip


def _on_cluster(client: Any, work: Work, tasks: Sequence[Any], log: Log) -> Generator[Done, None, None]:
    """Keep a few tasks with each worker, and yield each as it ends.

    Dask calls back in threads of its own. They only fill a queue, so that `log` and the caller run in this thread.
    """
    news: SimpleQueue[Any] = SimpleQueue()
    topic = f"ullage-{uuid.uuid4().hex}"
    in_worker = partial(_in_worker, work, topic, os.getcwd())
    waiting, running = iter(tasks), dict[Any, Any]()
    client.subscribe_topic(topic, lambda event: news.put(event[1]))
    while True:
        for task in itertools.islice(waiting, max(_room(client, len(running)), 0)):
            future = client.submit(in_worker, task, pure=False)
            running[future] = task
            future.add_done_callback(news.put)
        if not running:
            return
        while isinstance(item := news.get(), str):
            log(item)
        yield running.pop(item), *_result(item)


def _room(client: Any, running: int) -> int:
    """Return how many more tasks to submit; one even while all workers are being replaced.

    Raises:
        UllageError: the scheduler is gone.
    """
    try:
        return max(AHEAD * len(client.nthreads()), 1) - running
    except (OSError, RuntimeError):  # Dask's errors of a closed line and of a closed client
        raise UllageError(GONE) from None


def _result(future: Any) -> tuple[Any, UllageError | None]:
    """Result and error of a task that ended.

    Raises:
        UllageError: it ended because the scheduler is gone.
    """
    try:
        return future.result(), None
    except Exception as error:
        if future.status != "error":
            raise UllageError(GONE) from None
        return None, reason_of(error)


def _in_worker(work: Work, topic: str, folder: str, task: Any) -> Any:
    """Do a task in a worker, in the client's folder, and report its progress to the client now and then."""
    distributed: Any = need("distributed", extra="scale")
    worker, reported_s = distributed.get_worker(), 0.0

    def log(text: str) -> None:
        nonlocal reported_s
        if time.monotonic() - reported_s > EVENT_S:
            reported_s = time.monotonic()
            with suppress(OSError):  # there is no receiver any more
                worker.log_event(topic, text)

    with chdir(folder):  # so that relative paths mean the same
        return work(task, log)


Report = Callable[[int, str], None]


class Task(Protocol):
    """A piece of work that leaves a folder and knows when it is done."""

    @property
    def name(self) -> str:
        """Unique name of the task."""

    @property
    def title(self) -> str:
        """Title for users."""

    @property
    def cost(self) -> float:
        """Relative duration."""

    @property
    def done(self) -> bool:
        """Whether its results exist."""

    def do(self, log: Callable[[str], None]) -> None:
        """Run it again and report progress."""


@dataclass(frozen=True, slots=True)
class Outcome:
    """Outcome of tasks that leave their results in folders."""

    failed: dict[str, UllageError]  # why tasks failed, by name
    interrupted: bool  # by Ctrl-C


def carry_out(
    tasks: Sequence[Task], *, where: Where = 1, report_progress: Report = lambda *_: None, again: bool = False
) -> Outcome:
    """Do every task that is not done; on a cluster the longest first.

    Args:
        tasks: in the order of the report.
        where: number of worker processes here, or address of a scheduler whose workers see the same folders.
        report_progress: called with the number of finished tasks and the current work.
        again: do those that are done once more.

    Raises:
        UllageError: the cluster cannot be used or is gone; results that were finished stay.
    """
    left = [task for task in tasks if again or not task.done]
    finished, failed = len(tasks) - len(left), dict[str, UllageError]()
    if where != 1:
        left.sort(key=lambda task: -task.cost)
    report_progress(finished, "starting")
    try:
        with closing(each_done(_do, left, where=where, log=lambda text: report_progress(finished, text))) as results:
            for task, _, error in results:
                finished += 1
                if error is not None:
                    failed[task.name] = error
                report_progress(finished, f"{task.title}: {'done' if error is None else 'failed'}")
    except KeyboardInterrupt:
        return Outcome(failed, interrupted=True)
    return Outcome(failed, interrupted=False)


def _do(task: Task, log: Log) -> None:
    task.do(lambda text: log(f"{task.title}: {text}"))
