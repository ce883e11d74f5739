"""Record which tests run which line of the source, and run chosen tests in a given order: a plugin of pytest.

    PYTHONPATH=tools python -m pytest -p tests_by_line --record FOLDER
    PYTHONPATH=tools python -m pytest -p tests_by_line --chosen FILE

Each test is one context of coverage.py. What a fixture of wider scope runs belongs to its whole file, as any test of
that file may depend on it. Every process writes its own files, so that pytest-xdist works too.
"""

from __future__ import annotations

import json
import os
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest


def pytest_addoption(parser: pytest.Parser) -> None:
    """Add both options."""
    parser.addoption("--record", type=Path, help="folder for the records")
    parser.addoption("--chosen", type=Path, help="JSON list of the tests to run, in this order")


def pytest_configure(config: pytest.Config) -> None:
    """Begin to record before any test file is imported."""
    if config.getoption("record"):
        config.pluginmanager.register(Recorder(config.getoption("record")))


@pytest.hookimpl(trylast=True)
def pytest_collection_modifyitems(config: pytest.Config, items: list[pytest.Item]) -> None:
    """Keep the chosen tests."""
    if not config.getoption("chosen"):
        return
    rank = {name: n for n, name in enumerate(json.loads(config.getoption("chosen").read_text(encoding="utf-8")))}
    items[:] = sorted((item for item in items if item.nodeid in rank), key=lambda item: rank[item.nodeid])


class Recorder:
    """Records the lines and the seconds of each test."""

    def __init__(self, folder: Path) -> None:
        import coverage

        folder.mkdir(exist_ok=True)
        self._seconds_file = folder / f"seconds.{os.getpid()}.json"
        self._seconds: dict[str, float] = {}
        self._lines = coverage.Coverage(
            data_file=str(folder / "lines"), data_suffix=True, source_pkgs=["ullage"], config_file=False
        )
        self._lines.start()

    @pytest.hookimpl(wrapper=True)
    def pytest_runtest_protocol(self, item: pytest.Item) -> Iterator[None]:
        """Record one test, its fixtures included."""
        self._lines.switch_context(item.nodeid)
        result = yield
        self._lines.switch_context("")
        return result

    @pytest.hookimpl(wrapper=True)
    def pytest_fixture_setup(self, fixturedef: Any, request: Any) -> Iterator[None]:
        """Record a shared fixture for the whole file."""
        if fixturedef.scope == "function":
            return (yield)
        nodeid = request._pyfuncitem.nodeid
        self._lines.switch_context(nodeid.partition("::")[0])
        result = yield
        self._lines.switch_context(nodeid)
        return result

    def pytest_runtest_logreport(self, report: pytest.TestReport) -> None:
        """Add up the seconds of one test."""
        if not report.skipped:
            self._seconds[report.nodeid] = self._seconds.get(report.nodeid, 0.0) + report.duration

    def pytest_unconfigure(self) -> None:
        """Write the records."""
        self._lines.stop()
        self._lines.save()
        self._seconds_file.write_text(json.dumps(self._seconds), encoding="utf-8")
