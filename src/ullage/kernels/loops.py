"""How loops are compiled: copies are kept on disk, and wrappers that nobody calls are not made.

Numba writes every function three times: itself, a wrapper that takes Python's objects, and one for C. The wrappers
unpack every array argument, and cost a quarter of the time that compiling takes.
"""

from __future__ import annotations

from functools import partial

from numba import njit

loop = partial(njit, cache=True, no_cfunc_wrapper=True)
"""Compiles a kernel that Python calls."""
inner = partial(loop, no_cpython_wrapper=True)
"""Compiles a loop that only other loops call; Python must not."""
