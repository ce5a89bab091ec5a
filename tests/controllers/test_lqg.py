"""The regulator against value iteration and its continuous limit; the law against its linear equation."""

import numpy as np
import pytest

import controllers
from controllers.laws.lqg import plant, regulator
from fbl_gym import TwoLinkArmEnv
from tests.controllers.closed_loop import EXACT, tracking

WEIGHTS = [(3000.0, 200.0, 40.0), (500.0, 100.0, 10.0), (400.0, 400.0, 1.0)]


@pytest.mark.parametrize("weights", WEIGHTS)
@pytest.mark.parametrize("dt", [1e-3, 1e-2])
def test_value_iteration_finds_the_same_gain(weights, dt):
    """The Riccati difference equation, iterated from P = Q, without scipy's solver."""
    f, g = plant(dt)
    q = np.diag(weights) ** 2
    p = q
    for _ in range(round(30.0 / dt)):
        k = (g.T @ p @ f / (1.0 + g.T @ p @ g))[0]
        p = q + f.T @ p @ (f - g @ k[None])
    np.testing.assert_allclose(regulator(dt, *weights), k, rtol=1e-6)


def test_the_loop_is_regulator_and_filter():
    """Exact model, 1 kHz: the error is that of x = (F - G K) x, the filter's error having nothing to add at rest."""
    dt = 1e-3
    env = TwoLinkArmEnv(**EXACT, initial_error=(-0.2, 0.0))
    policy = controllers.make("lqg", env, integral=300.0, position=60.0, velocity=6.0)
    errors = tracking(policy, env, 1999)[0]
    f, g = plant(dt)
    a, x, expected = f - g @ policy.gain[:1], np.array([0.0, 0.2, 0.0]), []
    for _ in range(2000):
        expected.append(x[1])
        x = a @ x
    assert np.abs(errors - np.transpose([expected, np.zeros(2000)])).max() < 0.02 * 0.2
