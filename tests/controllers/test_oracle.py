"""The oracles through delay, lag and elastic joints; the one that plans, its limits and its error."""

import numpy as np
import pytest
from scipy.linalg import solve_discrete_are

import controllers
from benchmarks.run.rollout import reference_motion
from controllers.numerics.regulator import regulator
from controllers.oracles.true_arm import TrueArm
from fbl_gym import TwoLinkArmVectorEnv
from fbl_gym.model.arm import inverse_dynamics, with_rotors
from fbl_gym.scenarios.classes import CLASSES
from fbl_gym.scenarios.tiers import tier_scenario
from tests.controllers.closed_loop import loop, mean_error, tracking
from tests.fbl_gym.declared import VARYING

#: Each number of the friction, so that a new one must reach the oracles.
FRICTION = {f.name: 0.05 if f.name == "load" else 2.0 for f in VARYING if f.path.startswith("friction.")}

SPRING = {"stiffness": (8000.0, 2000.0), "damping": 5.0, "rotor_inertia": (3.0, 1.0), "encoder": "link"}


def test_a_failed_drive_gets_a_finite_command():
    env = TwoLinkArmVectorEnv(1, arm={"gravity": 0.0}, actuator={"gain": (1.0, 0.0)})
    assert np.isfinite(controllers.make("oracle-flm", env).predict(env.reset(seed=0)[0])[0]).all()


@pytest.mark.parametrize("link", [None, 5.0])
@pytest.mark.parametrize("joint", [None, SPRING])
def test_the_true_arm_is_predicted(joint, link):
    """Through delay, lag, friction, payload and wrong parameters, to the time of the next command."""
    env = TwoLinkArmVectorEnv(
        4, "everything-2", noise=None, disturbance={"kind": "pulses", "amplitude": 10.0, "period": 100.0, "width": 100.0},
        joint=joint, link=link, actuator={"delay_samples": 2, "lag": 0.01, "gain": 0.8}, friction=FRICTION,
        physics_dt=0.0005,
    )  # fmt: skip
    policy = controllers.make("pd-gravity", env, frequency=4.0)
    arms = [TrueArm.of(env) for _ in loop(policy, env, 80)]
    predicted, true = [arm.predicted() for arm in arms], [arm.state for arm in arms]
    halves = (np.split(np.array(x), x[0].shape[1] // 2, axis=-1) for x in (predicted, true))
    for before, after in zip(*halves, strict=True):
        change, error = np.subtract(after[2:], after[:-2]), np.subtract(before[:-2], after[2:])
        assert np.sqrt(np.mean(error[10:] ** 2)) < 0.02 * np.sqrt(np.mean(change[10:] ** 2))


def test_the_regulator_is_optimal():
    """Against SciPy's solution of the Riccati equation, for each of a batch."""
    rng = np.random.default_rng(0)
    f, g = 0.4 * rng.normal(size=(3, 5, 5)), rng.normal(size=(3, 5, 2))
    q, scale = np.diag([1.0, 2.0, 3.0, 0.0, 0.5]), rng.uniform(0.5, 2.0, (3, 2))
    for a, b, s, gain in zip(f, g, scale, regulator(f, g, q, scale), strict=True):
        p = solve_discrete_are(a, b, q, np.diag(1.0 / s**2))
        np.testing.assert_allclose(gain, np.linalg.solve(np.diag(1.0 / s**2) + b.T @ p @ b, b.T @ p @ a), rtol=1e-9)


@pytest.mark.parametrize("scenario", ["servo-delay-3", "servo-lag-2", "servo-elastic-3", "servo-payload-2"])
def test_the_oracle_is_best_under_delay_lag_and_elasticity(scenario):
    """Errors of at most some tenths of a milliradian, far below the oracle without prediction."""
    plain, elastic = (mean_error(name, scenario=scenario, preview=15) for name in ("oracle-flm", "oracle-elastic"))
    assert elastic < 0.3 * plain
    assert elastic < 8e-4


def test_preview_helps_where_springs_are_soft():
    """Differences over 1 ms need the samples of the reference that lie before now."""
    options = {"steps": 600, "skip": 300, "lanes": 2, "scenario": "geared-practice-elastic-3"}
    ahead, none = (mean_error("oracle-elastic", preview=preview, **options) for preview in (150, 0))
    assert ahead < 0.2 * none


def test_gains_follow_the_arm():
    """They are computed once for an arm, and again for lanes whose arm has changed."""
    env = TwoLinkArmVectorEnv(2, "servo-elastic-2", preview=15)
    law = controllers.make("oracle-elastic", env)
    _, first = law.predict(env.reset(seed=0)[0])
    observation = env.step(np.zeros((2, 2)))[0]
    _, second = law.predict(observation, first)
    assert second[1] is first[1]
    now = observation[:, env.interface.layout.reference[:6]]
    np.testing.assert_array_equal(second.past[:, -1], now)
    assert not np.array_equal(first.past[:, -1], now)
    _, third = law.predict(env.reset(seed=5)[0], second)
    assert not np.array_equal(third[1], first[1])


def test_the_oracle_tracks_best():
    """The oracle tracks far better than any other law if parameters, load and friction are wrong."""
    options = {"scenario": "everything-3", "preview": 15}
    others = min(mean_error(name, **options) for name in ("cascade-flm", "pid-flm", "pd-gravity"))
    assert mean_error("oracle-flm", **options) < 0.1 * others


def planned(scenario, seeds, **options):
    """An environment of two lanes, the plan of its episode, and the arms at its start."""
    pytest.importorskip("casadi")
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


def test_the_way_points_of_a_reset_are_the_plan():
    pytest.importorskip("casadi")
    env = TwoLinkArmVectorEnv(2, "servo-nominal", reference="minimum-jerk", preview=15)
    ways = np.array([[(-1.0, 0.5), (-1.5, 0.2)], [(-1.2, 0.3), (-1.0, 0.6)]])
    observation, _ = env.reset(seed=0, options={"reference": ways})
    motion = controllers.make("oracle-planned", env).predict(observation)[1].motion
    np.testing.assert_allclose(motion[:, :16].reshape(2, -1), observation[:, env.layout.reference], atol=1e-12)


def test_the_plan_keeps_the_limits_and_errs_least():
    """Within the limits between the knots too, but for a few samples; less than half the error without a plan."""
    env, motion, arm = planned(tier_scenario("servo-saturation-2", CLASSES["servo"].arm), [7, 9], duration=2.6)
    (q, v, a), truth = np.split(motion[:, 1:260], 3, axis=-1), arm.truth
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
