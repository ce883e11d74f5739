"""How loops are compiled: copies are kept on disk, and nothing is done for them that loops do not need.

A copy belongs to all kernel sources together. Numba alone compares only the file that a kernel stands in, and would go
on using old code of the functions that this kernel calls from other files.

Numba writes every function three times: itself, a wrapper that takes Python's objects, and one for C. The wrappers
unpack every array argument, and cost a quarter of the time that compiling takes. Of its passes, those for closures,
for contexts, for arguments that are None, for literal containers and for expressions of whole arrays find nothing here;
with each of them the lives of all variables are followed anew. Leaving them out is Numba's documented option
`pipeline_class`, and saves 5 to 13 % of the CPU time of the first call of `ullage.simulate`. Nothing of Numba itself
is replaced.
"""

from __future__ import annotations

import hashlib
import os
import shutil
import sys
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from functools import cache, partial
from pathlib import Path
from typing import Any

import numba
from numba import njit
from numba.core import typed_passes as typed
from numba.core import untyped_passes as untyped
from numba.core.compiler import CompilerBase, DefaultPassBuilder
from numba.core.compiler_machinery import PassManager

from ullage.kernels.fields import unpacking


class Plain(CompilerBase):  # type: ignore[misc]
    """Compiles loops over arrays and numbers."""

    def define_pipelines(self) -> list[Any]:
        """The passes that such loops need, in Numba's order."""
        passes = PassManager("loops")
        for step in (untyped.TranslateByteCode, untyped.FixupArgs, untyped.IRProcessing, untyped.GenericRewrites,
                     untyped.ReconstructSSA, typed.NopythonTypeInference, typed.PreLowerStripPhis):  # fmt: skip
            passes.add_pass(step, step.__name__)
        passes.passes.extend(DefaultPassBuilder.define_nopython_lowering_pipeline(self.state).passes)
        passes.finalize()
        return [passes]


@cache
def cache_folder() -> Path | None:
    """Return the folder for compiled copies of these kernel sources, or None where no folder can be written.

    Its name is a digest of every kernel source, of the versions of Python and Numba, and of bounds checking. A change
    to any of these gives another folder. The folders used last stay; older ones are deleted.
    """
    here = Path(__file__).parent
    digest = hashlib.sha256(f"{sys.version} {numba.__version__} {numba.config.BOUNDSCHECK}".encode())
    for source in sorted(here.glob("*.py")):
        digest.update(source.name.encode() + b"\0" + source.read_bytes() + b"\0")
    user = Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache") / "ullage"
    places = [Path(numba.config.CACHE_DIR)] if numba.config.CACHE_DIR else [here / "__pycache__", user]
    for place in places:
        folder = place / f"kernels-{digest.hexdigest()[:16]}"
        try:
            folder.mkdir(parents=True, exist_ok=True)
            os.utime(folder)  # the folders used last are kept
        except OSError:
            continue
        if os.access(folder, os.W_OK):
            _delete_old(place)
            return folder
    return None


_KEPT = 4  # folders of compiled copies: going back and forth between a few versions compiles nothing again


def _delete_old(place: Path) -> None:
    """Delete all but the folders of compiled copies used last."""
    dated = []
    for folder in place.glob("kernels-*"):
        try:
            dated.append((folder.stat().st_mtime, folder))
        except OSError:  # another process deleted it
            continue
    for _, folder in sorted(dated, reverse=True)[_KEPT:]:
        shutil.rmtree(folder, ignore_errors=True)


_SETTING = threading.Lock()  # one thread at a time changes Numba's setting: loops are made at their first calls too


@contextmanager
def _cached() -> Iterator[None]:
    """Have Numba keep the copies of what is decorated meanwhile in `cache_folder`."""
    with _SETTING:
        before = numba.config.CACHE_DIR
        numba.config.CACHE_DIR = str(cache_folder() or before)
        try:
            yield
        finally:
            numba.config.CACHE_DIR = before


def loop(*, by_fields: bool = False, **settings: Any) -> Callable[[Callable[..., Any]], Any]:
    """Compile a kernel that Python calls.

    Args:
        by_fields: whether the fields of its NamedTuples are passed one by one, as `fields` explains. Its parameters
            that are NamedTuples must be annotated, and no other kernel can call it.
        **settings: options of `numba.njit`.
    """

    def compile_loop(function: Callable[..., Any]) -> Any:
        with _cached():
            return njit(**{"cache": True, "no_cfunc_wrapper": True, "pipeline_class": Plain, **settings})(function)

    def wrap(function: Callable[..., Any]) -> Any:
        return unpacking(function, compile_loop)

    return wrap if by_fields and not numba.config.DISABLE_JIT else compile_loop


inner = partial(loop, no_cpython_wrapper=True)
"""Compiles a loop that only other loops call; Python must not."""
lean = partial(loop, _nrt=False)
"""As `loop`, for one that makes and returns no arrays: it counts no references to those it is handed.

Numba takes and drops one for about every array at every call of another loop, which took a third of the radar's time.
"""
core = partial(inner, _nrt=False)
"""As `inner`, for one that makes and returns no arrays."""
