"""L1 adaptive control against its error equation."""

import numpy as np
import pytest

import controllers
from fbl_gym import TABLE_1, TwoLinkArmEnv
from fbl_gym.model.arm import inertia_matrix
from tests.controllers.closed_loop import FAST, loaded, response, tracking


@pytest.mark.parametrize("pole", [5.0, 200.0])
def test_the_error_equation_under_a_constant_load(pole):
    """Exact model, 1 kHz: e'' + 2 w e' + w^2 e = f - z with z' = g (k f - z) and k = p dt / (exp(p dt) - 1)."""
    w, g, load, dt = 8.0, 12.0, np.array([20.0, 6.0]), 1e-3
    env = TwoLinkArmEnv(**FAST | loaded(*load))
    policy = controllers.make("l1-adaptive", env, frequency=w, bandwidth=g, pole=pole)
    errors, states = tracking(policy, env, 1000)
    share = pole * dt / np.expm1(pole * dt)
    # x = (e, e', z, f), in units of f = M^-1 d.
    rates = np.array([[0, 1, 0, 0], [-w * w, -2 * w, -1, 1], [0, 0, -g, g * share], [0, 0, 0, 0]])
    expected = response(rates, [0.0, 0.0, 0.0, 1.0], dt, 1000)
    f = np.linalg.solve(inertia_matrix(TABLE_1, (-1.0, 0.5)), load)
    assert np.abs(errors - np.outer(expected, f)).max() < 0.03 * np.abs(np.outer(expected, f)).max()
    np.testing.assert_allclose(states[-1][1][0], -share * f, rtol=0.01)
