"""Numba's compiler, without work that the kernel's functions do not need."""

import gc
from typing import Any

from numba.core.codegen import JITCodeLibrary
from numba.core.compiler import CompilerBase, DefaultPassBuilder


class _InnerLibrary(JITCodeLibrary):
    """A function's LLVM code, of which no machine code is made: its callers have a copy of it."""

    def _finalize_final_module(self) -> None:
        self._finalize_dynamic_globals()
        self._finalized = True

    @property
    def codegen(self) -> Any:
        """Return an object that ignores the address of an environment, which this code has not."""
        return self

    def set_env(self, name: str, environment: Any) -> None:
        """Do nothing."""


class KernelCompiler(CompilerBase):
    """Numba's compiler, without work that these functions do not need.

    A function that only compiled code calls gets no machine code.
    """

    def define_pipelines(self) -> list[Any]:
        """Return Numba's passes."""
        state = self.state
        if state.flags.no_cpython_wrapper:
            state.library = _InnerLibrary(state.targetctx.codegen(), state.func_id.func_qualname)
        return [DefaultPassBuilder.define_nopython_pipeline(state)]

    def compile_extra(self, func: Any) -> Any:
        """Compile a function without searching for garbage meanwhile."""
        collects = gc.isenabled()
        gc.disable()
        try:
            return super().compile_extra(func)
        finally:
            if collects:
                gc.enable()
