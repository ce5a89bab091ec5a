"""Computed torque and what is built on it: observers, estimates and learned torques, and sliding modes.

Error equations, poles, stability limits, Lyapunov functions; errors that a constant load leaves, integrators that pause.
"""

import dataclasses

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.linalg import solve_continuous_are

import controllers
from benchmarks.run.rollout import rollout
from controllers.parts import Eso
from fbl_gym import TABLE_1, ArmParameters, TwoLinkArmEnv, TwoLinkArmVectorEnv, scenarios
from fbl_gym.model.arm import forward_dynamics, gravity_torque, inertia_matrix
from tests.controllers.closed_loop import EXACT, HANGING, REST, STILL, loaded, loop, nominal, tracking


@pytest.mark.parametrize(("share", "grows"), [(0.95, False), (1.05, True)])
def test_the_sampled_loop_has_its_stability_limit(share, grows):
    """q+ = q + v dt + u dt^2 / 2, v+ = v + u dt with u = -k (w^2 q + 2 w v), k the model's inertia over the real one: the
    characteristic polynomial at z = -1 is 4 (1 - k w dt), so k < 1 / (w dt)."""
    w, dt = 20.0, 0.01
    ratio = share / (w * dt)
    scenario = nominal(
        arm=ArmParameters(gravity=0.0), **HANGING, initial_error=(1e-4, -1e-4), actuator=None, duration=4.0,
        parameter_error={"ratio": (1 / ratio, 1 / ratio, 1.0, 1.0)}, control_dt=dt,
    )  # fmt: skip
    trace = rollout("computed-torque", scenario, [0], {"frequency": w})
    early, late = (np.abs(trace.reference - trace.position)[rows].max() for rows in (slice(0, 10), slice(90, 100)))
    assert (late > 2 * early) if grows else (late < 0.5 * early)


@pytest.mark.parametrize("control_dt", [1e-3, 1e-2])
@pytest.mark.parametrize("bandwidth", [5.0, 20.0])
def test_the_observer_has_its_time_constant(control_dt, bandwidth):
    """A constant load on an exact model: the estimate is d (1 - exp(-bandwidth t)) at the samples."""
    load = np.array([60.0, -25.0])
    scenario = nominal(**loaded(*load) | HANGING, control_dt=control_dt, duration=1.0)
    env = TwoLinkArmVectorEnv(1, scenario)
    policy = controllers.make("computed-torque-dob", env, bandwidth=bandwidth)
    _, states = tracking(policy, env, scenario.steps)
    estimate = np.array([state.disturbance[0] for state in states])
    t = control_dt * np.arange(scenario.steps)[:, None]
    # The first sample of an episode ends no interval.
    expected = load * (1 - np.exp(-bandwidth * t))
    assert np.abs(estimate - expected).max() < 0.02 * np.abs(load).max()


#: A bandwidth at which nothing is filtered [rad/s].
AT_ONCE = 1e6


def test_without_the_filter_the_law_is_incremental():
    """tau = tau_0 + M(q) (a - a_0): nominal Coriolis and gravity torques cancel (Sieberling, Chu and Mulder 2010, eq. 9)."""
    env = TwoLinkArmVectorEnv(3, "everything-1", action="torque", actuator=None)
    policy = controllers.make("computed-torque-tde", env, bandwidth=AT_ONCE, frequency=8.0)
    before = None
    for observation, _, torque, _ in loop(policy, env, 100):
        q, v, a = policy.read(observation, "position", "velocity", "acceleration")
        r, dr, ddr = np.split(observation[:, env.layout.reference[:6]], 3, axis=1)
        desired = ddr + 64.0 * (r - q) + 16.0 * (dr - v)
        before = gravity_torque(env.interface.nominal, q) if before is None else before
        expected = before + np.einsum("nij,nj->ni", inertia_matrix(env.interface.nominal, q), desired - a)
        np.testing.assert_allclose(torque, expected, rtol=1e-9, atol=1e-9)
        before = torque


@pytest.mark.parametrize("k", [0.2, 1.0, 4.0])
def test_the_estimate_has_its_pole(k):
    """Masses 1 / k of the nominal ones, held in place: what is left to find shrinks by 1 - k (1 - exp(-g dt)) per sample."""
    g, q = 15.0, np.array([-1.0, 0.5])
    env = TwoLinkArmEnv(reference=STILL, actuator=None, action="torque")
    real = ArmParameters(TABLE_1.m1 / k, TABLE_1.m2 / k, TABLE_1.L1, TABLE_1.L2)
    policy = controllers.make("computed-torque-tde", env, bandwidth=g)
    observation, _ = env.reset(seed=0)
    torque, state, log = gravity_torque(env.interface.nominal, q), None, []
    for _ in range(60):
        observation = observation.copy()
        observation[env.layout["acceleration"]] = forward_dynamics(real, q, np.zeros(2), torque)
        torque, state = policy.predict(observation, state)
        log.append(state.missed[0])
    # At rest and on its reference the arm needs G of the real arm: d = (1 / k - 1) G.
    left = np.array(log) - (1.0 / k - 1.0) * gravity_torque(TABLE_1, q)
    pole = 1.0 - k * (1.0 - np.exp(-g * 0.01))
    expected = left[0] * pole ** np.arange(60)[:, None]
    np.testing.assert_allclose(left, expected, atol=1e-9 * np.abs(gravity_torque(TABLE_1, q)).max())


def last_error(masses, **gains):
    """Return the largest error of the last of nine seconds, at 100 Hz, of an arm of `masses` times the nominal ones."""
    heavy = {"parameter_error": {"ratio": {"m1": masses, "m2": masses}}, "limits": {"velocity": 1e3}}
    scenario = nominal(reference=STILL, initial_error=(-0.01, 0.0), actuator=None, duration=9.0, **heavy)
    trace = rollout("computed-torque-tde", scenario, [0], gains)
    return np.abs(trace.reference - trace.position)[-100:].max() if trace.alive[-1] else np.inf


@pytest.mark.parametrize(("bandwidth", "frequency"), [(AT_ONCE, 5.0), (12.0, 5.0), (12.0, 15.0)])
def test_estimation_is_stable_up_to_its_limit_of_inertia(bandwidth, frequency):
    """Masses 1 / k of the nominal ones: stable for k < 2 / (h + 2 w dt - h w dt), h = 1 - exp(-g dt), and not beyond.

    h = 1 and w dt -> 0 is the condition of time-delay control, k < 2.
    """
    h = -np.expm1(-bandwidth * 0.01)
    most = 2.0 / (h + 2.0 * frequency * 0.01 - h * frequency * 0.01)
    gains = {"bandwidth": bandwidth, "frequency": frequency}
    assert last_error(1.0 / (0.9 * most), **gains) < 1e-3
    assert last_error(1.0 / (1.1 * most), **gains) > 1e-2


def test_moreno_and_osorios_lyapunov_function_decreases():
    """s' = -k1 |s|^1/2 sign s + x,  x' = -k2 sign s + f' on an exact model, where f = M^-1 d and |f'| stays below 0.9 L.

    With zeta = (|s|^1/2 sign s, x):  zeta' = |s|^-1/2 (A zeta + B u), |u| < 0.95 L |zeta_1|. So V = zeta'P zeta falls for a P
    with A'P + PA + PBB'P + (0.95 L)^2 C'C < 0, from Riccati's equation, and s = 0 is reached in finite time.
    """
    bound, slope, dt, frequency = 50.0, 15.0, 1e-4, 2.0
    k1, k2 = 1.5 * np.sqrt(bound), 1.1 * bound
    a, b, c = np.array([[-k1 / 2, 0.5], [-k2, 0.0]]), np.array([[0.0], [1.0]]), np.array([[1.0, 0.0]])
    p = solve_continuous_are(a, b, (0.95 * bound) ** 2 * c.T @ c + 0.01 * np.eye(2), -np.eye(1))
    assert np.all(np.linalg.eigvalsh(p) > 0)
    load = inertia_matrix(TABLE_1, REST) @ np.full(2, 0.9 * bound / (2 * np.pi * frequency))
    env = TwoLinkArmEnv(
        **HANGING, initial_error=(-0.02, 0.01), actuator=None, action="torque",
        disturbance={"kind": "sine", "amplitude": tuple(load), "frequency": frequency, "phase": 0.0},
        control_dt=dt, physics_dt=dt, duration=0.3,
    )  # fmt: skip
    policy, log = controllers.make("sliding-mode", env, slope=slope, bound=bound, layer=0.0), []
    for observation, state, *_ in loop(policy, env, 2900):
        q, v, r, dr = policy.read(observation, "position", "velocity", "reference_position", "reference_velocity")
        s = dr - v + slope * (r - q)
        f = np.linalg.solve(inertia_matrix(TABLE_1, q), env.truth.disturbance)
        zeta = np.stack([np.sqrt(np.abs(s)) * np.sign(s), f - (state.integral[0] if state else 0.0)])
        log.append((np.einsum("ij,ik,kj->j", zeta, p, zeta), np.abs(s)))
    value, surface = np.swapaxes(log, 0, 1)
    # Closer than that, one sample steps over s = 0.
    assert np.diff(value, axis=0)[surface[:-1] > 1e3 * bound * dt**2].max() < 0.0
    # Levant: a sampled second-order sliding mode keeps |s| within a few L dt^2.
    assert surface[2000:].max() < 10 * bound * dt**2


def test_no_limit_cycle_is_left_behind_a_delay():
    """The damping does not vanish at s = 0."""
    env = TwoLinkArmEnv(**HANGING, initial_error=(-0.05, 0.02), actuator={"delay_samples": 1, "lag": 0.01})
    errors, _ = tracking(controllers.make("sliding-mode", env), env, 500)
    assert np.abs(errors[-50:]).max() < 1e-9


def test_terminal_sliding_mode_follows_its_equation():
    """Exact model, 1 kHz, from rest: e'' = -w / p |e'|^(2-p) sign(e') - bound sat(w^2 s / bound), by scipy's solver."""
    w, power, bound, e0 = 8.0, 1.4, 5.0, 0.2
    env = TwoLinkArmEnv(**EXACT | HANGING, initial_error=(-e0, 0.0))
    law = controllers.make("terminal-sliding-mode", env, frequency=w, power=power, bound=bound)
    errors, _ = tracking(law, env, 1000)

    def rates(_, x):
        e, rate = x
        s = e + np.sign(rate) * abs(rate) ** power / w
        return rate, -w / power * np.sign(rate) * abs(rate) ** (2 - power) - np.clip(w**2 * s, -bound, bound)

    expected = solve_ivp(rates, (0.0, 1.0), (e0, 0.0), t_eval=1e-3 * np.arange(1001), rtol=1e-8, atol=1e-10).y[0]
    assert np.abs(errors[:, 0] - expected).max() < 0.01 * e0


def test_terminal_sliding_mode_of_power_one_is_computed_torque():
    """Within the layer e'' + 2 w e' + w^2 e = 0, with the same observer."""
    scenario = scenarios.get("payload-2").replace(duration=1.0)
    terminal = rollout("terminal-sliding-mode", scenario, [0], {"frequency": 9.0, "power": 1.0, "bound": 1e6})
    computed = rollout("computed-torque-dob", scenario, [0], {"frequency": 9.0})
    np.testing.assert_allclose(terminal.position, computed.position, atol=1e-9)


# Disturbances that laws estimate or learn.


MOTION = {"kind": "fourier", "centre": (-np.pi / 2, 0.0), "frequency": 0.3}
INERTIA = np.diagonal(inertia_matrix(TwoLinkArmEnv().interface.nominal, (0.0, 0.0)))
ESTIMATES = {
    # the estimate [rad/s^2], and what the law's sampling leaves of it; paired wrongly, the loop is unstable
    "computed-torque-dob": (lambda state: state.disturbance / INERTIA, 0.01),
    "computed-torque-tde": (lambda state: state.missed / INERTIA, 1e-9),
    "l1-adaptive": (lambda state: state.filtered, 1.0),
    "computed-torque-eso": (lambda state: state.memory[..., 2], 1.0),
}


@pytest.mark.parametrize("name", ESTIMATES)
def test_nothing_is_missing_from_an_exact_model_behind_a_slow_drive(name):
    """A law that learns what torque is missing pairs the motion with the torque of its time."""
    env = TwoLinkArmEnv(actuator={"delay": 0.025, "lag": 0.02}, reference=MOTION, duration=4.0)
    _, states = tracking(controllers.make(name, env), env, 390)
    estimate, left = ESTIMATES[name]
    assert max(np.abs(estimate(state)).max() for state in states) < left


LIMITS = {"torque_limit": (330.0, 120.0)}


@pytest.mark.parametrize("name", ["l1-adaptive", "computed-torque-eso", "computed-torque-dob"])
def test_saturation_is_not_taken_for_a_disturbance(name):
    """Driven by the torque within its limits, the observer of an exact model sees nothing while the torque is cut off."""
    env = TwoLinkArmEnv(reference=STILL, initial_error=(-1.0, 0.0), actuator=LIMITS)
    errors, states = tracking(controllers.make(name, env), env, 600)
    estimate, _ = ESTIMATES[name]
    assert max(np.abs(estimate(state)).max() for state in states) < 5.0
    assert np.abs(errors[-1]).max() < 1e-3


#: Laws with the sensors that they need, of which an accelerometer may be biased.
INTEGRATING = {
    "cascade-flm": {}, "computed-torque-dob": {}, "pid-gravity": {}, "computed-torque-eso": {"sensors": ("position",)},
    "h-infinity": {"sensors": ("position",)}, "ladrc": {"sensors": ("position",)}, "lqg-elastic": {"sensors": ("position",)},
    "lqg": {"sensors": ("position", "acceleration"), "noise": {"acceleration": {"bias": 0.5}}},
}  # fmt: skip


@pytest.mark.parametrize("name", INTEGRATING)
def test_no_error_is_left_of_a_constant_load(name):
    env = TwoLinkArmEnv(**loaded(20.0, 8.0), duration=20.0, **INTEGRATING[name])
    errors, _ = tracking(controllers.make(name, env), env, 1999)
    assert np.abs(errors[-1]).max() < 1e-4
    assert np.abs(errors).max() > 1e-3


@pytest.mark.parametrize("name", ["pid-flm", "cascade-flm"])
def test_integrators_pause_while_the_torque_saturates(name, monkeypatch):
    """Held back by its torque limit, the arm does not store what would throw it past the reference."""
    gains = {"ki": 20.0, "kp": 30.0, "kd": 10.0} if name == "pid-flm" else {}
    options = {"reference": {"kind": "minimum-jerk", "points": ((-0.6, 0.0),)}, "initial_error": (-1.0, 0.0)}

    def overshoot(actuator=LIMITS):
        env = TwoLinkArmEnv(**options, actuator=actuator, action="torque")
        return -tracking(controllers.make(name, env, **gains), env, 900)[0][:, 0].min()

    paused, unlimited = overshoot(), overshoot(actuator=None)
    monkeypatch.setattr("controllers.base.winds_up", lambda *arguments: np.zeros_like(arguments[2], dtype=bool))
    wound_up = overshoot()
    assert wound_up > 1.3 * unlimited
    # Of the overshoot that the limit adds to that of an unlimited arm, three quarters and more are avoided.
    assert paused - unlimited < 0.25 * (wound_up - unlimited)


def test_the_integral_of_pid_does_not_wind_up():
    env = TwoLinkArmEnv(**HANGING, actuator={"torque_limit": (250, 100)}, initial_error=(2.0, 0.0), duration=10.0)
    errors, _ = tracking(controllers.make("pid-gravity", env), env, 1000)
    assert np.abs(errors[-1]).max() < 1e-2


def error_dynamics(observer):
    """The matrix [3 x 3] by which the prediction of the first joint nears the truth, found by asking the observer."""
    # The truth is 0 and the prediction e: the plant stays at 0, and the next prediction is the error.
    rest, predictions = np.zeros((3, 2)), np.repeat(np.eye(3, 4)[:, None], 2, axis=1)
    return observer.predict(observer.correct(predictions, rest), rest)[:, 0, :3].T


@pytest.mark.parametrize("dt", [1e-3, 1e-2, 1e-1])
@pytest.mark.parametrize("w", [5.0, 80.0, 300.0])
def test_the_observer_has_its_three_poles(dt, w):
    """det(z - F + F L H) = (z - exp(-w dt))^3: three equal poles, inside the circle at every rate."""
    polynomial = np.poly(error_dynamics(Eso(dt, w)))
    np.testing.assert_allclose(polynomial, np.poly([np.exp(-w * dt)] * 3), rtol=1e-7, atol=1e-7)


def test_ladrc_knows_one_number_of_each_joint():
    """With another gravity in the nominal model, the torque is the same."""
    env = TwoLinkArmEnv()
    light = dataclasses.replace(env.interface, nominal=dataclasses.replace(env.interface.nominal, gravity=0.0))
    law, other = (controllers.make("ladrc", interface) for interface in (env.interface, light))
    for observation, state, action, _ in loop(law, env, 20):
        np.testing.assert_array_equal(other.predict(observation, state)[0], action)
