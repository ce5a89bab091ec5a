"""Regressors against the arm's own functions."""

import numpy as np

from controllers.passivity import drift_regressor, momentum_regressor, slotine_li_regressor
from fbl_gym.model.arm import coriolis_matrix, gravity_torque, inertia_matrix, regressor


def random(n=100, k=4, seed=0):
    return np.random.default_rng(seed).uniform(-3, 3, (k, n, 2))


def test_the_regressor_agrees_with_the_skew_form():
    """Y p = M a_r + C v_r + G with the C for which dM/dt - 2 C is skew, at random states."""
    q, v, v_r, a_r = random()
    p = np.array([17.0, 3.5, 4.0, 240.0, 70.0])
    expected = np.einsum("nij,nj->ni", inertia_matrix(p, q), a_r) + gravity_torque(p, q)
    expected += np.einsum("nij,nj->ni", coriolis_matrix(p, q, v, skew=True), v_r)
    np.testing.assert_allclose(slotine_li_regressor(q, v, v_r, a_r) @ p, expected, rtol=1e-12, atol=1e-9)
    np.testing.assert_allclose(slotine_li_regressor(q, v, v, a_r), regressor(q, v, a_r), rtol=1e-12, atol=1e-12)


def test_the_momentum_form_needs_no_acceleration():
    """M v and G - C'v; and d/dt (M v) + (G - C'v) = M a + C v + G, by differences."""
    q, v, a, _ = random()
    p = np.array([17.0, 3.5, 4.0, 240.0, 70.0])
    np.testing.assert_allclose(momentum_regressor(q, v) @ p, np.einsum("nij,nj->ni", inertia_matrix(p, q), v))
    skew = np.einsum("nji,nj->ni", coriolis_matrix(p, q, v, skew=True), v)
    np.testing.assert_allclose(drift_regressor(q, v) @ p, gravity_torque(p, q) - skew, rtol=1e-12, atol=1e-9)
    h = 1e-6
    later, earlier = momentum_regressor(q + h * v, v + h * a), momentum_regressor(q - h * v, v - h * a)
    rate = (later - earlier) / (2 * h)
    np.testing.assert_allclose(rate + drift_regressor(q, v), regressor(q, v, a), rtol=1e-6, atol=1e-6)
