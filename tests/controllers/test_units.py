"""No gain depends on the arm's size: an arm heavier by a factor, in the same task, moves in the same way."""

import dataclasses

import numpy as np
import pytest

from benchmarks.run.rollout import rollout
from controllers import catalogue
from fbl_gym.scenarios.classes import CLASSES, conditions
from fbl_gym.scenarios.scenario import Scenario

NAMES = [name for name, *_ in catalogue.LAWS if name not in catalogue.ACCESS and name != "nmpc"]


def motion(name, scale):
    """Return the positions [T + 1 x 1 x 2] of a servo whose masses are `scale` times the nominal ones."""
    arm = CLASSES["servo"].arm
    arm = dataclasses.replace(arm, m1=scale * arm.m1, m2=scale * arm.m2, rotor=tuple(scale * np.array(arm.rotor)))
    return rollout(name, Scenario(**conditions(arm, "servo")).replace(duration=1.5), [0]).position


@pytest.mark.parametrize("name", NAMES)
def test_the_motion_does_not_depend_on_the_size(name):
    nominal = motion(name, 1.0)
    for scale in (0.3, 30.0):
        np.testing.assert_allclose(motion(name, scale), nominal, atol=1e-6, err_msg=f"{scale} times the masses")
