"""How tests wait for what a thread or a process does."""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import Any


def until(true: Callable[[], Any], limit_s: float = 60.0) -> Any:
    """Wait until something holds; what it gave then."""
    end = time.monotonic() + limit_s
    while not (found := true()):
        assert time.monotonic() < end, f"it did not come to hold within {limit_s:g} s"
        time.sleep(0.01)
    return found
