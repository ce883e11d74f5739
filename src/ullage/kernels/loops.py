"""How loops are compiled: copies are kept on disk, and nothing is done for them that loops do not need.

Numba writes every function three times: itself, a wrapper that takes Python's objects, and one for C. The wrappers
unpack every array argument, and cost a quarter of the time that compiling takes. Of its passes, those for closures,
for contexts, for arguments that are None, for literal containers and for expressions of whole arrays find nothing here;
with each of them the lives of all variables are followed anew.
"""

from __future__ import annotations

from functools import partial
from typing import Any

from numba import njit
from numba.core import typed_passes as typed
from numba.core import untyped_passes as untyped
from numba.core.compiler import CompilerBase, DefaultPassBuilder
from numba.core.compiler_machinery import PassManager


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


loop = partial(njit, cache=True, no_cfunc_wrapper=True, pipeline_class=Plain)
"""Compiles a kernel that Python calls."""
inner = partial(loop, no_cpython_wrapper=True)
"""Compiles a loop that only other loops call; Python must not."""
lean = partial(loop, _nrt=False)
"""As `loop`, for one that makes and returns no arrays: it counts no references to those it is handed.

Numba takes and drops one for about every array at every call of another loop, which took a third of the radar's time.
"""
core = partial(inner, _nrt=False)
"""As `inner`, for one that makes and returns no arrays."""
