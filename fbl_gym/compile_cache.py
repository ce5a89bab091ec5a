"""The cache of compiled code: files in the user's cache directory, shared by processes.

If several processes need a function that is not in the cache, one compiles it and the others wait.
The operating system releases the lock when its holder ends, and no process waits longer than
`PATIENCE`. An unusable cache costs time only: the function is compiled in memory, after a warning.
"""

from __future__ import annotations

import errno
import gc
import os
import time
import warnings
from typing import IO, Any

from numba.core import caching
from numba.core.codegen import JITCodeLibrary
from numba.core.compiler import CompilerBase, DefaultPassBuilder

if os.name == "nt":
    import msvcrt
else:
    import fcntl

PATIENCE = 120.0
"""Longest time to wait for another process that compiles [s]."""


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


class _Files(caching.CompileResultCacheImpl):
    """Numba's choice of a folder, without the package's `__pycache__`.

    `pip uninstall` would leave files there.
    """

    _locator_classes = [  # noqa: RUF012 - as in Numba
        locator for locator in caching.CacheImpl._locator_classes if "InTree" not in locator.__name__
    ]


class CompileCache(caching.FunctionCache):
    """The compiled versions of one function.

    The folder is `NUMBA_CACHE_DIR`, else `numba` in the user's cache directory.

    Args:
        function: to compile.

    Raises:
        RuntimeError: if no folder can be written.
    """

    _impl_class = _Files
    _has_warned = False

    def __init__(self, function: Any) -> None:
        super().__init__(function)
        self._files = os.path.join(self.cache_path, self._impl.filename_base)
        self._lock: IO[bytes] | None = None

    def load_overload(self, signature: Any, target_context: Any) -> Any:
        """Return a compiled version; None if it must be compiled, with the lock in this process."""
        version = self._load(signature, target_context)
        if version is None and self._lock is None:
            self._lock = _lock(self._files + ".lock")
            version = self._load(signature, target_context)  # another process may have compiled it by now
            if version is not None:
                self._unlock()
        return version

    def _load(self, signature: Any, target_context: Any) -> Any:
        try:
            return super().load_overload(signature, target_context)
        except Exception as problem:  # unpickling damaged bytes may raise anything
            self._warn("read", problem)
        try:
            self.flush()  # so that the next version can be stored
        except OSError as problem:
            self._warn("written", problem)
        return None

    def save_overload(self, signature: Any, version: Any) -> None:
        """Store a compiled version, and release the lock."""
        try:
            super().save_overload(signature, version)
        except Exception as problem:
            self._warn("written", problem)
        finally:
            self._unlock()

    def _unlock(self) -> None:
        if self._lock is not None:
            self._lock.close()
            self._lock = None

    def _warn(self, verb: str, problem: Exception) -> None:
        """Warn once in a process."""
        if not CompileCache._has_warned:
            CompileCache._has_warned = True
            warnings.warn(
                f"compiled code cannot be {verb}: {self._files}.* ({type(problem).__name__}: {problem}); "
                "it is compiled in memory. Delete these files, or set NUMBA_CACHE_DIR to another folder.",
                RuntimeWarning,
                stacklevel=2,
            )


def _lock(path: str) -> IO[bytes] | None:
    """Return a file that this process has locked; None if that is impossible or takes too long."""
    try:
        file = open(path, "ab")  # noqa: SIM115 - stays open while it is locked
    except OSError:
        return None
    end = time.monotonic() + PATIENCE
    while True:
        try:
            if os.name == "nt":
                msvcrt.locking(file.fileno(), msvcrt.LK_NBLCK, 1)  # type: ignore[attr-defined]
            else:
                fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
            return file
        except OSError as problem:
            if problem.errno not in (errno.EAGAIN, errno.EACCES, errno.EDEADLK) or time.monotonic() > end:
                file.close()
                return None
            time.sleep(0.05)
