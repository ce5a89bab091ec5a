"""Predictive control against SciPy's optimiser, against the regulator that it becomes at rest, and against its limits."""

import sys

import numpy as np
import pytest
from gymnasium.error import DependencyNotInstalled
from scipy.linalg import solve_discrete_are
from scipy.optimize import least_squares

import controllers
from benchmarks.run.rollout import rollout
from controllers.nmpc import HORIZON, STEP, acceleration, planner, residuals, terminal
from fbl_gym import TABLE_1, TwoLinkArmEnv
from fbl_gym.model.arm import forward_dynamics, inertia_matrix
from tests.controllers.closed_loop import nominal, tracking

WEIGHTS = ((100.0, 100.0), (10.0, 10.0))
SCALE = np.diagonal(inertia_matrix(TABLE_1, (0.0, 0.0)))


def task(seed=0):
    """A start away from the reference, and a reference that moves."""
    rng = np.random.default_rng(seed)
    start = np.concatenate([[-1.5, 0.3], 0.2 * rng.normal(size=2), rng.normal(size=2)])
    t = STEP * np.arange(HORIZON + 1)
    reference = np.stack([-1.4 + 0.3 * t, 0.4 - 0.2 * t, 0.3 + 0 * t, -0.2 + 0 * t, 0 * t, 0 * t])
    return start, reference


def test_the_model_is_that_of_the_arm():
    rng = np.random.default_rng(0)
    for _ in range(20):
        x, torque = rng.uniform(-3, 3, 4), rng.uniform(-300, 300, 2)
        expression = np.array(acceleration(TABLE_1, [float(v) for v in x], [float(v) for v in torque])).ravel()
        np.testing.assert_allclose(expression, forward_dynamics(TABLE_1, x[:2], x[2:], torque), rtol=1e-9)


@pytest.mark.parametrize("limit", [None, (400.0, 120.0)])
def test_repeated_steps_converge_to_scipys_optimum(limit):
    """Gauss-Newton's steps, repeated, end where SciPy's trust-region solver ends, within the same limits."""
    start, reference = task()
    cost = residuals(TABLE_1, STEP, WEIGHTS)
    improve = planner(TABLE_1, STEP, WEIGHTS, limit, 1)
    plan = np.zeros(2 * HORIZON)
    for _ in range(15):
        plan = np.array(improve(start, reference, plan)).ravel()
    bound = np.inf if limit is None else np.tile(limit, HORIZON) / np.tile(SCALE, HORIZON)
    best = least_squares(
        lambda u: np.array(cost(start, reference, u)).ravel(), np.zeros(2 * HORIZON), bounds=(-bound, bound), xtol=1e-12
    )
    np.testing.assert_allclose(plan, best.x * np.tile(SCALE, HORIZON), rtol=1e-3, atol=0.3)
    if limit is not None:
        reached = np.abs(plan.reshape(-1, 2)).max(axis=0)
        assert np.all(reached <= np.array(limit) * (1 + 1e-9))
        assert np.any(reached > np.array(limit) * (1 - 1e-9))


def test_nmpc_at_rest_is_the_optimal_regulator():
    """A small error at rest and no limit: the first acceleration is -K x of the linear-quadratic regulator."""
    start, error = np.array([-np.pi / 2, 0.0, 0.0, 0.0, 0.0, 0.0]), np.array([1e-4, -1e-4])
    reference = np.zeros((6, HORIZON + 1))
    reference[:2] = (start[:2] + error)[:, None]
    improve = planner(TABLE_1, STEP, WEIGHTS, None, 1)
    plan = np.zeros(2 * HORIZON)
    for _ in range(5):
        plan = np.array(improve(start, reference, plan)).ravel()
    first = forward_dynamics(TABLE_1, start[:2], start[2:4], plan[:2])
    f, g = np.array([[1.0, STEP], [0.0, 1.0]]), np.array([[0.5 * STEP**2], [STEP]])
    p = solve_discrete_are(f, g, np.diag([100.0, 10.0]) ** 2, np.eye(1))
    k = np.linalg.solve(1 + g.T @ p @ g, g.T @ p @ f)[0, 0]
    np.testing.assert_allclose(first, k * error, rtol=0.02)
    r = terminal(STEP, 100.0, 10.0)
    np.testing.assert_allclose(r.T @ r, p, rtol=1e-9)


def test_limits_are_kept_and_loads_leave_no_error():
    still = {"kind": "minimum-jerk", "points": ((-np.pi / 2, 0.4),)}
    scenario = nominal(
        reference=still, disturbance={"kind": "array", "torque": ((40.0, -15.0),)}, duration=3.0,
        actuator={"torque_limit": (300, 100)}, initial_error=(0.5, -0.3),
    )  # fmt: skip
    trace = rollout("nmpc", scenario, [0])
    assert np.all(np.abs(trace.torque[1:, 0]) <= [300.0, 100.0])
    assert np.abs(trace.reference - trace.position)[-1].max() < 1e-3


def test_preview_reduces_the_error():
    """The same arm with the reference's next 0.3 s and without."""
    scenario = nominal(duration=4.0)
    ahead = rollout("nmpc", scenario, [0])
    env = TwoLinkArmEnv(scenario)
    errors, _ = tracking(controllers.make("nmpc", env), env, scenario.steps)
    assert np.abs(ahead.reference - ahead.position).mean() < 0.9 * np.abs(errors[1:]).mean()


def test_a_missing_casadi_is_named(monkeypatch):
    monkeypatch.delitem(sys.modules, "controllers.nmpc")
    monkeypatch.setitem(sys.modules, "casadi", None)
    with pytest.raises(DependencyNotInstalled, match=r"pip install 'fbl-gym\[mpc\]'"):
        controllers.make("nmpc", TwoLinkArmEnv())
