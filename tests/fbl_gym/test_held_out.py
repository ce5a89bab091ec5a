"""Scenarios that tuning may use, and scenarios of any arm."""

import dataclasses

import numpy as np
import pytest

from fbl_gym import Scenario, scenarios
from fbl_gym.model.arm import TABLE_1, ArmParameters
from fbl_gym.scenarios.classes import CLASSES, families


def test_the_board_is_recognised_by_its_content():
    for name in ("servo-delay-2", "direct-surprise-arm", "geared-surprise-knock"):
        assert scenarios.held_out_reason(scenarios.get(name).replace(name="mine"))
    for name in ("nominal", "everything-2", "dfki-c1"):
        assert scenarios.held_out_reason(scenarios.get(name)) == ""
    arm = CLASSES["geared"].arm
    assert "events" in scenarios.held_out_reason(Scenario(arm=arm, events=[{"kind": "drop", "time": 3.0}]))
    own = dataclasses.replace(TABLE_1, m1=3.0)
    assert scenarios.held_out_reason(Scenario(arm=own, events=[{"kind": "drop", "time": 3.0}])) == ""
    assert "motion" in scenarios.held_out_reason(Scenario(arm=own, reference=scenarios.get("servo-nominal").reference))


def test_a_balanced_link_is_scaled_by_its_inertia():
    """Its weight was the scale, however small; at zero, both joints got the rule of a horizontal arm."""
    links = {"mass": (3.0, 1.5), "length": (0.4, 0.3), "inertia": (0.04, 0.01)}
    balanced, nearly = (ArmParameters.from_links(**links, centre=(0.18, c)) for c in (0.0, 1e-4))
    weight = abs(balanced.lumped[3])
    for arm in (balanced, nearly):
        options = scenarios.conditions(arm, "servo")
        assert options["actuator"]["torque_limit"][0] > 1.2 * weight
        dry = options["friction"]["coulomb"]
        assert dry[0].uniform[1] == pytest.approx(0.05 * weight, rel=1e-3)
        assert dry[1].uniform[1] == pytest.approx(0.1 * 9.8 * 0.01, rel=1e-3)


@pytest.mark.parametrize("robot", CLASSES)
@pytest.mark.parametrize("arm", [TABLE_1, dataclasses.replace(TABLE_1, gravity=0.0), {"m2": 10, "L1": 0.4}])
def test_the_conditions_fit_any_arm(robot, arm):
    arm = Scenario(arm=arm).arm
    for family in families(robot):
        limit = np.array(Scenario(**scenarios.conditions(arm, robot, family, 2)).actuator.torque_limit)
        assert (limit > 0).all()
