"""Laws know the nominal rotors: an arm with rotors is followed as well as one without."""

import numpy as np
import pytest

import controllers
from fbl_gym import ArmParameters, TwoLinkArmVectorEnv

ROTORS = ArmParameters(rotor=(8.0, 4.0))
LAWS = ("computed-torque", "cascade-flm", "adaptive-flm", "slotine-li", "slotine-li-composite", "spong-robust",
         "computed-torque-tde", "rbf-adaptive", "computed-torque-dob", "nmpc")  # fmt: skip


def mean_error(name, arm, **real):
    """Return the mean position error [rad] over two seconds in four lanes."""
    env = TwoLinkArmVectorEnv(4, arm=arm, action="torque", actuator=None, **real)
    law = controllers.factory(name)(env.interface)
    observation, _ = env.reset(seed=0)
    state, first, errors = None, np.ones(4, dtype=bool), []
    for _ in range(200):
        action, state = law.predict(observation, state=state, episode_start=first)
        observation, *_ = env.step(action)
        first = np.zeros(4, dtype=bool)
        errors.append(np.abs(env.truth.reference - env.truth.position))
    return np.mean(errors)


@pytest.mark.parametrize("name", LAWS)
def test_a_law_follows_an_arm_with_rotors_as_well(name):
    plain, heavy = mean_error(name, ArmParameters()), mean_error(name, ROTORS)
    assert heavy < 1.5 * plain + 1e-5


def test_estimates_are_those_of_the_links():
    """The rotors are taken off the torque before the fit."""
    exciting = {"kind": "fourier", "centre": (-np.pi / 2, 0.0), "frequency": 0.2}
    options = {"action": "torque", "actuator": None, "control_dt": 1e-3, "reference": exciting}
    env = TwoLinkArmVectorEnv(2, arm=ROTORS, parameter_error=1.2, **options)
    policy = controllers.make("adaptive-flm", env)
    observation, _ = env.reset(seed=0)
    state, first = None, np.ones(2, dtype=bool)
    for _ in range(4000):
        action, state = policy.predict(observation, state=state, episode_start=first)
        observation, *_ = env.step(action)
        first = np.zeros(2, dtype=bool)
    np.testing.assert_allclose(state.lumped, env.truth.lumped, rtol=0.05)
