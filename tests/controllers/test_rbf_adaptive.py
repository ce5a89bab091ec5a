"""Neural adaptive control against its Lyapunov function, the bound of its weights, and a gravity to learn."""

import numpy as np

import controllers
from controllers.laws.rbf_adaptive import FEATURES, NODES, RbfState, bumps, features
from fbl_gym import TABLE_1, TwoLinkArmEnv
from fbl_gym.model.arm import gravity_torque, inertia_matrix
from tests.controllers.closed_loop import EXACT, error_of, loop


def test_the_lyapunov_function_decreases_by_its_derivative():
    """Exact model, so W* = 0, and weights that start wrong: V falls, by the integral of k s' M s."""
    dt = 1e-3
    env = TwoLinkArmEnv(**EXACT, initial_error=(-0.2, 0.3))
    policy = controllers.make("rbf-adaptive", env, rate=150.0, forget=0.0)
    weights = np.random.default_rng(0).normal(size=(1, 2, FEATURES))
    values, loss, d = [], [0.0], inertia_matrix(TABLE_1, (0.0, np.pi / 2))
    for observation, state, *_ in loop(policy, env, 1000, state=RbfState(weights)):
        q, v = observation[0:2], observation[2:4]
        s = 10.0 * error_of(env) - v
        m, w = inertia_matrix(TABLE_1, q), state.weights[0]
        values.append(0.5 * s @ m @ s + 0.5 / 150.0 * np.trace(d @ w @ w.T))
        loss.append(loss[-1] + dt * 15.0 * s @ m @ s)
    values = np.array(values)
    assert np.diff(values).max() < 1e-4 * values[0]
    np.testing.assert_allclose(values[0] - values, loss[:-1], atol=0.03 * values[0])


def test_weights_stay_bounded_under_noise():
    """e-modification: |W_i| <= max |phi| / forget, under noise without end or excitation."""
    env = TwoLinkArmEnv()
    policy = controllers.make("rbf-adaptive", env, forget=0.2, rate=1000.0)
    rng, state, most, largest = np.random.default_rng(0), None, 0.0, 0.0
    for _ in range(2000):
        observation = np.concatenate([[0.3, -0.2], [-5.0, 4.0], np.zeros(2), [0.1, 0.4], np.zeros(2), 3.0 * np.ones(2)])
        observation[:4] += 3.0 * rng.normal(size=4)
        _, state = policy.predict(observation, state)
        largest = max(largest, np.linalg.norm(state.weights, axis=-1).max())
        most = max(most, np.linalg.norm(features(*observation[None, 6:].reshape(3, 1, 2))))
    assert 0.1 * most / 0.2 < largest <= most / 0.2


def test_the_network_learns_the_gravity_of_a_load():
    """Among drawn way-points, with a load at the tip: what the network says of an arm at rest becomes the gravity missed."""
    steps = 12_000
    env = TwoLinkArmEnv(actuator=None, action="torque", parameter_error={"payload": 7.5}, duration=0.01 * steps)
    policy = controllers.make("rbf-adaptive", env, rate=150.0, forget=0.0)
    poses = []
    for k, (*_, after) in enumerate(loop(policy, env, steps)):
        if k > 8000 and k % 20 == 0:
            poses.append(env.truth.reference)
            state = after
    q = np.array(poses)
    learned = policy.learned(np.repeat(state.weights, len(q), axis=0), features(q, np.zeros_like(q), np.zeros_like(q)))
    missed = gravity_torque(env.truth.lumped, q) - gravity_torque(env.interface.nominal, q)
    error = np.sqrt(((learned - missed) ** 2).mean(axis=0) / (missed**2).mean(axis=0))
    assert error.max() < 0.15


def test_the_basis_is_normalised_and_periodic():
    """An angle's basis has length one, no seam at a full turn, and its largest at the nearest centre."""
    x = np.linspace(-7.0, 7.0, 101)
    np.testing.assert_allclose(np.linalg.norm(bumps(x), axis=-1), 1.0)
    np.testing.assert_allclose(bumps(x), bumps(x + 2 * np.pi), atol=1e-12)
    nearest = np.round(x / (2 * np.pi / NODES)).astype(int) % NODES
    np.testing.assert_array_equal(bumps(x).argmax(axis=-1), nearest)
