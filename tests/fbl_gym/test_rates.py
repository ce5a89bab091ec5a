"""Control rate and physics step: the motion between two decisions does not depend on their rate."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from fbl_gym import Scenario, TwoLinkArmEnv
from tests.fbl_gym.episodes import started
from tests.fbl_gym.paired_runs import PLANT, torques

STEPS = st.integers(1, 60)
WORLDS = st.fixed_dictionaries(
    {},
    optional={
        "parameter_error": st.fixed_dictionaries(
            {"radius": st.just(0.5), "mass": st.just(5.0), "pick_up": st.integers(0, 50), "carry": st.integers(1, 50)}
        ),
        "friction": st.sampled_from(
            [
                {"viscous": 4.0},
                {"coulomb": 30.0, "stiction": (10.0, 3.0)},
                {"coulomb": 3.0, "law": "literal", "viscous": (0.0, 2.0)},
            ]
        ),
        "disturbance": st.one_of(
            st.fixed_dictionaries({"kind": st.just("piecewise-constant"), "period": STEPS}),
            st.fixed_dictionaries(
                {"kind": st.just("pulses"), "period": STEPS, "width": st.integers(1, 60), "start": st.integers(0, 60)}
            ).filter(lambda disturbance: disturbance["width"] <= disturbance["period"]),
            st.fixed_dictionaries({"kind": st.just("sine")}),
            st.fixed_dictionaries({"kind": st.just("array"), "dt": STEPS}),
        ),
        "actuator": st.fixed_dictionaries({"delay": st.integers(0, 40), "lag": st.sampled_from([0.0, 0.02])}),
    },
)


def in_seconds(world):
    """Return options in seconds from options in physics steps of 1 ms."""
    options = {name: dict(value) for name, value in world.items()}
    if "parameter_error" in options:
        error = options["parameter_error"]
        begin = error.pop("pick_up")
        error["payload"] = {
            "mass": error.pop("mass"),
            "pick_up": begin * 1e-3,
            "drop": (begin + error.pop("carry")) * 1e-3,
        }
    if "disturbance" in options:
        disturbance = options["disturbance"]
        disturbance.update(
            {name: disturbance[name] * 1e-3 for name in ("period", "width", "start", "dt") if name in disturbance}
        )
        if disturbance["kind"] == "array":
            disturbance["torque"] = np.random.default_rng(0).uniform(-90, 90, (7, 2)).tolist()
        else:
            disturbance["amplitude"] = (90.0, 30.0)
    if "actuator" in options:
        options["actuator"]["delay"] *= 1e-3
    return options


@settings(max_examples=30, deadline=None)
@given(WORLDS, st.sampled_from([2, 5, 7, 10]), st.integers(0, 1000))
def test_a_held_decision_is_the_same_as_a_repeated_one(world, substeps, seed):
    """To the bit: n physics steps under one command are n intervals of one step under the same command.

    Delay, lag, payload and every disturbance act at their times, multiples of control_dt or not.
    """
    options = in_seconds(world)
    coarse = TwoLinkArmEnv(action="torque", control_dt=substeps * 1e-3, duration=substeps, **options)
    fine = TwoLinkArmEnv(action="torque", control_dt=1e-3, **options)
    coarse.reset(seed=seed)
    fine.reset(seed=seed)
    for k in range(80 // substeps):
        torque = torques(7 * k, 1)[0]
        coarse.step(torque)
        for _ in range(substeps):
            fine.step(torque)
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
