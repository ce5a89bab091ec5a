"""The filter and the prediction against SciPy and an ODE solver; the law on an exact arm with springs, and under a load."""

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.linalg import expm, solve_discrete_are

import controllers
from fbl_gym import TwoLinkArmEnv, TwoLinkArmVectorEnv
from fbl_gym.model.arm import forward_dynamics
from tests.controllers.closed_loop import STILL, loaded, tracking

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
