"""Laws know the nominal rotors: an arm with rotors is followed as well as one without."""

import numpy as np
import pytest

import controllers
from fbl_gym import ArmParameters, TwoLinkArmVectorEnv
from tests.controllers.closed_loop import tracking

ROTORS = ArmParameters(rotor=(8.0, 4.0))
LAWS = ("computed-torque", "cascade-flm", "adaptive-flm", "slotine-li", "slotine-li-composite", "spong-robust",
         "computed-torque-tde", "rbf-adaptive", "computed-torque-dob", "nmpc")  # fmt: skip


def mean_error(name, arm):
    """Return the mean position error [rad] over two seconds in four lanes."""
    env = TwoLinkArmVectorEnv(4, arm=arm, action="torque", actuator=None)
    errors, _ = tracking(controllers.factory(name)(env.interface), env, 200)
    return np.abs(errors[1:]).mean()


@pytest.mark.parametrize("name", LAWS)
def test_a_law_follows_an_arm_with_rotors_as_well(name):
    plain, heavy = mean_error(name, ArmParameters()), mean_error(name, ROTORS)
    assert heavy < 1.5 * plain + 1e-5


def test_estimates_are_those_of_the_links():
    """The rotors are taken off the torque before the fit."""
    exciting = {"kind": "fourier", "centre": (-np.pi / 2, 0.0), "frequency": 0.2}
    options = {"action": "torque", "actuator": None, "control_dt": 1e-3, "reference": exciting}
    env = TwoLinkArmVectorEnv(2, arm=ROTORS, parameter_error=1.2, **options)
    _, states = tracking(controllers.make("adaptive-flm", env), env, 4000)
    np.testing.assert_allclose(states[-1].lumped, env.truth.lumped, rtol=0.05)
