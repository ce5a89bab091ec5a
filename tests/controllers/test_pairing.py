"""A law that learns what torque is missing pairs the motion with the torque of its time."""

import numpy as np
import pytest

import controllers
from fbl_gym import TwoLinkArmEnv
from fbl_gym.model.arm import inertia_matrix
from tests.controllers.closed_loop import tracking

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
    env = TwoLinkArmEnv(actuator={"delay": 0.025, "lag": 0.02}, reference=MOTION, duration=4.0)
    _, states = tracking(controllers.make(name, env), env, 390)
    estimate, left = ESTIMATES[name]
    assert max(np.abs(estimate(state)).max() for state in states) < left
