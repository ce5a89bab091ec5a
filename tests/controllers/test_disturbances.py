"""Disturbances that laws estimate or learn, errors that a constant load leaves, and integrators that pause."""

import dataclasses

import numpy as np
import pytest

import controllers
from controllers.laws.gaussian_process import SIGNAL
from controllers.parts import Eso
from fbl_gym import TwoLinkArmEnv
from fbl_gym.model.arm import inertia_matrix, inverse_dynamics
from tests.controllers.closed_loop import EXCITING, HANGING, STILL, loaded, loop, mean_error, tracking

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


def test_the_torque_has_the_mean_of_a_gaussian_process():
    """k' (K + s^2 I)^-1 y over all samples, kernel of random cosines and time (Rasmussen and Williams 2006, (2.25))."""
    env = TwoLinkArmEnv(parameter_error={"radius": 0.3}, actuator=None, action="torque", reference=EXCITING)
    policy = controllers.make("computed-torque-gp", env, memory=0.5, noise=0.2)
    frequencies, phases = policy.spectrum
    rows, targets, before, last = [], [np.zeros(2)], None, None
    for observation, _, torque, _ in loop(policy, env, 60):
        q, v = policy.read(observation, "position", "velocity")
        reference = observation[env.layout.reference[:6]]
        rows.append(np.cos(reference @ frequencies + phases) * np.sqrt(2 / len(phases)))
        if before is not None:
            model = inverse_dynamics(env.interface.nominal, q, 0.5 * (v + last), (v - last) / 0.01)
            targets.append((before - model) / policy.weight)
        z, before, last = np.array(rows), torque, v
        time = 0.01 * np.arange(len(z))
        kernel = SIGNAL**2 * z @ z.T * np.exp(-np.abs(time[:, None] - time) / 0.5)
        mean = kernel[-1] @ np.linalg.solve(kernel + 0.2**2 * np.eye(len(z)), np.array(targets))
        wanted = policy.acceleration(observation[None], q[None], v[None])[0]
        plain = inverse_dynamics(env.interface.nominal, q, v, wanted)
        np.testing.assert_allclose(torque, plain + policy.weight * mean, rtol=1e-6, atol=1e-6)


def test_it_learns_what_the_model_misses():
    """On a wrong arm behind a delayed drive, the error falls to a fraction of that of computed torque."""
    wrong = {"parameter_error": {"radius": 0.2}, "friction": {"viscous": 10.0}}
    late = {"actuator": {"delay_samples": 1, "lag": 0.01}}
    options = {"steps": 1400, "skip": 901, "lanes": 2, "reference": EXCITING, "duration": 15.0, **wrong, **late}
    plain, learned = (mean_error(f"computed-torque{law}@frequency=10", **options) for law in ("", "-gp"))
    assert learned < 0.4 * plain
