"""The two-joint problem of sticking against a convex solver."""

import numpy as np
import pytest
from numba import njit
from scipy.optimize import lsq_linear

from fbl_gym.kernel.arm.friction import resist


@njit
def solve(m, g, b, out):
    for i in range(len(m)):
        out[i] = resist(m[i, 0], m[i, 1], m[i, 2], g[i, 0], g[i, 1], b[i, 0], b[i, 1])


def test_nine_cases_solve_the_convex_problem():
    """SciPy's bounded least squares gives the friction f in the box with the least energy in M^-1/2 (g - f)."""
    rng = np.random.default_rng(0)
    n = 200
    root = rng.normal(size=(n, 2, 2)) + 2 * np.eye(2)
    matrix = root @ root.transpose(0, 2, 1)
    m = np.stack([matrix[:, 0, 0], matrix[:, 0, 1], matrix[:, 1, 1]], axis=1)
    g, b = rng.normal(size=(n, 2)) * 3, rng.uniform(0, 3, (n, 2))
    b[:20, 0], b[20:40, 1], g[40:60, 0] = 0.0, 0.0, b[40:60, 0]
    out = np.empty((n, 4))
    solve(m, g, b, out)
    cases = set()
    for i in range(n):
        w, f = out[i, :2], out[i, 2:]
        cases.add((np.sign(w[0]), np.sign(w[1])))
        np.testing.assert_allclose(matrix[i] @ w + f, g[i], atol=1e-9)
        whiten = np.linalg.inv(np.linalg.cholesky(matrix[i]))
        best = lsq_linear(whiten, whiten @ g[i], (-b[i] - 1e-12, b[i] + 1e-12), method="bvls", tol=1e-14).x
        np.testing.assert_allclose(f, best, atol=1e-6)
        # Complementarity: a joint that moves has its full friction, against the motion.
        for joint in (0, 1):
            assert abs(f[joint]) <= b[i, joint] + 1e-9
            if w[joint] != 0:
                assert f[joint] == pytest.approx(np.sign(w[joint]) * b[i, joint], abs=1e-9)
    assert len(cases) == 9


def problems(n):
    """Return random inertias m [n x 3], loads g [n x 2] and friction bounds b [n x 2] over four decades."""
    rng = np.random.default_rng(1)
    (m1, m2), (L1, L2) = rng.uniform(0.1, 30, (2, n)), 10 ** rng.uniform(-1, 1, (2, n))
    c2 = np.cos(rng.uniform(-np.pi, np.pi, n))
    m12 = m2 * L2**2 + m2 * L1 * L2 * c2
    m = np.stack([m1 * L1**2 + m2 * L1**2 + m2 * L1 * L2 * c2 + m12, m12, m2 * L2**2], axis=1)
    b = 10 ** rng.uniform(-2, 2, (n, 2))
    return m, 3 * b * rng.normal(size=(n, 2)), b


@pytest.mark.parametrize("joint", [0, 1])
def test_the_solution_is_continuous_between_cases(joint):
    """The solution of a strictly convex problem depends continuously on its load.

    A joint whose load is within a few roundings of its friction bound is at rest, to rounding. The other
    slides or rests as if it were alone.
    """
    m, g, b = problems(50_000)
    rng = np.random.default_rng(2)
    other = 1 - joint
    slide = np.sign(g[:, other]) * np.maximum(np.abs(g[:, other]) - b[:, other], 0.0) / m[:, 2 * other]
    edge = rng.choice([-1.0, 1.0], len(m)) * b[:, joint] + m[:, 1] * slide
    g[:, joint] = edge * (1 + rng.integers(-4, 5, len(m)) * 2.0**-53)
    out = np.empty((len(m), 4))
    solve(m, g, b, out)
    size = (np.abs(g) + b).sum(axis=1)
    spread = m[:, 0] * m[:, 2] / (m[:, 0] * m[:, 2] - m[:, 1] ** 2)
    tolerance = 1e-12 * spread[:, None] * size[:, None] / np.minimum(m[:, 0], m[:, 2])[:, None]
    right = np.zeros((len(m), 2))
    right[:, other] = slide
    assert np.all(np.abs(out[:, :2] - right) <= tolerance)
