"""The parameter estimator of §4.1 against the paper's own equations."""

import numpy as np
import pytest

from controllers.estimator import estimate, lumped_of, plausible, point_masses
from fbl_gym import TABLE_1, ArmParameters
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
    lumped, _ = estimate(regressor(q, v, a), torque, 1e-7)
    for i in range(20):
        desired = np.array([forward_dynamics(TABLE_1, q[i, s], v[i, s], torque[i, s]) for s in range(3)])
        k, printed = printed_estimate(q[i], v[i], a[i], desired, TABLE_1)
        assert np.linalg.matrix_rank(k) == 5
        np.testing.assert_allclose(printed, lumped[i, [1, 2, 4]] / [1, 1, 9.81], rtol=1e-6)


def test_saturation_biases_the_printed_form_only():
    """The printed e compares with a desired acceleration that a saturated torque cannot give."""
    q, v, _, desired_torque = samples(REAL, 20)
    torque = np.clip(desired_torque, -150, 150)
    a = forward_dynamics(REAL, q, v, torque)
    lumped, accepted = estimate(regressor(q, v, a), torque, 1e-7)
    assert accepted.all()
    np.testing.assert_allclose(lumped, np.broadcast_to(REAL.lumped, lumped.shape), rtol=1e-6)
    wrong = []
    for i in range(20):
        desired = np.array([forward_dynamics(TABLE_1, q[i, s], v[i, s], desired_torque[i, s]) for s in range(3)])
        _, printed = printed_estimate(q[i], v[i], a[i], desired, TABLE_1)
        wrong.append(np.abs(printed / (REAL.lumped[[1, 2, 4]] / [1, 1, 9.81]) - 1).max())
    assert np.median(wrong) > 0.1


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
