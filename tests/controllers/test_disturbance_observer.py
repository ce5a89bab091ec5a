"""The momentum observer against its time constant, a constant load and saturation."""

import numpy as np
import pytest

import controllers
from benchmarks.run.rollout import rollout
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


def test_the_observer_rejects_a_constant_load():
    """At rest nothing is left of a constant load, of which computed torque alone leaves M^-1 d / w^2."""
    scenario = scenarios.get("nominal").replace(
        reference=STILL, disturbance={"kind": "array", "torque": ((60.0, -25.0),)}, duration=4.0
    )
    plain = rollout("computed-torque", scenario, [0], {"frequency": 10.0})
    observed = rollout("computed-torque-dob", scenario, [0], {"frequency": 10.0})
    left, gone = (np.abs(trace.reference - trace.position)[-1, 0] for trace in (plain, observed))
    assert gone.max() < 1e-5
    assert left.max() > 1e-2


def test_the_observer_does_not_wind_up():
    """The applied torque drives it, so a load beyond the limits does not drive the estimate away."""
    scenario = scenarios.get("nominal").replace(reference=STILL, actuator={"torque_limit": (400, 150)}, duration=3.0)
    env = TwoLinkArmVectorEnv(1, scenario.replace(initial_error=(2.0, 0.0)))
    _, states = tracking(controllers.make("computed-torque-dob", env), env, scenario.steps)
    assert max(np.abs(state.disturbance).max() for state in states) < 100.0
