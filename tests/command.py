"""The command line within the process of the tests."""

from __future__ import annotations

import sys
from pathlib import Path

import pytest

from ullage.cli import main


def ended(words: tuple[str, ...], cwd: Path) -> int | str | None:
    """How a command ended, run within this process."""
    with pytest.MonkeyPatch.context() as patch:
        patch.chdir(cwd)
        patch.setattr(sys, "argv", ["ullage", *words])
        try:
            main()
        except SystemExit as end:
            return end.code
    return 0
