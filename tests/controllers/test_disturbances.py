"""Disturbances that laws estimate, errors that a constant load leaves, and integrators that pause."""

import numpy as np
import pytest

import controllers
from fbl_gym import TwoLinkArmEnv
from fbl_gym.model.arm import inertia_matrix
from tests.controllers.closed_loop import STILL, loaded, tracking

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


INTEGRATING = {
    "cascade-flm": {}, "computed-torque-dob": {}, "pid-gravity": {}, "computed-torque-eso": {"sensors": ("position",)},
    "h-infinity": {"sensors": ("position",)}, "ladrc": {"sensors": ("position",)},
    "lqg": {"sensors": ("position", "acceleration"), "noise": {"acceleration": {"bias": 0.5}}},
}  # fmt: skip
"""Laws with the sensors that they need, of which an accelerometer may be biased."""


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
    module = f"controllers.paper.{name.split('-')[0]}.winds_up"
    monkeypatch.setattr(module, lambda *arguments: np.zeros_like(arguments[2], dtype=bool))
    wound_up = overshoot()
    assert wound_up > 1.3 * unlimited
    # Of the overshoot that the limit adds to that of an unlimited arm, three quarters and more are avoided.
    assert paused - unlimited < 0.25 * (wound_up - unlimited)
