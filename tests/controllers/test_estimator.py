"""The parameter estimator of §4.1 against the paper's own equations; its compiled solvers and dynamics."""

import numpy as np
import pytest

from controllers.numerics import dynamics
from controllers.numerics.solving import TOGETHER, least_squares
from controllers.paper.adaptive import estimate, lumped_of, plausible, point_masses
from fbl_gym import TABLE_1, ArmParameters
from fbl_gym.model import arm
from fbl_gym.model.arm import forward_dynamics, inertia_matrix, inverse_dynamics, regressor

REAL = ArmParameters(m1=31.0, m2=9.0, L1=1.1, L2=0.4)


def samples(arm, n=50, seed=0):
    """Three generic samples of n motions: q, v, a and the torque that belongs to them, [n x 3 x 2] each."""
    rng = np.random.default_rng(seed)
    q, v = rng.uniform(-3, 3, (n, 3, 2)), rng.uniform(-3, 3, (n, 3, 2))
    torque = rng.uniform(-300, 300, (n, 3, 2))
    return q, v, forward_dynamics(arm, q, v, torque), torque


def printed_k(q, v, a, g=9.81):
    """Equation (33), written out from the paper."""
    c2, s2 = np.cos(q[1]), np.sin(q[1])
    c1, c12 = np.cos(q[0]), np.cos(q[0] + q[1])
    both = a[0] + a[1]
    fourth = (2 * a[0] + a[1]) * c2 - 2 * v[0] * v[1] * s2 - v[1] ** 2 * s2
    first = [a[0], a[0], both, fourth, g * c1, g * c1, g * c12]
    return np.array([first, [0.0, 0.0, both, a[0] * c2 + v[0] ** 2 * s2, 0.0, 0.0, g * c12]])


def printed_estimate(q, v, a, desired, nominal):
    """Equations (36) and (37) for three samples, with the e that (37) leaves out: X3, X4 and X7, then (39)'s Y1, Y2, Y3."""
    k = np.vstack([printed_k(q[i], v[i], a[i]) for i in range(3)])
    right = np.concatenate([inertia_matrix(nominal, q[i]) @ (desired[i] - a[i]) for i in range(3)])
    x = -np.linalg.pinv(k) @ right
    m2, L1, L2 = nominal.m2, nominal.L1, nominal.L2
    return k, np.array([m2 * L2**2 - x[2], m2 * L1 * L2 - x[3], m2 * L2 - x[6]])


def test_the_estimate_is_the_papers():
    """(32)-(39) as printed, where the torque is the nominal mapping's: the same Y1, Y2, Y3, and rank five as (38) says."""
    q, v, a, torque = samples(REAL, 20)
    lumped, accepted = estimate(regressor(q, v, a), torque, 1e-7)
    assert accepted.all()
    np.testing.assert_allclose(lumped, np.broadcast_to(REAL.lumped, lumped.shape), rtol=1e-6)
    for i in range(20):
        desired = np.array([forward_dynamics(TABLE_1, q[i, s], v[i, s], torque[i, s]) for s in range(3)])
        k, printed = printed_estimate(q[i], v[i], a[i], desired, TABLE_1)
        assert np.linalg.matrix_rank(k) == 5
        np.testing.assert_allclose(printed, lumped[i, [1, 2, 4]] / [1, 1, 9.81], rtol=1e-6)


def test_both_forms_of_equation_39_agree():
    lumped = REAL.lumped[None]
    exact = [[31.0, 9.0, 1.1, 0.4]]
    np.testing.assert_allclose(point_masses(lumped), exact, rtol=1e-12)
    np.testing.assert_allclose(point_masses(lumped, total_mass=40.0), exact, rtol=1e-12)
    np.testing.assert_allclose(lumped_of(np.array(exact)), lumped, rtol=1e-12)


def test_at_rest_no_estimate_is_accepted():
    """At rest the rank is two: the samples tell the gravity torques and nothing of the inertia."""
    q = np.broadcast_to(np.array([0.3, 0.5]), (1, 3, 2))
    still = np.zeros((1, 3, 2))
    _, accepted = estimate(regressor(q, still, still), inverse_dynamics(REAL, q, still, still), 1e-7)
    assert not accepted.any()


@pytest.mark.parametrize("i", range(5))
def test_implausible_parameters_are_refused(i):
    lumped = np.stack([REAL.lumped, REAL.lumped])
    lumped[1, i] *= -1.0
    np.testing.assert_array_equal(plausible(lumped), [True, False])
    lumped[1, i] = np.nan
    np.testing.assert_array_equal(plausible(lumped), [True, False])


COUNTS = (1, TOGETHER - 1, TOGETHER, 3 * TOGETHER + 5)


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
    n = 2 * TOGETHER + 7
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
