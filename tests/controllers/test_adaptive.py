"""The parameter estimator of §4.1 against the paper's own equations, and the adaptive controller on its figures."""

import numpy as np
import pytest

import controllers
from benchmarks.run.metrics import measure, summarize
from benchmarks.run.rollout import rollout
from controllers.estimator import estimate, lumped_of, plausible, point_masses
from controllers.gain_scheduling import schedule
from fbl_gym import TABLE_1, ArmParameters, TwoLinkArmEnv, scenarios
from fbl_gym.arm import forward_dynamics, inertia_matrix, inverse_dynamics, regressor

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
    return np.array(
        [
            [a[0], a[0], both, fourth, g * c1, g * c1, g * c12],
            [0.0, 0.0, both, a[0] * c2 + v[0] ** 2 * s2, 0.0, 0.0, g * c12],
        ]
    )


def printed_estimate(q, v, a, wished, nominal):
    """Equations (36) and (37) for three samples, with the e that (37) leaves out: X3, X4 and X7, then (39)'s Y1, Y2, Y3."""
    k = np.vstack([printed_k(q[i], v[i], a[i]) for i in range(3)])
    right = np.concatenate([inertia_matrix(nominal, q[i]) @ (wished[i] - a[i]) for i in range(3)])
    x = -np.linalg.pinv(k) @ right
    m2, L1, L2 = nominal.m2, nominal.L1, nominal.L2
    return k, np.array([m2 * L2**2 - x[2], m2 * L1 * L2 - x[3], m2 * L2 - x[6]])


def test_three_samples_are_enough():
    q, v, a, torque = samples(REAL)
    found, ok = estimate(regressor(q, v, a), torque, 1e-7)
    assert ok.all()
    np.testing.assert_allclose(found, np.broadcast_to(REAL.lumped, found.shape), rtol=1e-6)


def test_it_is_the_papers_estimate():
    """(32)-(39) as printed, where the torque is the nominal mapping's: the same Y1, Y2, Y3, and rank five as (38) says."""
    q, v, a, torque = samples(REAL, 20)
    found, _ = estimate(regressor(q, v, a), torque, 1e-7)
    for i in range(20):
        wished = np.array([forward_dynamics(TABLE_1, q[i, s], v[i, s], torque[i, s]) for s in range(3)])
        k, printed = printed_estimate(q[i], v[i], a[i], wished, TABLE_1)
        assert np.linalg.matrix_rank(k) == 5
        np.testing.assert_allclose(printed, found[i, [1, 2, 4]] / [1, 1, 9.81], rtol=1e-6)


def test_saturation_biases_the_printed_form_and_not_this_one():
    """The printed e compares with a wished acceleration that a saturated torque cannot give."""
    q, v, _, wished_torque = samples(REAL, 20)
    torque = np.clip(wished_torque, -150, 150)
    a = forward_dynamics(REAL, q, v, torque)
    found, ok = estimate(regressor(q, v, a), torque, 1e-7)
    assert ok.all()
    np.testing.assert_allclose(found, np.broadcast_to(REAL.lumped, found.shape), rtol=1e-6)
    wrong = []
    for i in range(20):
        wished = np.array([forward_dynamics(TABLE_1, q[i, s], v[i, s], wished_torque[i, s]) for s in range(3)])
        _, printed = printed_estimate(q[i], v[i], a[i], wished, TABLE_1)
        wrong.append(np.abs(printed / (REAL.lumped[[1, 2, 4]] / [1, 1, 9.81]) - 1).max())
    assert np.median(wrong) > 0.1


def test_both_forms_of_39():
    lumped = REAL.lumped[None]
    exact = [[31.0, 9.0, 1.1, 0.4]]
    np.testing.assert_allclose(point_masses(lumped), exact, rtol=1e-12)
    np.testing.assert_allclose(point_masses(lumped, total_mass=40.0), exact, rtol=1e-12)
    np.testing.assert_allclose(lumped_of(np.array(exact)), lumped, rtol=1e-12)


def test_at_rest_nothing_is_believed():
    """At rest the rank is two: the samples tell the gravity torques and nothing of the inertia."""
    q = np.broadcast_to(np.array([0.3, 0.5]), (1, 3, 2))
    still = np.zeros((1, 3, 2))
    _, ok = estimate(regressor(q, still, still), inverse_dynamics(REAL, q, still, still), 1e-7)
    assert not ok.any()


@pytest.mark.parametrize("i", range(5))
def test_implausible_parameters_are_refused(i):
    lumped = np.stack([REAL.lumped, REAL.lumped])
    lumped[1, i] *= -1.0
    np.testing.assert_array_equal(plausible(lumped), [True, False])
    lumped[1, i] = np.nan
    np.testing.assert_array_equal(plausible(lumped), [True, False])


def learn(name, steps, **gains):
    """Relative errors [steps x 4] of the estimates of m1, m2, L1, L2 over a run."""
    scenario = scenarios.get(name)
    env = TwoLinkArmEnv(scenario, action="torque" if scenario.actuator.torque_limit is None else "normalized")
    observation, _ = env.reset(seed=0)
    policy, state, found = controllers.make("adaptive-flm", env, **gains), None, []
    for _ in range(steps):
        action, state = policy.predict(observation, state)
        observation = env.step(action)[0]
        found.append(policy.parameters(state)[0])
    return np.abs(np.array(found) / [*env.truth.masses, *env.truth.lengths] - 1)


@pytest.mark.parametrize(("name", "mass", "rate"), [("paper-6a", 350.0, 1000), ("paper-6b", 3.5, 10_000)])
@pytest.mark.parametrize("form", ["mass known", "mass unknown"])
def test_figures_6a_and_6b(name, mass, rate, form):
    """Real parameters ten times and a tenth of the estimates: within 10 % from the fourth sample on, and far better."""
    error = learn(name, 2 * rate, total_mass=mass if form == "mass known" else None)
    assert error[3:].max() < 0.1
    assert error[rate:].max() < 0.01
    assert np.median(error) < 1e-6


def test_small_parameters_need_a_fast_loop():
    """The nominal inertia is a thousand times the real one's: at 1 kHz the arm is lost before the first estimate."""
    small = scenarios.get("paper-6b").replace(duration=1.0)
    fast = measure(rollout("adaptive-flm", small, [0]))[0]
    slow = measure(rollout("adaptive-flm", small.replace(control_dt=1e-3), [0]))[0]
    assert fast["diverged"] == 0.0
    assert slow["diverged"] == 1.0


def test_acceleration_noise_ruins_three_samples():
    """sigma = 0.01 rad/s^2 on the accelerometer, and the typical estimate is off by half and more."""
    noisy = scenarios.get("paper-6a").replace(noise={"acceleration": 0.01})
    env = TwoLinkArmEnv(noisy, action="torque")
    observation, _ = env.reset(seed=0)
    policy, state, found = controllers.make("adaptive-flm", env), None, []
    for _ in range(2000):
        action, state = policy.predict(observation, state)
        observation = env.step(action)[0]
        found.append(policy.parameters(state)[0])
    error = np.abs(np.array(found) / [200.0, 150.0, 7.0, 5.0] - 1)
    assert np.median(error[1000:]) > 0.3


def test_gain_schedule_is_equation_46():
    v = np.array([[0.0, 0.0], [0.1, -0.02], [5.0, 5.0]])
    alpha = np.array([[3.0, 0.5], [0.25, 4.0]])
    found = schedule(v, alpha, 1e-3)
    for row, (v1, v2) in zip(found, v, strict=True):
        near = np.exp(-(v1**2) / 1e-3), np.exp(-(v2**2) / 1e-3)
        np.testing.assert_allclose(row, 1 + alpha @ near, rtol=1e-12)
    np.testing.assert_allclose(found[0], [4.5, 5.25])
    np.testing.assert_allclose(found[2], 1.0)


def test_scheduling_helps_against_stiction():
    """Figure 8's stiction: what the schedule takes off the steady-state error of the same controller."""
    scenario = scenarios.get("paper-8")
    plain = summarize(measure(rollout("adaptive-flm", scenario, [0])))
    gains = {"alpha": ((20.0, 0.0), (0.0, 20.0))}
    scheduled = summarize(measure(rollout("adaptive-flm", scenario, [0], gains)))
    for link in ("steady_1_pct", "steady_2_pct"):
        assert scheduled[link] < 0.3 * plain[link]


@pytest.mark.parametrize(
    ("gains", "message"),
    [
        ({"alpha": 3.0}, "alpha must be four numbers"),
        ({"alpha": ((1, 2), (3, -4))}, "alpha must be four numbers"),
        ({"v_s": 0.0}, "v_s must be"),
        ({"total_mass": -1.0}, "total_mass must be"),
        ({"weakest": 0.0}, "weakest must be"),
    ],
)
def test_bad_gains_are_named(gains, message):
    with pytest.raises(ValueError, match=message):
        controllers.make("adaptive-flm", TwoLinkArmEnv(), **gains)
