"""Errors on an exact arm against linear equations; the designs of LQG and H-infinity against other solvers; `lqg-elastic`."""

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.linalg import expm, logm, solve_discrete_are

import controllers
from benchmarks.run.rollout import rollout
from controllers.laws.h_infinity import INTEGRAL, SLACK, robust_controller
from controllers.laws.lqg import plant, regulator
from fbl_gym import SECTION_2_2, TABLE_1, TwoLinkArmEnv, TwoLinkArmVectorEnv
from fbl_gym.model.arm import forward_dynamics, inertia_matrix
from tests.controllers.closed_loop import EXACT, FAST, HANGING, REST, STILL, loaded, nominal, tracking

ZERO = {"reference": {"kind": "minimum-jerk", "points": ((0.0, 0.0),)}}


def response(a, x0, steps):
    """First component of x' = a x from x0, at each millisecond."""
    step, states = expm(1e-3 * np.array(a)), [np.array(x0)]
    for _ in range(steps):
        states.append(step @ states[-1])
    return np.array(states)[:, 0]


def lqg_rates(*weights):
    """Rates of (e, e', z) under the regulator. The filter's error has nothing to add at rest."""
    f, g = plant(1e-3)
    order = np.ix_([1, 2, 0], [1, 2, 0])
    return (logm(f - g @ regulator(1e-3, *weights)[None]) / 1e-3)[order]


def h_infinity_rates(w):
    """Rates of (e, e' / w, integral of u, controller), e'' = -w^2 (u + INTEGRAL integral), u = -c x."""
    a, b, c, _ = robust_controller(0.05)
    rates = np.zeros((8, 8))
    rates[0, 1], rates[1, 2] = 1.0, -INTEGRAL
    rates[1, 3:], rates[2, 3:] = c[0], -c[0]
    rates[3:, 0], rates[3:, 3:] = b[:, 0], a
    return w * rates


@pytest.mark.parametrize(("law", "gains", "options", "sizes", "first", "rates", "tolerance"), [
    # w = Kp e + e' has w' = -P w - I int(w)
    ("cascade-flm", {}, {}, (0.2, 0.0), [1, 0, 0], [[0, 1, 0], [-300, -30, -13], [10, 1, 0]], 6e-3),
    # e'' + D e' + P e + I int(e) = 0; P, I, D = 10, 3, 0 as printed is unstable: it grows as exp(0.149 t)
    *[
        (
            "pid-flm", {"kp": p, "ki": i, "kd": d}, {"arm": arm, **ZERO}, (0.2, -0.2), [1, 0, 0],
            [[0, 1, 0], [-p, -d, -i], [1, 0, 0]], 1e-3 if d else 2e-2,
        )
        for arm, (p, i, d) in ((TABLE_1, (10, 0, 3)), (SECTION_2_2, (10, 0, 3)), (TABLE_1, (10, 3, 0)))
    ],
    # e'' + 2 w e' + w^2 e = 0
    ("computed-torque", {"frequency": 8.0}, HANGING, (0.05, -0.05), [1, 0], [[0, 1], [-64, -16]], 5e-3),
    ("computed-torque-eso", {"controller_bandwidth": 5.0}, {}, (0.2, 0.0), [1, 0], [[0, 1], [-25, -10]], 5e-3),
    # e' = s - slope e, s' = -1.5 (bound / layer)^1/2 s - z, z' = 1.1 bound / layer s
    (
        "sliding-mode", {"slope": 10.0, "bound": 50.0, "layer": 0.5}, HANGING, (0.02, 0.0), [1, 10, 0],
        [[-10, 1, 0], [0, -15, -1], [0, 110, 0]], 0.02,
    ),
    (
        "lqg", {"integral": 300.0, "position": 60.0, "velocity": 6.0}, {}, (0.2, 0.0), [1, 0, 0],
        lqg_rates(300.0, 60.0, 6.0), 0.02,
    ),
    # A small error, so that Coriolis torques vanish.
    ("h-infinity", {"bandwidth": 8.0}, {}, (1e-3, 0.0), np.eye(8)[0], h_infinity_rates(8.0), 0.02),
])  # fmt: skip
def test_the_error_obeys_its_linear_equation(law, gains, options, sizes, first, rates, tolerance):
    """Its states begin in `first`, times the first error of each joint [rad]."""
    steps = 3000 if law == "h-infinity" else 2000
    env = TwoLinkArmEnv(**EXACT | options, initial_error=tuple(-np.array(sizes)))
    errors, _ = tracking(controllers.make(law, env, **gains), env, steps)
    expected = np.outer(response(rates, np.array(first, dtype=float), steps), sizes)
    assert np.abs(errors - expected).max() < tolerance * max(sizes)


def share_of(pole):
    return pole * 1e-3 / np.expm1(pole * 1e-3)


@pytest.mark.parametrize(("law", "gains", "rates"), [
    # e'' + 2 w e' + w^2 e = x, x' = -g x, what is left of M^-1 d to find
    ("computed-torque-tde", {}, [[0, 1, 0], [-64, -16, 1], [0, 0, -12]]),
    # e'' + 2 w e' + w^2 e = f - z, z' = g (k f - z), k = p dt / (exp(p dt) - 1)
    *[
        ("l1-adaptive", {"pole": p}, [[0, 1, 0, 0], [-64, -16, -1, 1], [0, 0, -12, 12 * share_of(p)], [0, 0, 0, 0]])
        for p in (5.0, 200.0)
    ],
])  # fmt: skip
def test_the_error_under_a_constant_load_obeys_its_linear_equation(law, gains, rates):
    """The last state begins in M^-1 d."""
    load = np.array([20.0, 6.0])
    env = TwoLinkArmEnv(**FAST | loaded(*load))
    errors, states = tracking(controllers.make(law, env, frequency=8.0, bandwidth=12.0, **gains), env, 2000)
    push = np.linalg.solve(inertia_matrix(TABLE_1, (-1.0, 0.5)), load)
    expected = np.outer(response(rates, np.eye(len(rates))[-1], 2000), push)
    assert np.abs(errors - expected).max() < 0.03 * np.abs(expected).max()
    if law == "l1-adaptive":
        np.testing.assert_allclose(states[-1][1][0], -share_of(gains["pole"]) * push, rtol=0.01)
    else:
        assert np.abs(errors[-1]).max() < 1e-5


DIAGONAL = np.diagonal(inertia_matrix(TABLE_1, (0.0, 0.0)))


def test_small_motions_under_pid_obey_the_linearised_loop():
    """M e'' + Kd e' + Kp e + Ki int(e) = 0 about a rest, gravity being compensated: compared with the matrix exponential."""
    w, damping, share, start = 10.0, 0.8, 0.3, np.array([1e-3, -1e-3])
    scenario = nominal(**HANGING, initial_error=tuple(-start), control_dt=1e-3, duration=1.0)
    trace = rollout("pid-gravity", scenario, [0], {"frequency": w, "damping": damping, "integral": share})
    # x = (int e, e, e')
    gains = np.kron([share * w**3, w**2, 2 * damping * w], np.diag(DIAGONAL))
    a = np.vstack([np.eye(4, 6, 2), -np.linalg.solve(inertia_matrix(TABLE_1, REST), gains)])
    expected = np.array([(expm(a * t) @ np.concatenate([[0, 0], start, [0, 0]]))[2:4] for t in trace.time[::50]])
    error = (trace.reference - trace.position)[::50, 0]
    assert np.abs(error - expected).max() < 0.03 * np.abs(start).max()


def test_pd_with_gravity_compensation_leaves_the_load_over_its_stiffness():
    """At rest PD leaves e = d / Kp of a constant load, to the gravity compensation's own stiffness."""
    load = (40.0, 10.0)
    scenario = nominal(**loaded(*load) | HANGING, duration=10.0)
    pd = rollout("pd-gravity", scenario, [0], {"frequency": 10.0})
    np.testing.assert_allclose((pd.reference - pd.position)[-1, 0], load / (10.0**2 * DIAGONAL), rtol=1e-3)


@pytest.mark.parametrize("weights", [(3000.0, 200.0, 40.0), (500.0, 100.0, 10.0), (400.0, 400.0, 1.0)])
@pytest.mark.parametrize("dt", [1e-3, 1e-2])
def test_value_iteration_finds_the_gain_of_lqg(weights, dt):
    """The Riccati difference equation, iterated from P = Q, without scipy's solver."""
    f, g = plant(dt)
    q = np.diag(weights) ** 2
    p = q
    for _ in range(round(30.0 / dt)):
        k = (g.T @ p @ f / (1.0 + g.T @ p @ g))[0]
        p = q + f.T @ p @ (f - g @ k[None])
    np.testing.assert_allclose(regulator(dt, *weights), k, rtol=1e-6)


@pytest.mark.parametrize("dead", [0.05, 0.3, 1.0, 2.0])
def test_gamma_is_the_norm_of_the_h_infinity_loop(dead):
    """The largest singular value of [K; 1] (1 - G K)^-1 [G, 1] over frequencies.

    It lies between the least gamma that any controller reaches and the one that was asked for. G is
    the shaped plant with the delay's approximation of second order.
    """
    a, b, c, gamma = robust_controller(dead)
    s = 1j * np.geomspace(1e-4, 1e4, 20001)
    k, x = np.array([(c @ np.linalg.solve(each * np.eye(5) - a, b))[0, 0] for each in s]), dead * s
    g = (s + INTEGRAL) / s**3 * (12 - 6 * x + x**2) / (12 + 6 * x + x**2)
    norm = np.max(np.sqrt((1 + abs(k) ** 2) * (1 + abs(g) ** 2)) / abs(1 - g * k))
    assert gamma / SLACK <= norm * (1 + 1e-6)
    assert norm <= gamma * (1 + 1e-6)


def test_a_bandwidth_beyond_the_dead_time_keeps_its_numbers_finite():
    env = TwoLinkArmEnv("servo-nominal")
    _, states = tracking(controllers.make("h-infinity", env, bandwidth=400.0), env, 500)
    assert np.abs(states[-1].memory).max() < 1e3


# `lqg-elastic`: its filter and prediction; the law on an exact arm with springs, and under a load.


SPRINGS = {"stiffness": (8000.0, 2000.0), "damping": (5.0, 2.0), "rotor_inertia": (3.0, 1.0)}
JOINTS = {"none": None, "link": {**SPRINGS, "encoder": "link"}, "motor": {**SPRINGS, "encoder": "motor"}}


def made(encoder, **gains):
    """Return the law for rigid joints ("none") or springs with the encoders on one side."""
    env = TwoLinkArmEnv(joint=JOINTS[encoder], encoder={"counts": 20_000}, control_dt=2e-3, physics_dt=1e-3)
    return controllers.make("lqg-elastic", env, **gains), env


@pytest.mark.parametrize("encoder", ["none", "link", "motor"])
def test_the_filter_is_optimal(encoder):
    """SciPy's solution of the Riccati equation gives the same gain at each angle."""
    law, env = made(encoder, observer=50.0, links=2.0, reading=1e-4)
    dt, n = 2e-3, 6 if encoder == "none" else 10
    noise = 1e-4 * np.array([0.0, 0.0, 2.0 * 50.0**2, 2.0 * 50.0**2, *[0.0] * (n - 6), *50.0**3 * law.stretched])
    q = np.diag((dt * noise) ** 2)
    h, r = np.eye(n)[:, law.measured], np.diag(np.array(env.interface.resolution) ** 2 / 12.0 + 1e-8)
    for slope, gain in zip(law.slope, law.filtering, strict=True):
        p = solve_discrete_are(expm(dt * np.concatenate([slope, np.zeros((2, n))])).T, h, q, r)
        expected = p @ h @ np.linalg.inv(h.T @ p @ h + r)
        np.testing.assert_allclose(gain, expected, rtol=1e-4, atol=1e-6 * np.abs(gain).max())


def test_the_state_is_predicted_as_by_an_ode_solver():
    """Links, springs and motors under a torque, without the law's own model."""
    law, env = made("motor")
    k, c = np.array(SPRINGS["stiffness"]), np.array(SPRINGS["damping"])
    torque, d = np.array([30.0, -10.0]), np.array([2.0, 1.0])
    x = np.array([-1.2, 0.6, 0.5, -1.0, -1.19, 0.61, 0.4, -1.1])

    def rates(_, x):
        q, v, m, w = x.reshape(4, 2)
        spring = k * (m - q) + c * (w - v)
        acceleration = forward_dynamics(env.interface.nominal, q, v, spring)
        return np.concatenate([v, acceleration, w, (torque + d - spring) / [3, 1]])

    exact = solve_ivp(rates, (0.0, 2e-3), x, method="DOP853", rtol=1e-12, atol=1e-14).y[:, -1]
    start = np.concatenate([x, d])[None], torque[None], torque[None, None]
    found = law.moved(*start, np.array([2e-3]))[0][0]
    assert np.abs(found[:8] - exact).max() < 5e-3 * np.abs(exact - x).max()
    assert np.array_equal(found[8:], d)
    # A delay of whole samples leaves a rest of some 1e-19 s.
    np.testing.assert_allclose(law.moved(*start, np.array([1e-19]))[0][0, :8], x, atol=1e-12)


@pytest.mark.parametrize("encoder", ["link", "motor"])
def test_the_springs_are_seen_through(encoder):
    """An exact arm and drive: the links, which no sensor reads, are estimated and follow their reference."""
    env = TwoLinkArmVectorEnv(
        2, "nominal", joint=JOINTS[encoder], encoder={"counts": 10_000_000}, sensors=("position",), control_dt=2e-3,
        physics_dt=5e-4, actuator={"delay_samples": 1, "lag": 0.003}, initial_error=0.05,
    )  # fmt: skip
    policy = controllers.make("lqg-elastic", env)
    errors, states = tracking(policy, env, 1000)
    assert np.abs(states[-1].estimate[:, :2] - env.truth.position).max() < 1e-4
    assert np.abs(states[-1].estimate[:, 4:6] - env.truth.motor_position).max() < 1e-4
    assert np.abs(errors[0]).max() == pytest.approx(0.05)
    assert np.median(np.abs(errors[500:])) < 5e-5


def test_dry_friction_is_learned():
    """On an arm that is exact but for friction and a load: where the motion turns round, the law knows what comes."""
    env = TwoLinkArmVectorEnv(
        1, "nominal", friction={"coulomb": (3.0, 1.0)}, encoder={"counts": 1_000_000}, sensors=("position",),
        control_dt=2e-3, physics_dt=1e-3, duration=6.0, **loaded(4.0, -2.0) | {"reference": {"kind": "sine"}},
    )  # fmt: skip
    errors, states = tracking(controllers.make("lqg-elastic", env, friction=1.0), env, 2999)
    unlearned, _ = tracking(controllers.make("lqg-elastic", env, friction=1e9), env, 2999)
    np.testing.assert_allclose(states[-1].dry[0], [3.0, 1.0], rtol=0.05)
    np.testing.assert_allclose(states[-1].mean[0], [-4.0, 2.0], rtol=0.05)
    assert np.abs(errors[2000:]).mean() < 0.3 * np.abs(unlearned[2000:]).mean()


@pytest.mark.parametrize("encoder", ["none", "motor"])
def test_a_large_error_is_braked_in_time(encoder):
    """With little torque, arms far off arrive without an overshoot."""
    env = TwoLinkArmVectorEnv(
        8, "nominal", joint=JOINTS[encoder], encoder={"counts": 1_000_000}, sensors=("position",), control_dt=2e-3,
        physics_dt=1e-3, actuator={"torque_limit": (1000.0, 300.0)}, initial_error=0.3, reference=STILL,
    )  # fmt: skip
    overshoot = []
    for braking in (0.4, 1e9):
        errors, _ = tracking(controllers.make("lqg-elastic", env, bandwidth=60.0, braking=braking), env, 1000)
        overshoot.append((-errors * np.sign(errors[0])).max())
    assert overshoot[0] < 0.005 < 0.05 < overshoot[1]


def test_the_schedule_mixes_two_laws_by_its_equation():
    """Both are settled by the torque that is sent; the share follows from the change of their difference."""
    law, env = made("none")
    gains = {"onset": 0.17, "memory": 0.02}
    scheduled = controllers.make("lqg-elastic-scheduled", env, **gains)
    laws = [controllers.make("lqg-elastic", env, observer=k * law.observer) for k in (0.5, 1.3)]
    observation = env.reset(seed=0)[0][None]
    state, states = scheduled.initial(observation), [each.initial(observation) for each in laws]
    before, c, shares = np.zeros((1, 2)), np.zeros((1, 2)), []
    for _ in range(60):
        (one, first), (two, second) = (x.decide(observation, own) for x, own in zip(laws, states, strict=True))
        apart = (one - two) / law.stretched
        c, before = c + 2e-3 / 0.02 * ((apart - before) ** 2 - c), apart
        shares.append(c**2 / (c**2 + 0.17**4))
        torque, state = scheduled.torque(observation, state)
        np.testing.assert_allclose(torque, shares[-1] * one + (1.0 - shares[-1]) * two, rtol=1e-9)
        states = [each.settle(own, torque) for each, own in zip(laws, (first, second), strict=True)]
        observation = env.step(env.interface.action_from_torque(torque, *law.measured_motion(observation))[0])[0][None]
    assert np.min(shares) < 0.2 < 0.8 < np.max(shares)


def test_a_careful_law_is_slower_than_the_fast_one():
    with pytest.raises(ValueError, match=r"careful must be less than fast=1.3, got 2"):
        controllers.make("lqg-elastic-scheduled", made("none")[1], careful=2.0)
