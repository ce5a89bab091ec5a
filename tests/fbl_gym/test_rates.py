"""Control rate and physics step: the motion between two decisions does not depend on their rate."""

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from fbl_gym import Scenario
from tests.fbl_gym.episodes import PLANT, started, torques
from tests.fbl_gym.test_fuzz import environments, without


@settings(max_examples=60, deadline=None, suppress_health_check=list(HealthCheck))
@given(environments(), st.integers(0, 1000))
def test_a_held_decision_is_the_same_as_a_repeated_one(options, seed):
    """To the bit: n physics steps under one command are n intervals of one step under the same command.

    Delay, lag, payload, events and every disturbance act at their times, multiples of control_dt or not.
    """
    drive = without(options.get("actuator"), "jitter", "delay_samples")  # these count in control steps
    options = {**without(options, "limits"), "action": "torque", "actuator": drive}
    coarse = started(**options, seed=seed)
    fine = started(**{**options, "control_dt": options["physics_dt"]}, seed=seed)
    for k in range(coarse.scenario.steps):
        torque = torques(7 * k, 1)[0]
        coarse.step(torque)
        for _ in range(coarse.scenario.substeps):
            if fine.step(torque)[2]:
                return
        for name in set(PLANT) - {"reference"}:
            np.testing.assert_array_equal(getattr(coarse.truth, name), getattr(fine.truth, name), err_msg=name)


@pytest.mark.parametrize(
    ("control_dt", "physics_dt", "substeps"),
    [(0.01, 0.001, 10), (0.001, 0.001, 1), (0.3, 0.1, 3), (1 / 30, 1 / 300, 10), (0.02, 1e-4, 200), (0.7, 0.1, 7)],
)
def test_any_physics_step_that_divides_the_control_step_works(control_dt, physics_dt, substeps):
    scenario = Scenario(control_dt=control_dt, physics_dt=physics_dt, duration=3 * control_dt)
    assert scenario.substeps == substeps
    env = started(scenario)
    assert [env.step((0.0, 0.0))[3] for _ in range(3)] == [False, False, True]
    assert env.truth.time == pytest.approx(3 * control_dt)
