"""What all tests share."""

from __future__ import annotations

import signal
from collections.abc import Iterator
from functools import cache
from pathlib import Path

import pytest
import typer.main

typer.main.get_command = cache(typer.main.get_command)  # a process of ours calls it once, the tests hundreds of times


@pytest.hookimpl(trylast=True)
def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Spread the files of live ports, which mostly wait, over those that compute: workers share few cores."""
    ports, place = Path(__file__).parent / "ports", dict[Path, float]()
    for waiting in (False, True):
        files = dict.fromkeys(item.path for item in items if item.path.is_relative_to(ports) == waiting)
        place |= {path: (k + 0.5) / len(files) for k, path in enumerate(files)}
    items.sort(key=lambda item: place[item.path])


@pytest.fixture
def heeded_signals() -> Iterator[None]:
    """Heed Ctrl-C and hang-ups as in a terminal; a background shell and nohup start the tests with them ignored."""
    usual = {signal.SIGINT: signal.default_int_handler, signal.SIGHUP: signal.SIG_DFL, signal.SIGTERM: signal.SIG_DFL}
    before = {number: signal.signal(number, handler) for number, handler in usual.items()}
    yield
    left = {number: signal.signal(number, handler) for number, handler in before.items()}
    assert left == usual
