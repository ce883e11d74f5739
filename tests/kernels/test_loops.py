"""Loops come out as Numba alone would have them, and their copies on disk belong to all kernel sources together."""

from __future__ import annotations

import math
import os
import shutil
import subprocess
import sys
import threading
from pathlib import Path

import numba
import numpy as np
import pytest
from numba.core.errors import NumbaError

import ullage
from ullage.kernels import loops
from ullage.kernels.loops import lean, loop


def bent(points, order, out):  # type: ignore[no-untyped-def]
    """Something of all that kernels do: nested loops, tuples, powers, complex numbers, early ends."""
    for i in range(len(points)):
        nearest, total = math.inf, 0j
        for j in range(len(points)):
            if i == j:
                continue
            x, y = points[j, 0] - points[i, 0], points[j, 1] - points[i, 1]
            square = x**2 + y**2 + 1e-6
            nearest = min(nearest, square)
            total += complex(math.cos(square), -math.sin(square)) / square**order
            if j > i + 20:
                break
        out[i] = total * math.sqrt(nearest)


def test_other_threads_run_while_a_loop_does() -> None:
    """Obstacles are found while a map is made: a loop waits for a flag that only another thread sets."""

    def waiting(flag, turns, most):  # type: ignore[no-untyped-def]
        while flag[0] == 0 and turns[0] < most:
            turns[0] += 1

    quick, most = loop(cache=False)(waiting), 3_000_000_000
    flag, turns = np.ones(1, np.int64), np.zeros(1, np.int64)
    quick(flag, turns, most)  # compiles it
    flag[0] = 0

    def answer() -> None:
        while turns[0] == 0:
            pass
        flag[0] = 1

    other = threading.Thread(target=answer)
    other.start()
    quick(flag, turns, most)
    other.join()
    assert 0 < turns[0] < most


def test_loops_give_what_numba_alone_makes_of_them_and_leave_what_they_are_handed_to_its_owner() -> None:
    points, one, other = np.random.default_rng(1).normal(size=(50, 2)), np.empty(50, complex), np.empty(50, complex)
    numba.njit(bent)(points, 2, one)
    for quick in (loop(cache=False)(bent), lean(cache=False)(bent)):
        held = sys.getrefcount(points)
        for _ in range(3):
            quick(points, 2, other)
        assert np.array_equal(one, other)
        assert sys.getrefcount(points) == held
    twin = np.empty(50, complex)
    bent(points, 2, twin)
    np.testing.assert_allclose(one, twin, rtol=1e-12)


def test_a_lean_loop_that_makes_an_array_is_refused() -> None:
    def made(out):  # type: ignore[no-untyped-def]
        own = np.empty(3)
        out[0] = own[0]

    with pytest.raises(NumbaError, match="empty"):
        lean(cache=False)(made)(np.zeros(1))


def test_a_change_of_one_kernel_file_recompiles_the_kernels_of_the_others_that_call_it(tmp_path: Path) -> None:
    kernels = tmp_path / "ullage" / "kernels"
    shutil.copytree(Path(ullage.__file__).parent, tmp_path / "ullage", ignore=shutil.ignore_patterns("__pycache__"))
    (kernels / "caller.py").write_text(
        "from ullage.kernels.called import scaled\nfrom ullage.kernels.loops import loop\n\n\n"
        "@loop()\ndef doubled(x):\n    return 2.0 * scaled(x)\n"
    )
    code = "import ullage.kernels.caller as c; print(c.doubled(1.0), sum(c.doubled.stats.cache_hits.values()))"

    def run(factor: float) -> list[str]:
        (kernels / "called.py").write_text(
            f"from ullage.kernels.loops import inner\n\n\n@inner()\ndef scaled(x):\n    return {factor} * x\n"
        )
        environment = {k: v for k, v in os.environ.items() if k != "NUMBA_CACHE_DIR"} | {
            "PYTHONPATH": str(tmp_path),
            "PYTHONDONTWRITEBYTECODE": "1",  # bytecode knows its source by size and second, which may be the same here
        }
        done = subprocess.run([sys.executable, "-c", code], env=environment, capture_output=True, text=True, check=True)
        return done.stdout.split()

    assert run(3.0) == ["6.0", "0"]
    assert run(5.0) == ["10.0", "0"]
    assert run(3.0) == ["6.0", "1"]  # taken from disk, where the copies of the version before are kept


def test_compiled_copies_of_old_versions_are_deleted_and_numba_s_own_setting_is_left_alone(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(numba.config, "CACHE_DIR", str(tmp_path))
    for age in range(8):
        folder = tmp_path / f"kernels-{age}"
        folder.mkdir()
        os.utime(folder, (1e9 - age, 1e9 - age))
    loops.cache_folder.cache_clear()
    try:
        mine = loops.cache_folder()
    finally:
        loops.cache_folder.cache_clear()
    assert mine is not None
    assert {place.name for place in tmp_path.iterdir()} == {mine.name, "kernels-0", "kernels-1", "kernels-2"}
    assert str(tmp_path) == numba.config.CACHE_DIR


def test_a_part_is_compiled_once_it_is_marked_in_the_folder_of_these_sources(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(loops, "cache_folder", lambda: tmp_path)
    loops.mark_compiled("walls")
    assert loops.compiled(["walls"])
    assert not loops.compiled(["walls", "wires"])
    monkeypatch.setattr(loops, "cache_folder", lambda: None)  # nothing can be kept
    loops.mark_compiled("wires")
    assert not loops.compiled(["walls"])
