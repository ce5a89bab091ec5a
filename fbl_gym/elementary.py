"""Elementary functions that vectorise, and take nothing from the C library.

Why they exist: a call to the C library's `sin` inside a loop keeps the compiler from running that loop on
several lanes at once, and its last bit differs from one C library to the next. Here each function is a fixed
sequence of additions and multiplications without a branch. LLVM may not reorder or fuse them (no fast-math
flag is set anywhere in this package), so that a lane of a batch and a single environment compute the same bits.

The polynomials are plain Taylor series, long enough that truncation lies below rounding. Their distance from
the C library is bounded in `tests/fbl_gym/test_elementary.py`.
"""

from typing import Any

import numpy as np
from numba import njit

# How everything compiled in this package is compiled. Inlined helpers leave the loops over lanes free of calls, and NumPy's
# rule for division (x / 0 is infinite) leaves them free of exits: either would keep a loop from being vectorised.
COMPILED: dict[str, Any] = {"error_model": "numpy", "no_cfunc_wrapper": True}
INNER: dict[str, Any] = {**COMPILED, "no_cpython_wrapper": True}
inline = njit(forceinline=True, **COMPILED)
# The kernel's inner functions cannot be called from Python, which shortens their compilation.
compiled = njit(**INNER)

# Adding and subtracting 1.5 * 2**52 rounds a double to the nearest integer; the sum's low bits hold that integer.
_ROUND = 6755399441055744.0

# pi/2 in three parts; the first two end in zeros, so that k * part is exact for |k| < 2**20 (Cody and Waite).
_HALF_PI_1 = 1.5707963267341256
_HALF_PI_2 = 6.077100506303966e-11
_HALF_PI_3 = 2.0222662487959506e-21
_TWO_OVER_PI = 0.6366197723675814

# log(2) in two parts, likewise.
_LN2_1 = 0.6931471804855391
_LN2_2 = 7.440617110012397e-11
_ONE_OVER_LN2 = 1.4426950408889634

_S3, _S5, _S7, _S9 = -1 / 6, 1 / 120, -1 / 5040, 1 / 362880
_S11, _S13, _S15 = -1 / 39916800, 1 / 6227020800, -1 / 1307674368000
_C2, _C4, _C6, _C8 = -1 / 2, 1 / 24, -1 / 720, 1 / 40320
_C10, _C12, _C14, _C16 = -1 / 3628800, 1 / 479001600, -1 / 87178291200, 1 / 20922789888000

_E2, _E3, _E4, _E5, _E6, _E7 = 1 / 2, 1 / 6, 1 / 24, 1 / 120, 1 / 720, 1 / 5040
_E8, _E9, _E10, _E11, _E12, _E13 = 1 / 40320, 1 / 362880, 1 / 3628800, 1 / 39916800, 1 / 479001600, 1 / 6227020800

_SQRT_HALF_BITS = np.int64(0x3FE6A09E667F3BCD)  # sqrt(1/2) as a double


@inline
def sincos(x):
    """Sine and cosine of x [rad]; within 2e-16 of the truth for |x| < 1.6e6, and meaningless beyond 1e9."""
    shifted = x * _TWO_OVER_PI + _ROUND
    quadrant = np.float64(shifted).view(np.int64)
    k = shifted - _ROUND
    r = ((x - k * _HALF_PI_1) - k * _HALF_PI_2) - k * _HALF_PI_3
    z = r * r
    s = r + r * z * (_S3 + z * (_S5 + z * (_S7 + z * (_S9 + z * (_S11 + z * (_S13 + z * _S15))))))
    c = 1.0 + z * (_C2 + z * (_C4 + z * (_C6 + z * (_C8 + z * (_C10 + z * (_C12 + z * (_C14 + z * _C16)))))))
    odd = (quadrant & 1) != 0
    sine = c if odd else s
    cosine = s if odd else c
    sine = -sine if (quadrant & 2) != 0 else sine
    cosine = -cosine if ((quadrant + 1) & 2) != 0 else cosine
    return sine, cosine


@inline
def exp(x):
    """e**x within 3e-16 relative for -700 < x < 700; arguments beyond are taken at the edge."""
    x = max(min(x, 700.0), -700.0)
    shifted = x * _ONE_OVER_LN2 + _ROUND
    exponent = np.float64(shifted).view(np.int64)
    k = shifted - _ROUND
    r = (x - k * _LN2_1) - k * _LN2_2
    tail = _E8 + r * (_E9 + r * (_E10 + r * (_E11 + r * (_E12 + r * _E13))))
    p = 1.0 + r * (1.0 + r * (_E2 + r * (_E3 + r * (_E4 + r * (_E5 + r * (_E6 + r * (_E7 + r * tail)))))))
    power_of_two = np.int64((exponent + np.int64(1023)) << np.int64(52)).view(np.float64)
    return p * power_of_two


@inline
def log(x):
    """Natural logarithm of a positive, normal x, within 4e-16 relative."""
    bits = np.float64(x).view(np.int64)
    # Split x = 2**e * m with m in [sqrt(1/2), sqrt(2)).
    shifted = bits - _SQRT_HALF_BITS
    e = shifted >> np.int64(52)
    m = np.int64(bits - (e << np.int64(52))).view(np.float64)
    # The integer e as a double, without a conversion instruction: the inverse of the rounding trick.
    k = np.int64(e + np.int64(0x4338000000000000)).view(np.float64) - _ROUND
    s = (m - 1.0) / (m + 1.0)
    z = s * s
    tail = 1 / 13 + z * (1 / 15 + z * (1 / 17 + z * (1 / 19 + z * (1 / 21))))
    p = z * (1 / 3 + z * (1 / 5 + z * (1 / 7 + z * (1 / 9 + z * (1 / 11 + z * tail)))))
    return k * _LN2_1 + (2.0 * (s + s * p) + k * _LN2_2)
