"""Compiled least squares of a few unknowns, one system for each lane.

`numpy.linalg` passes the lanes to LAPACK one by one, which is slow and differs in the last bits
between machines. Here the inner loops run over lanes and vectorise, and a lane has the same bits
alone and in a batch. The file calls nothing that is compiled elsewhere in `controllers`, because
the cache of compiled code notices changes in this file and in `fbl_gym` only.
"""

import numpy as np
from numpy.typing import NDArray

from fbl_gym.kernel.maths.fastmath import cached_njit
from fbl_gym.model.arm import Array

#: Lanes that are solved together: few enough for their data to stay in the first cache.
TOGETHER = 32

# Division follows NumPy's rule: x / 0 is infinite or nan, and no comparison below accepts those.
# Vectors [m x lanes] and matrices [k x k x lanes] of a block of lanes.


@cached_njit
def _dot(x: Array, y: Array, product: Array) -> None:
    """Set product = x'y."""
    for lane in range(len(product)):
        product[lane] = x[0, lane] * y[0, lane]
    for i in range(1, len(x)):
        for lane in range(len(product)):
            product[lane] += x[i, lane] * y[i, lane]


@cached_njit
def _normalize(x: Array, length: Array) -> None:
    """Set length = |x| and x = x / |x|."""
    _dot(x, x, length)
    for lane in range(len(length)):
        length[lane] = np.sqrt(length[lane])
    for i in range(len(x)):
        for lane in range(len(length)):
            x[i, lane] /= length[lane]


@cached_njit
def _factor(a: Array, good: NDArray[np.bool_]) -> None:
    """Set a = L U in place, without L's ones, and good to False where a is not positive definite.

    Gaussian elimination (Golub and Van Loan, "Matrix Computations", 2013, §3.2 and 4.1) of a
    symmetric a. Only the lower triangle of a is read. a is positive definite where U's diagonal is
    positive.
    """
    k, lanes = len(a), len(good)
    for j in range(k):
        for lane in range(lanes):
            good[lane] &= a[j, j, lane] > 0.0
        for i in range(j + 1, k):
            for lane in range(lanes):
                a[j, i, lane] = a[i, j, lane]
                a[i, j, lane] /= a[j, j, lane]
            for c in range(j + 1, i + 1):
                for lane in range(lanes):
                    a[i, c, lane] -= a[i, j, lane] * a[j, c, lane]


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
    for first in range(0, n, TOGETHER):
        lanes = min(TOGETHER, n - first)
        a, size, x = np.empty((k + 1, m, lanes)), np.empty((k, lanes)), np.empty((k, lanes))
        r, t, s = np.empty((k, k + 1, lanes)), np.empty((k, k, lanes)), np.empty((k, k, lanes))
        for lane in range(lanes):
            for i in range(m):
                for j in range(k):
                    a[j, i, lane] = rows[first + lane, i, j]
                a[k, i, lane] = target[first + lane, i]

        # a = Q R: scale each column to length one and remove its direction from the later ones.
        for j in range(k):
            _normalize(a[j], size[j])
        for j in range(k):
            _normalize(a[j], r[j, j])
            for c in range(j + 1, k + 1):
                _dot(a[j], a[c], r[j, c])
                for i in range(m):
                    for lane in range(lanes):
                        a[c, i, lane] -= a[j, i, lane] * r[j, c, lane]
        # T R = I
        for i in range(k):
            for lane in range(lanes):
                t[i, i, lane] = 1.0 / r[i, i, lane]
            for j in range(i + 1, k):
                _dot(t[i, i:j], r[i:j, j], t[i, j])
                for lane in range(lanes):
                    t[i, j, lane] /= -r[j, j, lane]
        # x = T Q'target
        for i in range(k):
            _dot(t[i, i:], r[i:, k], x[i])
            for lane in range(lanes):
                solution[first + lane, i] = x[i, lane] / size[i, lane]
        # The smallest singular value 1 / |T| exceeds `weakest` where I - weakest^2 T T' > 0.
        for i in range(k):
            for j in range(i + 1):
                _dot(t[i, i:], t[j, i:], s[i, j])
                for lane in range(lanes):
                    s[i, j, lane] = (1.0 if i == j else 0.0) - weakest * weakest * s[i, j, lane]
        _factor(s, rich[first : first + lanes])

    for lane in range(n):
        if not rich[lane]:
            solution[lane] = np.nan
    return solution, rich
