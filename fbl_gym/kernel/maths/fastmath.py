"""Elementary functions that vectorise and give the same bits on every machine.

A call to the C library's `sin` keeps the compiler from running a loop on several lanes at once, and
its last bit differs between C libraries. Each function here is a fixed sequence of additions,
multiplications and fused multiply-adds without a branch, which LLVM may not reorder or fuse: no
fast-math flag is set anywhere in this package.

The polynomials of sine and cosine are those of FreeBSD's msun (`k_sin.c`, `k_cos.c`; Sun
Microsystems 1993). Those of exp and log are plain Taylor series, long enough that truncation lies
below rounding. `tests/fbl_gym/test_fastmath.py` bounds their distance from the C library.
"""

import contextlib
import hashlib
import os
import sys
import time
import warnings
from pathlib import Path
from typing import Any

import numpy as np
from numba import njit, types
from numba.core import caching, config
from numba.extending import intrinsic

# Options of all compiled functions. NumPy's rule for division (x / 0 is infinite) leaves no exits
# in the loops over lanes: a loop with an exit is not vectorised.
_OPTIONS: dict[str, Any] = {"error_model": "numpy", "no_cfunc_wrapper": True}
_INNER: dict[str, Any] = {**_OPTIONS, "no_cpython_wrapper": True, "_nrt": False}

#: Compile a function that becomes part of its callers, which leaves their loops free of calls.
inline_njit = njit(forceinline=True, **_INNER)

#: Compile a function that Python does not call; without a wrapper it compiles faster.
kernel_njit = njit(**_INNER)

#: Copy a function's source into its only caller before compilation, where that compiles faster.
merged_njit = njit(inline="always", **_INNER)


def named(function: Any, *parts: object) -> Any:
    """Give a closure a qualified name of its own, before it is compiled.

    The symbol of compiled code is made of this name, the types of the arguments, and a number that
    counts the functions of the process. Two closures of one name may get one symbol in two
    processes. A third process that loads both from the cache would then use one for both.
    """
    function.__qualname__ = "_".join((function.__qualname__, *map(str, parts)))
    return function


def over_lanes(function: Any, *constants: Any) -> Any:
    """Return the loop of function(block, settings, lane, *constants) over the lanes of a block."""

    def loop(block, settings, width):
        for lane in range(width):
            function(block, settings, lane, *constants)

    return kernel_njit(named(loop, function.__module__, function.__qualname__, *constants))


def digest(package: Path) -> str:
    """Return a hash of the sources of `fbl_gym` that compiled code depends on.

    They are the kernel, and all that `kernel/memory/layout.py` reads to lay out its memory.
    """
    patterns = "*.py", "kernel/**/*.py", "model/*.py", "options/*.py", "records/*.py", "scenarios/scenario.py"
    files = sorted(path for pattern in patterns for path in package.glob(pattern))
    return hashlib.sha256(b"".join(path.read_bytes() for path in files)).hexdigest()


DIGEST = digest(Path(__file__).parents[2])


#: Time in which all that a command needs is compiled [s].
WHILE = 300.0


class _Cache(caching.FunctionCache):
    """Numba's cache on disk, which alone notices changes in a function's own file only.

    The folder is that of the environment variable NUMBA_CACHE_DIR, else beside the source, else the
    user's. A configuration file of Numba in the current folder has no say: what is in the cache is
    code.
    """

    def __init__(self, function: Any) -> None:
        settings = {"CACHE_DIR": os.environ.get("NUMBA_CACHE_DIR", ""), "CACHE_LOCATOR_CLASSES": ""}
        kept = {name: getattr(config, name, "") for name in settings}
        try:
            vars(config).update(settings)
            super().__init__(function)
        finally:
            vars(config).update(kept)

    def _index_key(self, sig: Any, codegen: Any) -> Any:
        """Return the key of compiled code, with a hash of all that functions may call.

        Numba's own key hashes what a closure refers to. A compiled function among it has another
        hash in each process.
        """
        return sig, codegen.magic_tuple(), DIGEST

    def load_overload(self, sig: Any, target_context: Any) -> Any:
        """Return what is kept of a function; None, and say so, if it must be compiled.

        What cannot be read, such as a file that a full disk cut, is compiled and kept anew.
        """
        kept = None
        try:
            kept = super().load_overload(sig, target_context)
        except Exception:  # of any type, since it is of pickle and LLVM
            with contextlib.suppress(OSError):
                self.flush()
        if kept is None and self._py_func.__module__.startswith("fbl_gym.kernel.step"):  # others are short
            say_once(Path(self.cache_path))
        return kept

    def save_overload(self, sig: Any, data: Any) -> None:
        """Keep the code of a function; warn if the disk is full."""
        try:
            super().save_overload(sig, data)
        except OSError as problem:
            _warn_unkept(str(problem.strerror))


def _warn_unkept(reason: str) -> None:
    warnings.warn(
        f"compiled code cannot be kept, {reason}: every process compiles for some seconds. Set the environment "
        "variable NUMBA_CACHE_DIR to a folder that can be written.",
        RuntimeWarning,
        stacklevel=1,  # one place, so one warning
    )


def say_once(folder: Path) -> None:
    """Say that code is compiled, unless a process with the same cache has said so of late."""
    said = folder / "compiling"
    with contextlib.suppress(OSError):  # such as that the file exists
        folder.mkdir(parents=True, exist_ok=True)
        if said.exists() and time.time() - said.stat().st_mtime > WHILE:
            said.unlink()
        said.open("x").close()
        print(
            "fbl-gym: compiles code for this kind of arm, once, some 20 s; it is kept on disk",
            file=sys.stderr,
            flush=True,
        )


def cached_njit(function: Any) -> Any:
    """Compile a function that Python calls, and cache the result on disk.

    Where no folder can be written, warn; then each process compiles.
    """
    dispatcher = njit(nogil=True, **_OPTIONS)(function)
    try:
        dispatcher._cache = _Cache(function)
    except RuntimeError:
        _warn_unkept("as no folder can be written")
    return dispatcher


@intrinsic
def fma(_context, _a, _b, _c):
    """Return a b + c, rounded once: one instruction, or the C library's exact function."""

    def emit(_context, builder, _signature, arguments):
        return builder.fma(*arguments)

    return types.float64(types.float64, types.float64, types.float64), emit


def _rounded(name: str) -> Any:
    """Return LLVM's exactly rounded function of one number, which NumPy's is on a CPU too."""

    @intrinsic
    def function(_context, _x):
        def emit(_context, builder, _signature, arguments):
            return builder.call(builder.module.declare_intrinsic(f"llvm.{name}", [arguments[0].type]), arguments)

        return types.float64(types.float64), emit

    return function


sqrt, floor, ceil = map(_rounded, ("sqrt", "floor", "ceil"))


@inline_njit
def larger(a, b):
    """Return b if it is larger than a, else a, also for NaN; `max` is not the same on a GPU."""
    return b if b > a else a


@inline_njit
def smaller(a, b):
    """Return b if it is smaller than a, else a, as `larger` does."""
    return b if b < a else a


# Adding and subtracting 1.5 * 2**52 rounds a double to the nearest integer. The sum's low bits hold
# that integer.
_ROUND = 6755399441055744.0

# pi/2 and log(2) as the sum of two doubles. A fused multiply-add subtracts k times the first from x
# without rounding.
_HALF_PI_HIGH, _HALF_PI_LOW = 1.5707963267948966, 6.123233995736766e-17
_TWO_OVER_PI = 0.6366197723675814
_LN2_HIGH, _LN2_LOW = 0.6931471805599453, 2.3190468138462996e-17
_ONE_OVER_LN2 = 1.4426950408889634

_S3, _S5, _S7 = -1.66666666666666324348e-01, 8.33333333332248946124e-03, -1.98412698298579493134e-04
_S9, _S11, _S13 = 2.75573137070700676789e-06, -2.50507602534068634195e-08, 1.58969099521155010221e-10
_C4, _C6, _C8 = 4.16666666666666019037e-02, -1.38888888888741095749e-03, 2.48015872894767294178e-05
_C10, _C12, _C14 = -2.75573143513906633035e-07, 2.08757232129817482790e-09, -1.13596475577881948265e-11

_E2, _E3, _E4, _E5, _E6, _E7 = 1 / 2, 1 / 6, 1 / 24, 1 / 120, 1 / 720, 1 / 5040
_E8, _E9, _E10, _E11, _E12, _E13 = 1 / 40320, 1 / 362880, 1 / 3628800, 1 / 39916800, 1 / 479001600, 1 / 6227020800

_SQRT_HALF_BITS = np.int64(0x3FE6A09E667F3BCD)  # sqrt(1/2) as a double


@inline_njit
def rint(x):
    """Return x rounded to the nearest integer, of two the even one, for |x| < 2**51."""
    return (x + _ROUND) - _ROUND


@inline_njit
def clip(x, bound):
    """Return x clipped to [-bound, bound]; NaN becomes -bound."""
    x = x if x > -bound else -bound
    return x if x < bound else bound


@inline_njit
def sincos(x):
    """Return sine and cosine of x [rad].

    They are within 2e-16 of the truth for |x| < 1e14, and meaningless beyond 3e15.
    """
    shifted = fma(x, _TWO_OVER_PI, _ROUND)
    quadrant = np.float64(shifted).view(np.int64)
    k = shifted - _ROUND
    r = fma(-k, _HALF_PI_LOW, fma(-k, _HALF_PI_HIGH, x))
    z = r * r
    zz = z * z  # the polynomials by halves, which do not wait for each other
    s = fma(zz, fma(zz, fma(z, _S13, _S11), fma(z, _S9, _S7)), fma(z, _S5, _S3))
    s = fma(r * z, s, r)
    c = fma(zz, fma(zz, fma(z, _C14, _C12), fma(z, _C10, _C8)), fma(z, _C6, _C4))
    c = fma(zz, c, fma(z, -0.5, 1.0))
    odd = (quadrant & 1) != 0
    sine = c if odd else s
    cosine = s if odd else c
    sine = -sine if (quadrant & 2) != 0 else sine
    cosine = -cosine if ((quadrant + 1) & 2) != 0 else cosine
    return sine, cosine


@inline_njit
def exp(x):
    """Return e**x within 3e-16 relative; x is clipped to [-700, 700]."""
    x = clip(x, 700.0)
    shifted = fma(x, _ONE_OVER_LN2, _ROUND)
    exponent = np.float64(shifted).view(np.int64)
    k = shifted - _ROUND
    r = fma(-k, _LN2_LOW, fma(-k, _LN2_HIGH, x))
    tail = fma(r, fma(r, fma(r, fma(r, fma(r, _E13, _E12), _E11), _E10), _E9), _E8)
    p = fma(r, fma(r, fma(r, fma(r, fma(r, fma(r, tail, _E7), _E6), _E5), _E4), _E3), _E2)
    p = fma(r, fma(r, p, 1.0), 1.0)
    power_of_two = np.int64((exponent + np.int64(1023)) << np.int64(52)).view(np.float64)
    return p * power_of_two


@inline_njit
def log(x):
    """Return the natural logarithm of a positive, normal x, within 4e-16 relative."""
    bits = np.float64(x).view(np.int64)
    # Split x = 2**e * m with m in [sqrt(1/2), sqrt(2)).
    shifted = bits - _SQRT_HALF_BITS
    e = shifted >> np.int64(52)
    m = np.int64(bits - (e << np.int64(52))).view(np.float64)
    # The integer e as a double without a conversion: the inverse of the rounding trick.
    k = np.int64(e + np.int64(0x4338000000000000)).view(np.float64) - _ROUND
    s = (m - 1.0) / (m + 1.0)
    z = s * s
    p = fma(z, fma(z, fma(z, fma(z, 1 / 21, 1 / 19), 1 / 17), 1 / 15), 1 / 13)
    p = z * fma(z, fma(z, fma(z, fma(z, fma(z, p, 1 / 11), 1 / 9), 1 / 7), 1 / 5), 1 / 3)
    return fma(k, _LN2_HIGH, fma(k, _LN2_LOW, 2.0 * fma(s, p, s)))
