"""Computed torque against its error equation, and the momentum observer against its time constant."""

import numpy as np
import pytest

import controllers
from benchmarks.run.rollout import rollout
from fbl_gym import ArmParameters, TwoLinkArmVectorEnv, scenarios

STILL = {"kind": "minimum-jerk", "points": ((-np.pi / 2, 0.4),)}


def test_the_error_equation():
    """e'' + 2 w e' + w^2 e = 0 with an exact model: e = E (1 + w t) exp(-w t) from rest."""
    w = 8.0
    scenario = scenarios.get("nominal").replace(
        reference=STILL, initial_error=(0.05, -0.05), control_dt=1e-3, actuator=None, duration=1.5
    )
    trace = rollout("computed-torque", scenario, [0], {"frequency": w})
    error = (trace.reference - trace.position)[:, 0]
    expected = error[0] * (1 + w * trace.time[:, None]) * np.exp(-w * trace.time[:, None])
    assert np.abs(error - expected).max() < 5e-3 * np.abs(error[0]).max()


@pytest.mark.parametrize(("share", "grows"), [(0.95, False), (1.05, True)])
def test_where_the_sampled_loop_is_stable(share, grows):
    """q+ = q + v dt + u dt^2 / 2, v+ = v + u dt with u = -k (w^2 q + 2 w v), k the model's inertia over the real one: the
    characteristic polynomial at z = -1 is 4 (1 - k w dt), so k < 1 / (w dt)."""
    w, dt = 20.0, 0.01
    ratio = share / (w * dt)
    scenario = scenarios.get("nominal").replace(
        arm=ArmParameters(gravity=0.0), reference=STILL, initial_error=(1e-4, -1e-4), actuator=None, duration=4.0,
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
    scenario = scenarios.get("nominal").replace(
        reference=STILL, control_dt=control_dt, disturbance={"kind": "array", "torque": (tuple(load),)}, duration=1.0
    )
    env = TwoLinkArmVectorEnv(1, scenario)
    policy, state = controllers.make("computed-torque-dob", env, bandwidth=bandwidth), None
    observation, _ = env.reset(seed=0)
    found = []
    for _ in range(scenario.steps):
        action, state = policy.predict(observation, state)
        observation = env.step(action)[0]
        found.append(state[0][0])
    t = control_dt * np.arange(scenario.steps)[:, None]
    # The first sample of an episode ends no interval.
    expected = load * (1 - np.exp(-bandwidth * t))
    assert np.abs(np.array(found) - expected).max() < 0.02 * np.abs(load).max()


def test_the_observer_takes_a_load_away():
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
    policy, state = controllers.make("computed-torque-dob", env), None
    observation, _ = env.reset(seed=0)
    for _ in range(scenario.steps):
        action, state = policy.predict(observation, state)
        observation = env.step(action)[0]
        assert np.abs(state[0]).max() < 100.0


def test_bad_gains_are_named():
    with pytest.raises(ValueError, match="bandwidth must be"):
        controllers.make("computed-torque-dob", TwoLinkArmVectorEnv(1), bandwidth=0)
    with pytest.raises(ValueError, match="frequency must be"):
        controllers.make("computed-torque", TwoLinkArmVectorEnv(1), frequency=-1)
