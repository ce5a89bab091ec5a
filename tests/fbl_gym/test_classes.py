"""The classes of robots: servo, direct and geared."""

import dataclasses

import numpy as np
import pytest

from benchmarks.run.rollout import reference_motion
from fbl_gym import scenarios
from fbl_gym.interface import class_of
from fbl_gym.model.arm import TABLE_1, ArmParameters, inverse_dynamics
from fbl_gym.records import ends
from fbl_gym.scenarios.classes import CLASSES, MEMBERS, conditions, families
from fbl_gym.scenarios.scenario import Scenario

PUSHED = [(robot, family) for robot in CLASSES for family in families(robot)]


@pytest.mark.parametrize("name", MEMBERS)
def test_every_scenario_is_of_its_class(name):
    scenario, robot = scenarios.get(name), name.partition("-")[0]
    kind = CLASSES[robot]
    assert scenario.name == name
    assert scenario.description.startswith(f"{robot}: ")
    assert (scenario.control_dt, scenario.encoder.difference, scenario.actuator.delay_samples) == (kind.times[0], 1, 1)
    assert scenario.sensors == ("position", "velocity")
    assert ends(scenario.actuator.lag)[0] > 0
    assert scenario.friction is not None
    assert scenario.parameter_error.payload is not None
    assert scenario.limits.error == 0.5
    joint = scenario.joint
    assert class_of(scenario.control_dt, joint and joint.encoder) == robot
    assert joint is None or joint.encoder == kind.encoder
    assert scenarios.member(name).tier in (robot, f"{robot}-practice", f"{robot}-surprise")


@pytest.mark.parametrize(("robot", "family"), PUSHED)
def test_a_family_pushes_something_further_at_each_severity(robot, family):
    tasks = [scenarios.get(f"{robot}-nominal"), *(scenarios.get(f"{robot}-{family}-{s}") for s in (1, 2, 3))]
    assert len({dataclasses.replace(task, name="", description="") for task in tasks}) == 4


@pytest.mark.parametrize("robot", CLASSES)
def test_the_families_take_turns_in_three_arms_and_practice_has_others(robot):
    own, names = CLASSES[robot].arm, families(robot)
    assert scenarios.get(f"{robot}-nominal").arm == scenarios.get(f"{robot}-practice-nominal").arm == own
    board = {name: {scenarios.get(f"{robot}-{name}-{severity}").arm for severity in (1, 2, 3)} for name in names}
    assert all(len(arms) == 1 for arms in board.values())
    practice = {
        name: [scenarios.get(f"{robot}-practice-{name}-{severity}").arm for severity in (1, 3)] for name in names
    }
    assert all(first != second for first, second in practice.values())
    ours, others = ({(arm.m2, arm.L2) for arms in sets.values() for arm in arms} for sets in (board, practice))
    assert (len(ours), len(others), ours & others) == (3, 3, {(own.m2, own.L2)})


@pytest.mark.parametrize("robot", CLASSES)
def test_the_nominal_model_knows_the_rotors_behind_springs(robot):
    named = [scenarios.get(name) for name in MEMBERS if name.startswith(robot)]
    for task in (*named, Scenario(**conditions(TABLE_1, robot, "everything", 2))):
        assert task.joint is None or task.joint.rotor_inertia == task.arm.rotor, task.name


@pytest.mark.parametrize("robot", CLASSES)
def test_tuning_and_training_may_use_practice_alone(robot):
    for name in MEMBERS:
        if name.startswith(robot):
            assert bool(scenarios.held_out_reason(scenarios.get(name))) == ("practice" not in name), name


@pytest.mark.parametrize("robot", CLASSES)
def test_the_nominal_arm_can_follow(robot):
    """With its largest friction, it needs less than its torque limits."""
    for name in (f"{robot}-nominal", f"{robot}-practice-nominal"):
        scenario = scenarios.get(name)
        q, v, a = reference_motion(scenario, range(8))
        friction = scenario.friction
        dry = [sum(ends(getattr(friction, part)[i])[1] for part in ("coulomb", "stiction")) for i in (0, 1)]
        viscous = np.array([ends(friction.viscous[i])[1] for i in (0, 1)])
        torque = np.abs(inverse_dynamics(scenario.arm, q, v, a)) + dry + viscous * np.abs(v)
        assert (torque / scenario.actuator.torque_limit).max() < 1.0, name


@pytest.mark.parametrize("robot", CLASSES)
@pytest.mark.parametrize("scale", [0.3, 30.0])
def test_the_task_follows_the_arm(robot, scale):
    """All torques, inertias and springs of an arm whose links and rotors are heavier by a factor are so, too."""
    arm = CLASSES[robot].arm
    other = dataclasses.replace(arm, m1=scale * arm.m1, m2=scale * arm.m2, rotor=tuple(scale * np.array(arm.rotor)))
    ours, theirs = (Scenario(**conditions(each, robot, "everything", 2)) for each in (arm, other))
    np.testing.assert_allclose(theirs.actuator.torque_limit, scale * np.array(ours.actuator.torque_limit))
    for name in ("viscous", "coulomb"):
        for a, b in zip(getattr(ours.friction, name), getattr(theirs.friction, name), strict=True):
            np.testing.assert_allclose(ends(b), scale * np.array(ends(a)))
    assert theirs.friction.load == ours.friction.load
    if ours.joint is not None:
        for a, b in zip(ours.joint.stiffness, theirs.joint.stiffness, strict=True):
            np.testing.assert_allclose(ends(b), scale * np.array(ends(a)))


def test_a_base_of_a_class_follows_another_arm():
    light = scenarios.as_scenario({"base": "geared-nominal", "arm": {"m1": 2.0, "m2": 1.0}})
    assert light.arm == dataclasses.replace(CLASSES["geared"].arm, m1=2.0, m2=1.0)
    assert light.actuator.torque_limit[1] < scenarios.get("geared-nominal").actuator.torque_limit[1]
    assert isinstance(light.arm, ArmParameters)
