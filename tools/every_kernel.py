"""Pytest plugin of `make bounds`: fail where a kernel is run by none of the tests that ran.

A kernel counts as run if Numba holds compiled code of it in one of the test processes, or a kernel that did calls it.
"""

from __future__ import annotations

import pkgutil
import sys
from collections.abc import Iterator
from importlib import import_module
from typing import Any

import pytest

from ullage import kernels

_RUN: set[str] = set()
_MISSING: list[str] = []


def dispatchers(module: Any) -> Iterator[Any]:
    """Compiled functions of a module of kernels, those that it imports too."""
    for value in vars(module).values():
        if hasattr(value, "py_func"):
            yield value
        elif hasattr(value, "compiled") and hasattr(value, "__wrapped__"):  # called by the fields of its NamedTuples
            yield value.compiled()


def name_of(kernel: Any) -> str:
    """A kernel's module and name."""
    return f"{kernel.py_func.__module__.rpartition('.')[2]}.{kernel.py_func.__name__}"


def all_kernels() -> set[str]:
    """Every kernel there is."""
    modules = [import_module(f"{kernels.__name__}.{info.name}") for info in pkgutil.iter_modules(kernels.__path__)]
    found = {name_of(one): one.py_func.__module__ for module in modules for one in dispatchers(module)}
    return {name for name, module in found.items() if module.startswith(kernels.__name__)}


def kernels_run() -> set[str]:
    """The kernels that this process holds compiled code of, and all that they call."""
    loaded = [module for name, module in list(sys.modules.items()) if name.startswith(f"{kernels.__name__}.")]
    waiting = [one for module in loaded for one in dispatchers(module) if one.signatures]
    found: dict[str, Any] = {}
    while waiting:
        one = waiting.pop()
        if name_of(one) not in found:
            found[name_of(one)] = one
            names = [one.py_func.__globals__.get(name) for name in one.py_func.__code__.co_names]
            waiting += [value for value in names if hasattr(value, "py_func")]
    return set(found)


def pytest_sessionfinish(session: pytest.Session) -> None:
    """Hand what a worker ran to the process that began it."""
    _RUN.update(kernels_run())
    if (output := getattr(session.config, "workeroutput", None)) is not None:
        output["kernels"] = sorted(_RUN)
    else:
        _MISSING.extend(sorted(all_kernels() - _RUN))
        if _MISSING:
            session.exitstatus = pytest.ExitCode.TESTS_FAILED


@pytest.hookimpl(optionalhook=True)
def pytest_testnodedown(node: Any) -> None:
    """Take what a worker ran."""
    _RUN.update(getattr(node, "workeroutput", {}).get("kernels", ()))


def pytest_terminal_summary(terminalreporter: Any) -> None:
    """Say how many kernels ran, and which did not."""
    terminalreporter.write_line(f"kernels run: {len(_RUN)}; run by no test: {', '.join(_MISSING) or 'none'}")
