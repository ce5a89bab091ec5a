"""The compiled solvers against LAPACK, at the edge of rank, and lane by lane."""

import numpy as np
import pytest

from controllers.solving import LANES, accumulate, exceeds, least_squares, solve

COUNTS = (1, LANES - 1, LANES, 3 * LANES + 5)


def systems(n, k, seed=0):
    """Symmetric matrices [n x k x k] with eigenvalues from 1e-3 to 1e3, and right-hand sides [n x k]."""
    rng = np.random.default_rng(seed)
    turn, _ = np.linalg.qr(rng.normal(size=(n, k, k)))
    a = (turn * 10.0 ** rng.uniform(-3, 3, (n, 1, k))) @ turn.transpose(0, 2, 1)
    return 0.5 * (a + a.transpose(0, 2, 1)), rng.normal(size=(n, k))


def deficient(n, weak, seed=0):
    """Rows [n x 6 x 5], four of whose singular values are between 0.3 and 3, and the fifth is `weak` [n]; and targets."""
    rng = np.random.default_rng(seed)
    u, v = np.linalg.qr(rng.normal(size=(n, 6, 5)))[0], np.linalg.qr(rng.normal(size=(n, 5, 5)))[0]
    s = np.concatenate([rng.uniform(0.3, 3.0, (n, 4)), np.reshape(weak, (n, 1))], axis=1)
    return (u * s[:, None]) @ v, rng.normal(size=(n, 6))


def weakness(rows):
    """The smallest singular value [n], the columns scaled to length one."""
    return np.linalg.svd(rows / np.linalg.norm(rows, axis=1, keepdims=True), compute_uv=False)[:, -1]


@pytest.mark.parametrize("n", COUNTS)
def test_least_squares_agrees_with_lapack(n):
    rows, target = deficient(n, np.full(n, 0.1))
    solution, rich = least_squares(rows, target, 1e-7)
    assert rich.all()
    expected = [np.linalg.lstsq(a, b, rcond=None)[0] for a, b in zip(rows, target, strict=True)]
    np.testing.assert_allclose(solution, expected, rtol=1e-10, atol=1e-12)


def test_nearly_dependent_columns_are_as_accurate_as_with_householder():
    """A consistent system with singular values down to 1e-6: an error of rounding times condition, as Householder's has."""
    rows, _ = deficient(200, np.full(200, 1e-6))
    x = np.random.default_rng(1).normal(size=(200, 5))
    solution, _ = least_squares(rows, np.einsum("nij,nj->ni", rows, x), 1e-7)
    assert np.abs(solution - x).max() < 1e-15 * 3e6 * 10


def test_the_smallest_singular_value_decides():
    """Within a millionth of it, near the default threshold, where the squares, Y'Y, would tell nothing."""
    rows, target = deficient(200, np.full(200, 1e-7))
    for i, weak in enumerate(weakness(rows)):
        lane = slice(i, i + 1)
        solution, rich = least_squares(rows[lane], target[lane], weak * (1.0 - 1e-6))
        assert rich.all()
        assert np.isfinite(solution).all()
        solution, rich = least_squares(rows[lane], target[lane], weak * (1.0 + 1e-6))
        assert not rich.any()
        assert np.isnan(solution).all()


def test_columns_that_are_zero_equal_or_not_finite_are_refused():
    rows, target = deficient(4, np.full(4, 0.1))
    rows[1, :, 2] = 0.0
    rows[2, :, 3] = rows[2, :, 1]
    rows[3, 0, 0] = np.nan
    _, rich = least_squares(rows, target, 1e-7)
    np.testing.assert_array_equal(rich, [True, False, False, False])


@pytest.mark.parametrize("n", COUNTS)
def test_the_smallest_eigenvalue_decides(n):
    a, _ = systems(n, 9)
    smallest = np.linalg.eigvalsh(a)[:, 0]
    for floor in (1e-3, 3e-3, 1e-2):
        np.testing.assert_array_equal(exceeds(a, floor), smallest > floor)


def test_sums_change_only_in_the_chosen_lanes():
    rng = np.random.default_rng(0)
    (a, b), rows, target = systems(5, 9), rng.normal(size=(5, 2, 9)), rng.normal(size=(5, 2))
    where = np.array([True, False, True, True, False])
    before = a.copy(), b.copy()
    more_a, more_b = accumulate(a, b, rows, target, 0.9, 0.01, where)
    for lane, changes in enumerate(where):
        row, tau = rows[lane], target[lane]
        np.testing.assert_allclose(more_a[lane], 0.9 * a[lane] + 0.01 * row.T @ row if changes else a[lane], rtol=1e-12)
        np.testing.assert_allclose(more_b[lane], 0.9 * b[lane] + 0.01 * row.T @ tau if changes else b[lane], rtol=1e-12)
    np.testing.assert_array_equal(a, before[0])
    np.testing.assert_array_equal(b, before[1])


@pytest.mark.parametrize("n", COUNTS)
def test_solve_agrees_with_lapack(n):
    a, b = systems(n, 9)
    expected = np.linalg.solve(a, b[..., None])[..., 0]
    np.testing.assert_allclose(solve(a, b), expected, rtol=1e-8, atol=1e-8)


def test_a_lane_alone_has_the_bits_it_has_in_a_batch():
    n = 2 * LANES + 7
    rows, target = deficient(n, np.full(n, 1e-3))
    a, b = systems(n, 9)
    together, alike = least_squares(rows, target, 1e-7)[0], solve(a, b)
    for i in range(n):
        lane = slice(i, i + 1)
        np.testing.assert_array_equal(least_squares(rows[lane], target[lane], 1e-7)[0][0], together[i])
        np.testing.assert_array_equal(solve(a[lane], b[lane])[0], alike[i])
