"""The momentum observer against its time constant, a constant load and saturation."""

import numpy as np
import pytest

import controllers
from fbl_gym import TwoLinkArmVectorEnv, scenarios
from tests.controllers.closed_loop import tracking

STILL = {"kind": "minimum-jerk", "points": ((-np.pi / 2, 0.4),)}


@pytest.mark.parametrize("control_dt", [1e-3, 1e-2])
@pytest.mark.parametrize("bandwidth", [5.0, 20.0])
def test_the_observer_has_its_time_constant(control_dt, bandwidth):
    """A constant load on an exact model: the estimate is d (1 - exp(-bandwidth t)) at the samples."""
    load = np.array([60.0, -25.0])
    scenario = scenarios.get("nominal").replace(
        reference=STILL, control_dt=control_dt, disturbance={"kind": "array", "torque": (tuple(load),)}, duration=1.0
    )
    env = TwoLinkArmVectorEnv(1, scenario)
    policy = controllers.make("computed-torque-dob", env, bandwidth=bandwidth)
    _, states = tracking(policy, env, scenario.steps)
    estimate = np.array([state.disturbance[0] for state in states])
    t = control_dt * np.arange(scenario.steps)[:, None]
    # The first sample of an episode ends no interval.
    expected = load * (1 - np.exp(-bandwidth * t))
    assert np.abs(estimate - expected).max() < 0.02 * np.abs(load).max()
