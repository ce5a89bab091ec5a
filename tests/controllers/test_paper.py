"""The paper's controllers: estimator and schedule of §4, Kalman filter of §3; compiled solvers and dynamics of laws."""

import numpy as np
import pytest
from filterpy.common import Q_discrete_white_noise
from filterpy.kalman import KalmanFilter
from scipy.linalg import solve_continuous_are, solve_discrete_are

import controllers
from benchmarks.run.metrics import measure
from benchmarks.run.rollout import rollout
from controllers.numerics import dynamics
from controllers.numerics.solving import TOGETHER, least_squares
from controllers.paper.estimator import estimate, lumped_of, plausible, point_masses
from controllers.paper.gain_scheduling import FORMS, schedule
from controllers.paper.kalman import PAPER_SIGMA, JointKalman, continuous_gains, gains
from fbl_gym import TABLE_1, ArmParameters, TwoLinkArmEnv, scenarios
from fbl_gym.model import arm
from fbl_gym.model.arm import forward_dynamics, inertia_matrix, inverse_dynamics, regressor
from tests.controllers.closed_loop import EXCITING, nominal, tracking

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
    first = [a[0], a[0], both, fourth, g * c1, g * c1, g * c12]
    return np.array([first, [0.0, 0.0, both, a[0] * c2 + v[0] ** 2 * s2, 0.0, 0.0, g * c12]])


def printed_estimate(q, v, a, desired, nominal):
    """Equations (36) and (37) for three samples, with the e that (37) leaves out: X3, X4 and X7, then (39)'s Y1, Y2, Y3."""
    k = np.vstack([printed_k(q[i], v[i], a[i]) for i in range(3)])
    right = np.concatenate([inertia_matrix(nominal, q[i]) @ (desired[i] - a[i]) for i in range(3)])
    x = -np.linalg.pinv(k) @ right
    m2, L1, L2 = nominal.m2, nominal.L1, nominal.L2
    return k, np.array([m2 * L2**2 - x[2], m2 * L1 * L2 - x[3], m2 * L2 - x[6]])


def test_the_estimate_is_the_papers():
    """(32)-(39) as printed, where the torque is the nominal mapping's: the same Y1, Y2, Y3, and rank five as (38) says."""
    q, v, a, torque = samples(REAL, 20)
    lumped, accepted = estimate(regressor(q, v, a), torque, 1e-7)
    assert accepted.all()
    np.testing.assert_allclose(lumped, np.broadcast_to(REAL.lumped, lumped.shape), rtol=1e-6)
    for i in range(20):
        desired = np.array([forward_dynamics(TABLE_1, q[i, s], v[i, s], torque[i, s]) for s in range(3)])
        k, printed = printed_estimate(q[i], v[i], a[i], desired, TABLE_1)
        assert np.linalg.matrix_rank(k) == 5
        np.testing.assert_allclose(printed, lumped[i, [1, 2, 4]] / [1, 1, 9.81], rtol=1e-6)


def test_both_forms_of_equation_39_agree():
    lumped, exact = REAL.lumped[None], [[31.0, 9.0, 1.1, 0.4]]
    for total_mass in ({}, {"total_mass": 40.0}):
        np.testing.assert_allclose(point_masses(lumped, **total_mass), exact, rtol=1e-12)
    np.testing.assert_allclose(lumped_of(np.array(exact)), lumped, rtol=1e-12)
    env = TwoLinkArmEnv(arm={"gravity": 1.62})
    law = controllers.make("adaptive-flm@total_mass=35", env)
    first = law.parameters(law.initial(env.reset(seed=0)[0][None]))
    np.testing.assert_allclose(first, [[20, 15, 0.7, 0.5]], rtol=1e-12)


def test_at_rest_no_estimate_is_accepted():
    """At rest the rank is two: the samples tell the gravity torques and nothing of the inertia."""
    q = np.broadcast_to(np.array([0.3, 0.5]), (1, 3, 2))
    still = np.zeros((1, 3, 2))
    _, accepted = estimate(regressor(q, still, still), inverse_dynamics(REAL, q, still, still), 1e-7)
    assert not accepted.any()


@pytest.mark.parametrize("i", range(5))
def test_implausible_parameters_are_refused(i):
    lumped = np.stack([REAL.lumped, REAL.lumped])
    lumped[1, i] *= -1.0
    np.testing.assert_array_equal(plausible(lumped), [True, False])
    lumped[1, i] = np.nan
    np.testing.assert_array_equal(plausible(lumped), [True, False])


def deficient(n, weak, seed=0):
    """Rows [n x 6 x 5], four of whose singular values are between 0.3 and 3, and the fifth is `weak` [n]; and targets."""
    rng = np.random.default_rng(seed)
    u, v = np.linalg.qr(rng.normal(size=(n, 6, 5)))[0], np.linalg.qr(rng.normal(size=(n, 5, 5)))[0]
    s = np.concatenate([rng.uniform(0.3, 3.0, (n, 4)), np.reshape(weak, (n, 1))], axis=1)
    return (u * s[:, None]) @ v, rng.normal(size=(n, 6))


@pytest.mark.parametrize("n", [1, TOGETHER - 1, TOGETHER, 3 * TOGETHER + 5])
def test_least_squares_agree_with_lapack_and_a_lane_alone_has_the_bits_it_has_in_a_batch(n):
    rows, target = deficient(n, np.full(n, 0.1))
    solution, rich = least_squares(rows, target, 1e-7)
    assert rich.all()
    for i in range(n):
        expected = np.linalg.lstsq(rows[i], target[i], rcond=None)[0]
        np.testing.assert_allclose(solution[i], expected, rtol=1e-10, atol=1e-12)
        np.testing.assert_array_equal(least_squares(rows[i : i + 1], target[i : i + 1], 1e-7)[0][0], solution[i])


def test_nearly_dependent_columns_are_as_accurate_as_with_householder():
    """A consistent system with singular values down to 1e-6: an error of rounding times condition, as Householder's has."""
    rows, _ = deficient(200, np.full(200, 1e-6))
    x = np.random.default_rng(1).normal(size=(200, 5))
    solution, _ = least_squares(rows, np.einsum("nij,nj->ni", rows, x), 1e-7)
    assert np.abs(solution - x).max() < 1e-15 * 3e6 * 10


def test_the_smallest_singular_value_decides():
    """Within a millionth of it, near the default threshold, where the squares, Y'Y, would tell nothing."""
    rows, target = deficient(200, np.full(200, 1e-7))
    scaled = rows / np.linalg.norm(rows, axis=1, keepdims=True)
    for i, weak in enumerate(np.linalg.svd(scaled, compute_uv=False)[:, -1]):
        lane = slice(i, i + 1)
        for sign in (-1, 1):
            solution, rich = least_squares(rows[lane], target[lane], weak * (1.0 + sign * 1e-6))
            assert rich.tolist() == [sign < 0]
            assert (np.isfinite(solution) if sign < 0 else np.isnan(solution)).all()


def test_columns_that_are_zero_equal_or_not_finite_are_refused():
    rows, target = deficient(4, np.full(4, 0.1))
    rows[1, :, 2] = 0.0
    rows[2, :, 3] = rows[2, :, 1]
    rows[3, 0, 0] = np.nan
    _, rich = least_squares(rows, target, 1e-7)
    np.testing.assert_array_equal(rich, [True, False, False, False])


@pytest.mark.parametrize("name", ["inverse_dynamics", "forward_dynamics"])
@pytest.mark.parametrize("shape", [(1, 2), (7, 2), (4, 3, 2)])
def test_compiled_dynamics_has_the_bits_of_the_arms(name, shape):
    """The last signal may be the same for all rows."""
    q, v, x = np.random.default_rng(1).normal(scale=3.0, size=(3, *shape))
    geared = ArmParameters(rotor=(2.0, 1.0))
    models = [geared, geared.lumped, np.tile(geared.lumped, (*shape[:-1], 1)), np.tile(geared.base, (*shape[:-1], 1))]
    compiled, exact = getattr(dynamics, name), getattr(arm, name)
    for model in models:
        np.testing.assert_array_equal(compiled(model, q, v, x), exact(model, q, v, x))
    one = np.array([1.0, -2.0])
    np.testing.assert_array_equal(compiled(geared, q, v, one), exact(geared, q, v, np.tile(one, (*shape[:-1], 1))))


def test_small_parameters_need_a_fast_loop():
    """The nominal inertia is a thousand times the real one's: at 1 kHz the arm diverges before the first estimate."""
    small = scenarios.get("paper-6b").replace(duration=0.3)
    traces = (rollout("adaptive-flm", task, [0]) for task in (small, small.replace(control_dt=1e-3)))
    assert [measure(trace)[0]["diverged"] for trace in traces] == [0.0, 1.0]


def test_samples_that_lie_apart_bear_noise():
    """The same noise: half a second apart, the estimates are within some per cent."""
    noise = {"acceleration": 0.01}
    noisy = nominal(control_dt=1e-3, parameter_error=2.0, reference=EXCITING, noise=noise, duration=5.0)
    env, errors = TwoLinkArmEnv(noisy), []
    for spacing in (0.0, 0.5):
        policy = controllers.make("adaptive-flm", env, spacing=spacing)
        _, states = tracking(policy, env, 4000)
        estimates = np.array([policy.parameters(state)[0] for state in states[3000:]])
        errors.append(np.median(np.abs(estimates / [*env.truth.masses, *env.truth.lengths] - 1)))
    assert errors[1] < 0.05 < 0.2 < errors[0]


def test_the_paper_s_tools_together_work_with_noise():
    noise = dict.fromkeys(("position", "velocity", "acceleration"), 1e-2)
    scenario = scenarios.get("paper-10").replace(noise=noise, duration=2.0)
    laws = (("adaptive-flm-scheduled", {}), ("adaptive-robust-flm", {}), ("adaptive-robust-flm", {"spacing": 0.0}))
    plain, together, quick = (measure(rollout(policy, scenario, [0], gains))[0] for policy, gains in laws)
    assert together["diverged"] == plain["diverged"] == 0.0
    assert quick["steady_1_pct"] < plain["steady_1_pct"]


@pytest.mark.parametrize("alpha", [((1.0, 2.0),), ((1.0, -1.0), (0.0, 1.0)), ((1.0, 2.0, 3.0), (1.0, 2.0, 3.0))])
def test_an_alpha_that_is_not_four_numbers_is_refused(alpha):
    with pytest.raises(ValueError, match="alpha must be"):
        controllers.make("adaptive-flm", TwoLinkArmEnv(), alpha=alpha)


def test_the_schedule_is_equation_46():
    v = np.array([[0.0, 0.0], [0.1, -0.02], [5.0, 5.0]])
    alpha = np.array([[3.0, 0.5], [0.25, 4.0]])
    factors = schedule(v, alpha, 1e-3)
    for row, (v1, v2) in zip(factors, v, strict=True):
        near = np.exp(-(v1**2) / 1e-3), np.exp(-(v2**2) / 1e-3)
        np.testing.assert_allclose(row, 1 + alpha @ near, rtol=1e-12)
    np.testing.assert_allclose(factors[0], [4.5, 5.25])
    np.testing.assert_allclose(factors[2], 1.0)


def test_every_form_is_full_at_rest_and_none_at_speed():
    """Between them the switch is hard, and the rules meet (46) at rest, at sqrt(v_s) and far away."""
    scale = np.sqrt(1e-3)
    v = np.array([[0.0, 0.0], [1.0, 1.0], [3.0, 3.0]]) * scale
    alpha = ((20.0, 0.0), (0.0, 20.0))
    factors = {form: schedule(v, alpha, 1e-3, form)[:, 0] for form in FORMS}
    for form in FORMS:
        assert factors[form][0] == 21.0
        assert factors[form][2] < 1.01
    np.testing.assert_allclose(factors["fuzzy"][1], factors["soft"][1], rtol=1e-9)
    edges = schedule(np.outer([0.999, 1.001], v[1]), alpha, 1e-3, "hard")
    np.testing.assert_array_equal(edges, [[21.0, 21.0], [1.0, 1.0]])


def test_feed_forward_tracks_a_moving_reference():
    scenario = scenarios.get("paper-8").replace(friction=None, duration=4.0)
    traces = (rollout("cascade-flm", scenario, [0], {"feedforward": share}) for share in (0.0, 1.0))
    without, with_it = (measure(trace)[0]["error_pct"] for trace in traces)
    assert with_it < 0.2 * without


def test_a_known_friction_that_varies_is_refused():
    env = TwoLinkArmEnv()
    with pytest.raises(ValueError, match=r"friction must have fixed numbers and no load, .* got Friction"):
        controllers.make("cascade-flm", env, friction={"coulomb": {"uniform": [1.0, 2.0]}})
    with pytest.raises(ValueError, match=r"no load, as in equation \(22\), got .*load=\(0.2"):
        controllers.make("cascade-flm", env, friction={"load": 0.2})


def test_the_gain_at_a_fast_rate_is_the_papers_continuous_gain():
    """Q_c = diag(0, 0.1) and R_c = 0.1 in (20), (21): P = [[.141421, .1], [.1, .141421]], K = [1.41421, 1.0]."""
    a, c = np.array([[0.0, 1.0], [0.0, 0.0]]), np.array([[1.0, 0.0]])
    p = solve_continuous_are(a.T, c.T, np.diag([0.0, 0.1]), np.array([[0.1]]))
    np.testing.assert_allclose(p, [[0.141421, 0.1], [0.1, 0.141421]], atol=1e-6)
    k = (p @ c.T / 0.1).ravel()
    np.testing.assert_allclose(k, [1.41421, 1.0], atol=1e-5)
    # Ours, per sample, is that times dt, with an error that shrinks with dt; the continuous form has it at any dt.
    np.testing.assert_allclose(continuous_gains(1e-3, PAPER_SIGMA, PAPER_SIGMA)[-1] / 1e-3, k, rtol=1e-3)
    for dt in (1e-2, 1e-3):
        assert np.abs(gains(dt, PAPER_SIGMA, PAPER_SIGMA)[-1] / dt - k).max() < 1.1 * dt


@pytest.mark.parametrize(("acceleration", "position"), [(1.0, 1.0), (0.5, 5e-3), (10.0, 1e-4)])
def test_the_converged_gain_solves_the_discrete_riccati_equation(acceleration, position):
    dt = 1e-2
    f, h = np.array([[1.0, dt], [0.0, 1.0]]), np.array([[1.0, 0.0]])
    q, r = Q_discrete_white_noise(2, dt, acceleration**2), np.array([[position**2]])
    p = solve_discrete_are(f.T, h.T, q, r)
    k = (p @ h.T / (h @ p @ h.T + r)).ravel()
    np.testing.assert_allclose(gains(dt, acceleration, position)[-1], k, rtol=1e-5)


def test_the_batched_update_agrees_with_filterpy():
    """Random measurements through ours, all joints and lanes at once, and through filterpy one by one."""
    dt, n, steps = 0.01, 3, 200
    rng = np.random.default_rng(0)
    y, u = rng.normal(size=(steps, n, 2)), rng.normal(size=(steps, n, 2))
    ours, q, estimates = JointKalman(dt, 0.5, 0.02), np.zeros((n, 2)), []
    state = ours.update(ours.initial(q, q), q, q)  # the first observation ends no sample
    np.testing.assert_array_equal([state.position, state.velocity], [q, q])
    for k in range(steps):
        state = ours.update(state, y[k], u[k])
        estimates.append([state.position, state.velocity])
    for lane, joint in np.ndindex(n, 2):
        kalman = KalmanFilter(dim_x=2, dim_z=1, dim_u=1)
        kalman.F, kalman.B, kalman.H = np.array([[1, dt], [0, 1]]), np.array([[dt**2 / 2], [dt]]), np.array([[1.0, 0]])
        kalman.Q, kalman.R = Q_discrete_white_noise(2, dt, 0.5**2), np.array([[0.02**2]])
        kalman.x, kalman.P = np.zeros((2, 1)), np.diag([0.02**2, 0.01])
        means, *_ = kalman.batch_filter(y[:, lane, joint], us=u[:, lane, joint])
        np.testing.assert_allclose(np.array(estimates)[:, :, lane, joint], means[:, :, 0], rtol=1e-9, atol=1e-11)


def test_the_filter_costs_accuracy_at_a_low_rate():
    """It takes the acceleration at an interval's end for that of the whole interval. At 100 Hz this alone is an error of
    ten times the cascade's; at 1 kHz it is less than a fifth of that."""
    pairs = (("robust-flm", 1e-2), ("robust-flm", 1e-3), ("cascade-flm", 1e-2))
    traces = (rollout(policy, nominal(duration=3.0, control_dt=dt), [0]) for policy, dt in pairs)
    slow, fast, cascade = (measure(trace)[0]["error_pct"] for trace in traces)
    assert slow > 5 * cascade
    assert fast < 0.25 * slow


def test_the_robust_controller_needs_no_velocity_sensor():
    env = TwoLinkArmEnv(sensors=("position", "acceleration"))
    errors, _ = tracking(controllers.make("robust-flm", env), env, 200)
    assert np.abs(errors[-1]).max() < 0.2
