"""Least squares and linear systems of a few unknowns, each lane its own, compiled.

`numpy.linalg` hands the lanes to LAPACK one by one, which takes microseconds for each and has other last bits on other
machines. Here the inner loops run over lanes, so that they vectorise, and a lane has the same bits alone and in a batch.
The file calls nothing that is compiled elsewhere: Numba's cache notices a change in this file only.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from fbl_gym.arm import Array
from fbl_gym.fastmath import cached_njit

LANES = 32
"""Lanes worked on at a time: few enough that all of it stays in the processor's first cache."""

# Compiled with NumPy's rule for division: x / 0 is infinite or nan, which no comparison below takes for a good result.
# Vectors [m x lanes] and matrices [k x k x lanes] of a block of lanes.


@cached_njit
def _dot(x: Array, y: Array, found: Array) -> None:
    """found = x'y."""
    for l in range(len(found)):
        found[l] = x[0, l] * y[0, l]
    for i in range(1, len(x)):
        for l in range(len(found)):
            found[l] += x[i, l] * y[i, l]


@cached_njit
def _normalize(x: Array, length: Array) -> None:
    """length = |x|, x = x / |x|."""
    _dot(x, x, length)
    for l in range(len(length)):
        length[l] = np.sqrt(length[l])
    for i in range(len(x)):
        for l in range(len(length)):
            x[i, l] /= length[l]


@cached_njit
def _factor(a: Array, good: NDArray[np.bool_]) -> None:
    """a = L U in place, without L's ones; good stays True where U's diagonal is positive: where a is positive definite.

    Gaussian elimination (Golub and Van Loan, "Matrix Computations", 2013, §3.2 and 4.1) of a symmetric a, whose upper triangle
    need not be given.
    """
    k, lanes = len(a), len(good)
    for j in range(k):
        for l in range(lanes):
            good[l] &= a[j, j, l] > 0.0
        for i in range(j + 1, k):
            for l in range(lanes):
                a[j, i, l] = a[i, j, l]
                a[i, j, l] /= a[j, j, l]
            for c in range(j + 1, i + 1):
                for l in range(lanes):
                    a[i, c, l] -= a[i, j, l] * a[j, c, l]


@cached_njit
def least_squares(rows: Array, target: Array, weakest: float) -> tuple[Array, NDArray[np.bool_]]:
    """The x of least |rows x - target|, [n x k], and where rows tell its entries apart, [n]; elsewhere x is nan.

    They do where their smallest singular value, the columns scaled to length one, exceeds `weakest`. Gram and Schmidt's
    process, modified, on the columns and then on target is as stable as Householder's (Björck, "Numerical Methods for Least
    Squares Problems", 1996, §2.4).

    Args:
        rows: [n x m x k], m >= k.
        target: [n x m].
        weakest: well above rounding, 1e-16.
    """
    n, m, k = rows.shape
    found, rich = np.empty((n, k)), np.ones(n, dtype=np.bool_)
    for first in range(0, n, LANES):
        lanes = min(LANES, n - first)
        a, size, x = np.empty((k + 1, m, lanes)), np.empty((k, lanes)), np.empty((k, lanes))
        r, t, s = np.empty((k, k + 1, lanes)), np.empty((k, k, lanes)), np.empty((k, k, lanes))
        for l in range(lanes):
            for i in range(m):
                for j in range(k):
                    a[j, i, l] = rows[first + l, i, j]
                a[k, i, l] = target[first + l, i]

        # a = Q R: each column to length one, and its direction taken out of those that follow, target the last.
        for j in range(k):
            _normalize(a[j], size[j])
        for j in range(k):
            _normalize(a[j], r[j, j])
            for c in range(j + 1, k + 1):
                _dot(a[j], a[c], r[j, c])
                for i in range(m):
                    for l in range(lanes):
                        a[c, i, l] -= a[j, i, l] * r[j, c, l]
        # T R = I
        for i in range(k):
            for l in range(lanes):
                t[i, i, l] = 1.0 / r[i, i, l]
            for j in range(i + 1, k):
                _dot(t[i, i:j], r[i:j, j], t[i, j])
                for l in range(lanes):
                    t[i, j, l] /= -r[j, j, l]
        # x = T Q'target
        for i in range(k):
            _dot(t[i, i:], r[i:, k], x[i])
            for l in range(lanes):
                found[first + l, i] = x[i, l] / size[i, l]
        # The smallest singular value is 1 / |T|: it exceeds `weakest` where I - weakest^2 T T' is positive definite.
        for i in range(k):
            for j in range(i + 1):
                _dot(t[i, i:], t[j, i:], s[i, j])
                for l in range(lanes):
                    s[i, j, l] = (1.0 if i == j else 0.0) - weakest * weakest * s[i, j, l]
        _factor(s, rich[first : first + lanes])

    for l in range(n):
        if not rich[l]:
            found[l] = np.nan
    return found, rich


@cached_njit
def accumulate(
    a: Array, b: Array, rows: Array, target: Array, keep: float, weight: float, where: NDArray[np.bool_]
) -> tuple[Array, Array]:
    """keep a + weight rows'rows, [n x k x k], and keep b + weight rows'target, [n x k]: the sums of weighted least squares.

    Args:
        a, b: the sums so far, [n x k x k] and [n x k].
        rows, target: what joins them, [n x m x k] and [n x m].
        keep: factor on what was there.
        weight: of what joins.
        where: the lanes whose sums change [n].
    """
    n, m, k = rows.shape
    a, b = a.copy(), b.copy()
    for l in range(n):
        if where[l]:
            for i in range(k):
                for j in range(k):
                    product = 0.0
                    for s in range(m):
                        product += rows[l, s, i] * rows[l, s, j]
                    a[l, i, j] = keep * a[l, i, j] + weight * product
                product = 0.0
                for s in range(m):
                    product += rows[l, s, i] * target[l, s]
                b[l, i] = keep * b[l, i] + weight * product
    return a, b


@cached_njit
def exceeds(a: Array, floor: float) -> NDArray[np.bool_]:
    """Where the smallest eigenvalue exceeds `floor`: where a - floor I is positive definite, [n].  a: symmetric [n x k x k]."""
    n, k, _ = a.shape
    found = np.ones(n, dtype=np.bool_)
    for first in range(0, n, LANES):
        lanes = min(LANES, n - first)
        part = np.empty((k, k, lanes))
        for l in range(lanes):
            for i in range(k):
                for j in range(i + 1):
                    part[i, j, l] = a[first + l, i, j]
                part[i, i, l] -= floor
        _factor(part, found[first : first + lanes])
    return found


@cached_njit
def solve(a: Array, b: Array) -> Array:
    """The x of a x = b, [n x k].  a: symmetric, positive definite, [n x k x k]; b: [n x k]."""
    n, k = b.shape
    found = np.empty((n, k))
    for first in range(0, n, LANES):
        lanes = min(LANES, n - first)
        part, x = np.empty((k, k, lanes)), np.empty((k, lanes))
        for l in range(lanes):
            for i in range(k):
                for j in range(i + 1):
                    part[i, j, l] = a[first + l, i, j]
                x[i, l] = b[first + l, i]
        _factor(part, np.ones(lanes, dtype=np.bool_))
        # L y = b, then U x = y
        for i in range(k):
            for j in range(i):
                for l in range(lanes):
                    x[i, l] -= part[i, j, l] * x[j, l]
        for i in range(k - 1, -1, -1):
            for j in range(i + 1, k):
                for l in range(lanes):
                    x[i, l] -= part[i, j, l] * x[j, l]
            for l in range(lanes):
                x[i, l] /= part[i, i, l]
                found[first + l, i] = x[i, l]
    return found
