"""The regulator against value iteration, the cost of its closed loop and its poles; the law against its linear equation."""

import numpy as np
import pytest
from scipy.linalg import eigvals, solve_discrete_lyapunov

import controllers
from controllers.kalman import gains
from controllers.lqg import plant, regulator
from fbl_gym import TwoLinkArmEnv
from tests.controllers.closed_loop import tracking

STILL = {"kind": "minimum-jerk", "points": ((-1.0, 0.5),)}
WEIGHTS = [(3000.0, 200.0, 40.0), (500.0, 100.0, 10.0), (400.0, 400.0, 1.0)]


def cost(k, dt, weights):
    """P of the cost x' P x that any stabilising gain K has, by Lyapunov's equation: P = A' P A + Q + K' K, A = F - G K."""
    f, g = plant(dt)
    a = f - g @ k[None]
    assert np.abs(np.linalg.eigvals(a)).max() < 1.0
    return solve_discrete_lyapunov(a.T, np.diag(weights) ** 2 + np.outer(k, k))


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


@pytest.mark.parametrize("weights", WEIGHTS)
def test_the_gain_has_the_least_cost(weights):
    best = regulator(0.01, *weights)
    least = np.linalg.eigvalsh(cost(best, 0.01, weights))
    rng = np.random.default_rng(0)
    for _ in range(50):
        other = best * (1.0 + 0.02 * rng.normal(size=3))
        more = cost(other, 0.01, weights) - cost(best, 0.01, weights)
        assert np.linalg.eigvalsh(more).min() > -1e-9 * least.max()


@pytest.mark.parametrize("weights", WEIGHTS)
def test_the_poles_are_the_stable_ones_of_the_symplectic_pencil(weights):
    dt = 0.01
    f, g = plant(dt)
    zero, eye = np.zeros((3, 3)), np.eye(3)
    left = np.block([[f, zero], [-(np.diag(weights) ** 2), eye]])
    right = np.block([[eye, g @ g.T], [zero, f.T]])
    z = eigvals(left, right)
    expected = np.sort_complex(z[np.abs(z) < 1.0])
    poles = np.sort_complex(np.linalg.eigvals(f - g @ regulator(dt, *weights)[None]))
    np.testing.assert_allclose(poles, expected, rtol=1e-4)


def test_gains_at_a_fast_rate_are_the_continuous_ones():
    """As dt goes to zero: K = (integral, position, sqrt(velocity^2 + 2 position)), the last two without integral action."""
    k = regulator(1e-5, 700.0, 1e-9, 1e-9)
    assert k[0] == pytest.approx(700.0, rel=1e-3)
    np.testing.assert_allclose(regulator(1e-5, 1e-6, 100.0, 10.0)[1:], [100.0, np.sqrt(300.0)], rtol=1e-3)


def test_the_loop_is_regulator_and_filter():
    """Exact model, 1 kHz: the error is that of x = (F - G K) x, the filter's error having nothing to add at rest."""
    dt = 1e-3
    env = TwoLinkArmEnv(
        actuator=None, action="torque", reference=STILL, initial_error=(-0.2, 0.0), control_dt=dt, physics_dt=dt
    )
    policy = controllers.make("lqg", env, integral=300.0, position=60.0, velocity=6.0)
    errors = tracking(policy, env, 1999)[0]
    f, g = plant(dt)
    a, x, expected = f - g @ policy.gain[:1], np.array([0.0, 0.2, 0.0]), []
    for _ in range(2000):
        expected.append(x[1])
        x = a @ x
    assert np.abs(errors - np.transpose([expected, np.zeros(2000)])).max() < 0.02 * 0.2


def test_regulator_and_filter_keep_their_poles_together():
    """Regulator and filter together have the poles of each: those of F - G K and of (1 - L H) F."""
    dt = 0.01
    f, g = plant(dt)
    k, gain = regulator(dt, *WEIGHTS[0]), gains(dt, 0.5, 5e-3)[-1]
    # x = (z, e, e'), and the filter's error d of (e, e'): u = -K x + K d, d = (1 - L H) F d.
    filter_poles = (np.eye(2) - np.outer(gain, [1.0, 0.0])) @ f[1:, 1:]
    loop = np.block([[f - g @ k[None], g @ k[None, 1:]], [np.zeros((2, 3)), filter_poles]])
    assert np.abs(np.linalg.eigvals(loop)).max() < 1.0
    expected = np.concatenate([np.linalg.eigvals(f - g @ k[None]), np.linalg.eigvals(filter_poles)])
    np.testing.assert_allclose(np.sort_complex(np.linalg.eigvals(loop)), np.sort_complex(expected), rtol=1e-6)


def test_integral_action_removes_a_load_in_spite_of_a_biased_accelerometer():
    env = TwoLinkArmEnv(
        sensors=("position", "acceleration"),
        reference=STILL,
        disturbance={"kind": "array", "torque": ((30.0, 10.0),)},
        noise={"acceleration": {"bias": 0.5}},
        duration=20.0,
    )
    errors, _ = tracking(controllers.make("lqg", env), env, 1999)
    assert np.abs(errors[-1]).max() < 1e-5
