"""The oracle that plans: its reference, its limits, and its error where the reference is infeasible."""

import numpy as np
import pytest

import controllers
from benchmarks.run.rollout import reference_motion
from controllers.true_arm import TrueArm
from fbl_gym import TwoLinkArmVectorEnv
from fbl_gym.model.arm import inverse_dynamics, with_rotors
from fbl_gym.scenarios import classes
from tests.controllers.closed_loop import tracking

pytest.importorskip("casadi")


def planned(scenario, seeds, **options):
    """An environment of two lanes, the plan of its episode, and the arms at its start."""
    env = TwoLinkArmVectorEnv(2, scenario, preview=15, **options)
    observation, _ = env.reset(seed=seeds)
    _, state = controllers.make("oracle-planned", env).predict(observation)
    return env, state.motion, TrueArm.of(env)


def errors(env, seeds, steps):
    """Tracking errors of the oracle that plans, and of that which does not [steps + 1 x 2 x 2] rad."""
    return [tracking(controllers.make(f"oracle-{name}", env), env, steps, seeds)[0] for name in ("planned", "elastic")]


def test_a_feasible_reference_is_the_plan():
    """And the law then is `oracle-elastic`; the whole reference is that of the episode."""
    env, motion, _ = planned("servo-nominal", [0, 1], duration=4.0)
    reference = reference_motion(env.scenario, (0, 1)).transpose(2, 1, 0, 3).reshape(2, 401, 6)
    np.testing.assert_array_equal(motion[:, :401], reference)
    np.testing.assert_allclose(*errors(env, [0, 1], 100), atol=1e-12)


def test_the_plan_keeps_the_limits_and_errs_least():
    """Within the limits between the knots too, but for a few samples; less than half the error without a plan."""
    env, motion, arm = planned(classes.get("servo-saturation-2", classes.CLASSES["servo"].arm), [7, 9], duration=2.6)
    q, v, a = np.split(motion[:, 1:260], 3, axis=-1)
    truth = arm.truth
    torque = inverse_dynamics(with_rotors(truth.lumped, truth.rotor)[:, None], q, v, a)
    torque += truth.viscous[:, None] * v + truth.coulomb[:, None] * np.tanh(v / 0.05)
    command = torque + truth.lag[:, None, None] * np.gradient(torque, 0.01, axis=1)
    use = np.abs(command) / (truth.gain[:, None] * env.interface.torque_limit)
    assert np.quantile(use, 0.98) < 1.0
    assert use.max() < 1.1
    np.testing.assert_allclose(q[:, 0], truth.position, atol=1e-3)
    # The integral of a speed whose acceleration is linear.
    trapezoid = 0.005 * (v[:, 1:] + v[:, :-1]) - 0.01**2 / 12 * np.diff(a, axis=1)
    np.testing.assert_allclose(np.diff(q, axis=1), trapezoid, atol=1e-6)
    with_plan, without = (np.abs(error).mean() for error in errors(env, [7, 9], 260))
    assert with_plan < 0.4 * without
