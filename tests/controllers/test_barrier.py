"""The safety filter: `LAW+barrier`, and `Filtered` around any policy."""

import numpy as np
import pytest

import controllers
from benchmarks.policies.spec import resolve
from controllers.composition import Filtered
from controllers.parts import Barrier
from fbl_gym import TwoLinkArmEnv
from fbl_gym.model.arm import forward_dynamics
from fbl_gym.scenarios import as_scenario
from tests.controllers.closed_loop import broken_promises

BOX = {"low": (-2.1, -0.9), "high": (-1.1, 0.5), "velocity": (0.9, 1.2)}
MOVES = {"kind": "minimum-jerk", "points": [(-1.5, 0.0), (-0.9, 0.7), (-2.3, -1.1)], "move_time": 0.7, "hold_time": 0.1}
"""A motion that starts within the box and leaves it on every side."""


def motion(make, steps=400, **options):
    """Return positions and velocities [T x 2] of an arm, and the actions."""
    env = TwoLinkArmEnv(reference=MOVES, **{"constraints": BOX, "control_dt": 4e-3, **options})
    policy = make(env)
    observation, _ = env.reset(seed=1)
    state, rows = None, []
    for _ in range(steps):
        action, state = policy.predict(observation, state)
        observation = env.step(action)[0]
        signals = env._batch.true_signals()
        rows.append((signals["position"][0], signals["velocity"][0], action))
    return np.moveaxis(rows, 1, 0)


def worst(positions, velocities):
    """Return the largest violation of each kind of bound [rad], [rad/s]."""
    beyond = np.maximum(np.array(BOX["low"]) - positions, positions - np.array(BOX["high"]))
    return beyond.max(), (np.abs(velocities) - np.array(BOX["velocity"])).max()


@pytest.mark.parametrize(("name", "action"), [("computed-torque", "normalized"), ("pd-gravity", "acceleration")])
def test_the_bounds_hold_with_an_exact_model_and_a_fine_rate(name, action):
    free = worst(*motion(lambda env: controllers.make(name, env), action=action)[:2])
    assert min(free) > 0.05
    position, velocity = worst(*motion(lambda env: controllers.make(f"{name}+barrier", env), action=action)[:2])
    assert position < 1e-4
    assert velocity < 1e-3


def test_a_predictor_keeps_the_bounds_through_a_delay():
    """A delay of 20 ms is long for a decay of 40 1/s."""

    def beyond(law):
        late = {"actuator": {"delay_samples": 5}, "preview": 10}
        return worst(*motion(lambda env: controllers.make(law, env, barrier_decay=40.0), **late)[:2])

    assert min(beyond("computed-torque+barrier")) > 0.02
    assert max(beyond("computed-torque+predictor+barrier")) < 1e-3


def test_a_filter_around_a_policy_equals_that_of_the_law():
    filtered = motion(lambda env: Filtered(controllers.make("pd-gravity", env), env.interface), 200)
    composed = motion(lambda env: controllers.make("pd-gravity+barrier", env), 200)
    np.testing.assert_allclose(filtered, composed, atol=1e-9)


@pytest.mark.parametrize("constraints", [None, {"low": -9.0, "high": 9.0, "velocity": 50.0}], ids=["none", "wide"])
@pytest.mark.parametrize("name", ["pid-gravity", "slotine-li", "td3"])
def test_an_inactive_filter_changes_no_bit(name, constraints):
    def action(make):
        return motion(make, 60, constraints=constraints, scenario="everything-2", control_dt=0.01)[2]

    plain = action(lambda env: controllers.make(name, env))
    filtered = action(lambda env: Filtered(controllers.make(name, env), env.interface))
    np.testing.assert_array_equal(filtered, plain)
    if name != "td3":
        np.testing.assert_array_equal(action(lambda env: controllers.make(f"{name}+barrier", env)), plain)


def test_the_filter_solves_the_quadratic_program():
    """No other acceleration in the box is nearer to the wanted one, also for a state outside of the constraints."""
    env = TwoLinkArmEnv(constraints=BOX, actuator=None, action="torque")
    barrier, rng = Barrier(env.interface, decay=8.0, margin=0.05), np.random.default_rng(0)
    q, v, torque = rng.uniform(-2, 1, (500, 2)), rng.normal(0, 0.5, (500, 2)), rng.normal(0, 100, (500, 2))
    low, high = barrier.accelerations(q, v)
    assert (low <= high).all()
    safe, wanted = (forward_dynamics(env.interface.nominal, q, v, x) for x in (barrier.filtered(torque, q, v), torque))
    inside = (low <= wanted) & (wanted <= high)
    np.testing.assert_allclose(safe, np.clip(wanted, low, high), atol=1e-9)
    np.testing.assert_array_equal((barrier.filtered(torque, q, v) == torque).all(axis=-1), inside.all(axis=-1))
    assert 10 < inside.all(axis=-1).sum() < 490


def test_a_barrier_composes_and_keeps_every_promise():
    scenario = as_scenario("everything-2").replace(constraints=BOX, duration=0.3)
    name = "pid-flm+kalman+barrier"
    assert broken_promises(name, scenario) == []
    spec = resolve(name)
    assert spec.make(TwoLinkArmEnv(), barrier_margin=0.1)._barrier.margin == (0.1, 0.1)
