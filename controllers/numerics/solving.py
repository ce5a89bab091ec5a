"""Compiled least squares of a few unknowns, one system for each lane.

LAPACK differs in the last bits between machines. Here a lane has the same bits on each of them,
alone and in a batch. The file calls nothing that is compiled elsewhere, because Numba's cache
notices a change in this file only.
"""

import numpy as np
from numpy.typing import NDArray

from fbl_gym.kernel.maths.fastmath import cached_njit
from fbl_gym.model.arm import Array


@cached_njit
def _dot(x: Array, y: Array) -> float:
    """Return x'y."""
    total = x[0] * y[0]
    for i in range(1, len(x)):
        total += x[i] * y[i]
    return total


@cached_njit
def least_squares(rows: Array, target: Array, weakest: float) -> tuple[Array, NDArray[np.bool_]]:
    """Return the x of least |rows x - target| [n x k], and where `rows` determine it [n].

    Rows are [n x m x k] with m >= k, and the target is [n x m]. Rows determine x where their
    smallest singular value, the columns scaled to length one, exceeds `weakest`, which must be well
    above rounding, 1e-16. Elsewhere x is nan. The modified Gram-Schmidt process on the columns and
    then on target is as stable as Householder's (Björck, "Numerical Methods for Least Squares
    Problems", 1996, §2.4).
    """
    n, m, k = rows.shape
    solution, rich = np.empty((n, k)), np.ones(n, dtype=np.bool_)
    a, size, r, t, s = np.empty((k + 1, m)), np.empty(k), np.empty((k, k + 1)), np.empty((k, k)), np.empty((k, k))
    # Division follows NumPy's rule: x / 0 is infinite or nan, which no comparison below accepts.
    for lane in range(n):
        a[:k], a[k] = rows[lane].T, target[lane]
        # a = Q R: scale each column to length one and remove its direction from the later ones.
        for j in range(k):
            size[j] = np.sqrt(_dot(a[j], a[j]))
            a[j] /= size[j]
        for j in range(k):
            r[j, j] = np.sqrt(_dot(a[j], a[j]))
            a[j] /= r[j, j]
            for c in range(j + 1, k + 1):
                r[j, c] = _dot(a[j], a[c])
                for i in range(m):
                    a[c, i] -= a[j, i] * r[j, c]
        # T R = I, x = T Q'target
        for i in range(k):
            t[i, i] = 1.0 / r[i, i]
            for j in range(i + 1, k):
                t[i, j] = _dot(t[i, i:j], r[i:j, j]) / -r[j, j]
            solution[lane, i] = _dot(t[i, i:], r[i:, k]) / size[i]
        # The smallest singular value 1 / |T| exceeds `weakest` where I - weakest^2 T T' > 0.
        for i in range(k):
            for j in range(i + 1):
                s[i, j] = (1.0 if i == j else 0.0) - weakest * weakest * _dot(t[i, i:], t[j, i:])
        # It is positive definite where U of s = L U has a positive diagonal (Golub and Van Loan,
        # "Matrix Computations", 2013, §3.2 and 4.1). Only the lower triangle of s is read.
        for j in range(k):
            rich[lane] &= s[j, j] > 0.0
            for i in range(j + 1, k):
                s[j, i] = s[i, j]
                s[i, j] /= s[j, j]
                for c in range(j + 1, i + 1):
                    s[i, c] -= s[i, j] * s[j, c]
        if not rich[lane]:
            solution[lane] = np.nan
    return solution, rich
