"""Progress on the terminal: a bar on anything over two seconds, plain lines where there is no terminal."""

from __future__ import annotations

import logging
import os
import sys
import time
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from datetime import timedelta
from pathlib import Path

from rich.console import Console, RenderableType
from rich.progress import BarColumn, Progress, TaskID, TextColumn, TimeElapsedColumn, TimeRemainingColumn
from rich.text import Text

LOGGER = logging.getLogger("ullage")
console = Console(stderr=False, soft_wrap=True)
PLAIN_EVERY_S = 20.0
"""Until the first line of progress without a terminal; each later one comes after three times as long [s]."""
LAG_S = 0.5
"""A live run that is behind by less does not say so [s]."""


def log(text: str, *, mark: str = "", style: str = "") -> None:
    """Log one line of progress, which `--quiet` leaves out; the command line shows it as `answer` does.

    Args:
        text: the line.
        mark: prefix of the line.
        style: of the mark.
    """
    if LOGGER.handlers:
        LOGGER.info(text, extra={"mark": mark, "style": style})
    else:  # not within the command
        answer(text, mark=mark, style=style)


def _quiet() -> bool:
    return LOGGER.level > logging.INFO


def answer(text: str, *, mark: str = "", style: str = "") -> None:
    """Print one line that was asked for, verbatim: brackets in a name are not markup.

    Args:
        text: the line.
        mark: prefix of the line.
        style: of the mark.
    """
    console.print(Text.assemble((mark, style), text))


def log_report(page: Path) -> None:
    """Print the path of a report, as a link in terminals that support it, unless `--quiet` is given."""
    if _quiet():
        return
    console.print(Text.assemble("report: ", (str(page), f"link {page.resolve().as_uri()}")))


def open_page(page: Path) -> None:
    """Open a page in the browser of a desktop; without a desktop, do nothing."""
    import webbrowser

    if sys.platform in {"darwin", "win32"} or os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY"):
        webbrowser.open(page.resolve().as_uri())


@dataclass(slots=True)
class ProgressBar:
    """A callable that takes the amount done; without a terminal it prints a line every few seconds."""

    bar: Progress
    task: TaskID
    title: str
    total: float | None
    unit: str
    last_s: float
    rated: bool = False
    first: tuple[float, float] | None = None  # amount done at the first call, and its time [s]
    lag: str = ""  # what is added to the title of a live run that cannot keep up
    every_s: float = PLAIN_EVERY_S  # between two lines without a terminal [s]

    def __call__(self, done: float) -> None:
        """Report the amount done, in the bar's unit."""
        forecast = self._forecast(done)
        self.bar.update(self.task, completed=done, forecast=forecast)
        if not console.is_terminal and time.monotonic() - self.last_s > self.every_s:
            self.last_s, self.every_s = time.monotonic(), 3 * self.every_s
            share = f"{100 * done / self.total:.0f} %" if self.total else f"{done:.0f} {self.unit}"
            log(", ".join(filter(None, (f"{self.title}: {share}", forecast, self.lag))))

    def _forecast(self, done: float) -> str:
        """Remaining time in words, and the rate where asked for; nothing before the first unit is done."""
        now = time.monotonic()
        if self.first is None:
            self.first = done, now
        rate = (done - self.first[0]) / max(now - self.first[1], 1e-9)
        if rate <= 0 or self.total is None or done > self.total:  # a flight may land late
            return ""
        left = f"{timedelta(seconds=round((self.total - done) / rate))} left"
        return f"{60 * rate:.3g} {self.unit}/min, {left}" if self.rated else left

    def on_lag(self, behind_s: float, left_out: int) -> None:
        """Show that a live run cannot keep up.

        Args:
            behind_s: how far map and image are behind [s].
            left_out: frames that came too late so far.
        """
        parts = [f"{behind_s:.1f} s behind"] if behind_s > LAG_S else []
        parts += [f"{left_out} frames left out"] if left_out else []
        self.lag = ", ".join(parts)
        self.bar.update(self.task, description=", ".join(filter(None, (self.title, self.lag))))

    def retitle(self, text: str) -> None:
        """Change the bar's title, as often as needed."""
        self.title = text
        self.bar.update(self.task, description=text)

    def at(self, done: float, text: str) -> None:
        """Report the amount done and the current work; the address of a dashboard gets a line of its own."""
        (log if text.startswith("dashboard") else self.retitle)(text)
        self(done)

    def log(self, text: str) -> None:
        """Retitle the bar, in a separate line without a terminal."""
        self.retitle(text)
        if not console.is_terminal:
            log(text)


class _Progress(Progress):
    """Bars with lines above them."""

    above: Callable[[], list[str]] | None = None

    def get_renderables(self) -> Iterable[RenderableType]:
        """Return what is shown: the lines, then the bars."""
        if self.above is not None:
            yield Text("\n".join(self.above()), no_wrap=True, overflow="crop")
        yield from super().get_renderables()


def shows_bars() -> bool:
    """Return whether progress is drawn: stdout is a terminal, and `--quiet` is not given."""
    return console.is_terminal and not _quiet()


@contextmanager
def progress_bar(
    title: str,
    *,
    total: float | None,
    unit: str = "",
    rated: bool = False,
    above: Callable[[], list[str]] | None = None,
) -> Iterator[ProgressBar]:
    """A progress bar for one job; call what it yields with the amount done.

    Args:
        title: of the job.
        total: amount in all.
        unit: of the amounts.
        rated: show the rate since the first call, and the remaining time at that rate; for jobs with few long steps.
        above: gives lines that are shown above the bar on a terminal.
    """
    if not console.is_terminal:
        log(title)
    left = TextColumn("left"), TimeRemainingColumn()  # of a job that has an end
    columns = (
        TextColumn("{task.description}", markup=False),
        BarColumn(),
        TimeElapsedColumn(),
        *((TextColumn("{task.fields[forecast]}"),) if rated else left if total else ()),
    )
    with _Progress(*columns, console=console, disable=not shows_bars()) as bar:
        bar.above = above
        task = bar.add_task(title, total=total, forecast="")
        yield ProgressBar(bar, task, title, total, unit, time.monotonic(), rated)
