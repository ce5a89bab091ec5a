"""The tiers hardware, surprise and practice."""

import dataclasses

import numpy as np
import pytest

from benchmarks.run.rollout import reference_motion
from fbl_gym import Scenario, TwoLinkArmVectorEnv, scenarios
from fbl_gym.model.arm import TABLE_1, ArmParameters, inertia_matrix, inverse_dynamics
from fbl_gym.records import middle
from fbl_gym.scenarios.hardware import ARM, FAMILIES, MOVES

BOARD = (*scenarios.in_tier("hardware"), *scenarios.in_tier("surprise"))


@pytest.mark.parametrize("name", [*BOARD, *scenarios.in_tier("practice")])
def test_every_scenario_has_what_limits_a_laboratory(name):
    scenario = scenarios.get(name)
    assert scenario.sensors == ("position", "velocity")
    assert scenario.encoder.counts is not None
    assert scenario.encoder.difference == 1
    assert scenario.actuator.delay_samples == 1
    assert scenario.actuator.torque_limit is not None
    assert scenario.actuator.lag
    assert scenario.friction is not None
    assert scenario.initial_error != (0.0, 0.0)
    assert scenario.parameter_error.radius > 0
    assert scenario.parameter_error.payload is not None
    assert scenario.limits.error == 0.5


@pytest.mark.parametrize("family", FAMILIES)
def test_a_family_pushes_something_further_at_each_severity(family):
    tasks = [scenarios.get("hardware-nominal"), *(scenarios.get(f"hardware-{family}-{s}") for s in (1, 2, 3))]
    contents = [dataclasses.replace(task, name="", description="") for task in tasks]
    assert len(set(contents)) == 4


def test_the_moves_fill_the_workspace_and_the_drives():
    scenario = scenarios.get("hardware-nominal")
    env = TwoLinkArmVectorEnv(32, scenario)
    env.reset(seed=0)
    torques = []
    for _ in range(scenario.steps - 1):
        env.step(np.zeros((32, 2), dtype=np.float32))
        truth = env.truth
        torques.append(
            inverse_dynamics(scenario.arm, truth.reference, truth.reference_velocity, truth.reference_acceleration)
        )
    share = np.abs(torques) / np.array(scenario.actuator.torque_limit)
    assert 0.3 < share.max() < 1.0
    assert (np.sqrt((share**2).mean(axis=(0, 1))) > 0.15).all()


def test_the_numbers_of_the_pages():
    """Of docs/explanation/tiers.md and mujoco.md: torques of the moves, slowest vibrations, and inertia in the world lab."""
    nominal = scenarios.get("hardware-nominal")
    share = np.abs(inverse_dynamics(ARM, *reference_motion(nominal, range(64)))) / nominal.actuator.torque_limit
    assert share.max() == pytest.approx(0.69, abs=0.005)
    for severity, slowest in ((1, 8.9), (2, 5.2), (3, 3.0)):
        stiffness = [middle(x) for x in scenarios.get(f"hardware-elastic-{severity}").joint.stiffness]
        squares = np.linalg.eigvals(np.linalg.solve(inertia_matrix(ARM.lumped, (0.0, 0.0)), np.diag(stiffness)))
        assert np.sqrt(squares.min()) / (2 * np.pi) == pytest.approx(slowest, abs=0.05)
    angles = np.column_stack([np.zeros(50), np.linspace(0.0, 2.2, 50)])
    lab = scenarios.in_world(scenarios.get("nominal"), "mujoco-lab").arm
    lab, usual = (np.diagonal(inertia_matrix(arm, angles), axis1=1, axis2=2) for arm in (lab, TABLE_1))
    assert ((lab / usual).min(), (lab / usual).max()) == pytest.approx((0.767, 0.889), abs=0.001)


def test_the_board_is_recognised_by_its_content():
    for name in BOARD:
        assert scenarios.held_out_reason(scenarios.get(name).replace(name="mine"))
    for name in (*scenarios.in_tier("practice"), "nominal", "everything-2", "dfki-c1"):
        assert scenarios.held_out_reason(scenarios.get(name)) == ""
    assert "events" in scenarios.held_out_reason(Scenario(arm=ARM, events=[{"kind": "drop", "time": 3.0}]))
    own = dataclasses.replace(TABLE_1, m1=3.0)
    assert scenarios.held_out_reason(Scenario(arm=own, events=[{"kind": "drop", "time": 3.0}])) == ""
    assert "motion" in scenarios.held_out_reason(Scenario(arm=own, reference=MOVES))


def test_a_balanced_link_is_scaled_by_its_inertia():
    """Its weight was the scale, however small; at zero, both joints got the rule of a horizontal arm."""
    links = {"mass": (3.0, 1.5), "length": (0.4, 0.3), "inertia": (0.04, 0.01)}
    balanced, nearly = (ArmParameters.from_links(**links, centre=(0.18, c)) for c in (0.0, 1e-4))
    weight = abs(balanced.lumped[3])
    for arm in (balanced, nearly):
        options = scenarios.conditions(arm)
        assert options["actuator"]["torque_limit"][0] > 1.2 * weight
        dry = options["friction"]["coulomb"]
        assert dry[0].uniform[1] == pytest.approx(0.03 * weight, rel=1e-3)
        assert dry[1].uniform[1] == pytest.approx(0.03 * 9.8 * 0.01, rel=1e-3)


@pytest.mark.parametrize("arm", [ARM, TABLE_1, dataclasses.replace(TABLE_1, gravity=0.0), {"m2": 10, "L1": 0.4}])
def test_the_conditions_fit_any_arm(arm):
    arm = Scenario(arm=arm).arm
    for family in FAMILIES:
        limit = np.array(Scenario(**scenarios.conditions(arm, family, 2)).actuator.torque_limit)
        assert (limit > 0).all()
