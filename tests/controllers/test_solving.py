"""The compiled solvers against LAPACK, at the edge of rank, and lane by lane; the compiled dynamics."""

import numpy as np
import pytest

from controllers import dynamics
from controllers.solving import LANES, least_squares
from fbl_gym.model import arm

COUNTS = (1, LANES - 1, LANES, 3 * LANES + 5)


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


def test_a_lane_alone_has_the_bits_it_has_in_a_batch():
    n = 2 * LANES + 7
    rows, target = deficient(n, np.full(n, 1e-3))
    together = least_squares(rows, target, 1e-7)[0]
    for i in range(n):
        lane = slice(i, i + 1)
        np.testing.assert_array_equal(least_squares(rows[lane], target[lane], 1e-7)[0][0], together[i])


@pytest.mark.parametrize("name", ["inverse_dynamics", "forward_dynamics"])
@pytest.mark.parametrize("shape", [(1, 2), (7, 2), (4, 3, 2)])
def test_compiled_dynamics_has_the_bits_of_the_arms(name, shape):
    q, v, x = np.random.default_rng(1).normal(scale=3.0, size=(3, *shape))
    geared = arm.ArmParameters(rotor=(2.0, 1.0))
    models = [geared, geared.lumped, np.tile(geared.lumped, (*shape[:-1], 1)), np.tile(geared.base, (*shape[:-1], 1))]
    for model in models:
        compiled = getattr(dynamics, name)(model, q, v, x)
        np.testing.assert_array_equal(compiled, getattr(arm, name)(model, q, v, x))


def test_an_acceleration_for_all_rows_is_broadcast():
    q, v = np.random.default_rng(1).normal(size=(2, 5, 2))
    model = arm.ArmParameters()
    torque = dynamics.inverse_dynamics(model, q, v, np.array([1.0, -2.0]))
    np.testing.assert_array_equal(torque, dynamics.inverse_dynamics(model, q, v, np.tile([1.0, -2.0], (5, 1))))
