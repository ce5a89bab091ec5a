"""`TorqueLaw`: a subclass is a policy, with or without declared gains, and its errors name the mistake."""

from dataclasses import dataclass

import numpy as np
import pytest

import controllers
from fbl_gym import TwoLinkArmEnv
from fbl_gym.model.arm import inverse_dynamics
from fbl_gym.records import number
from tests.controllers.closed_loop import tracking


@dataclass(frozen=True)
class Plain(controllers.TorqueLaw):
    """Computed torque, as the README has it."""

    w: float = 8.0

    def torque(self, observation, state):
        q, v = self.read(observation, "position", "velocity")
        r, dr, ddr = self.read(observation, "reference_position", "reference_velocity", "reference_acceleration")
        a = ddr + self.w**2 * (r - q) + 2 * self.w * (dr - v)
        return inverse_dynamics(self.interface.nominal, q, v, a), state


@dataclass(frozen=True)
class Declared(Plain):
    w: float = number(8.0, unit="rad/s", above=0)


@pytest.mark.parametrize("law", [Plain, Declared])
def test_a_subclass_is_a_policy(law):
    env = TwoLinkArmEnv()
    errors, _ = tracking(law(env.interface), env, 900)
    assert np.abs(errors).max() < 5e-3


def test_only_declared_gains_are_checked():
    interface = TwoLinkArmEnv().interface
    assert Plain(interface, w=-1.0).w == -1.0
    with pytest.raises(ValueError, match="w must be a finite number greater than 0, got -1"):
        Declared(interface, w=-1.0)


def test_a_law_prints_its_name_and_gains():
    env = TwoLinkArmEnv()
    assert repr(Plain(env.interface)).endswith("Plain(w=8.0)")
    assert repr(controllers.make("pid-flm", env)) == "PidFlm(kp=(10.0, 10.0), ki=(0.0, 0.0), kd=(3.0, 3.0))"
    assert repr(controllers.make("oracle-flm", env)) == "OracleFlm(kp=(400.0, 400.0), kd=(40.0, 40.0))"


WITHOUT = ("zero", "computed-torque-eso", "h-infinity", "ladrc", "nmpc", "oracle")


@pytest.mark.parametrize("name", [name for name in controllers.names() if not name.startswith(WITHOUT)])
def test_a_missing_sensor_is_named(name):
    with pytest.raises(ValueError, match=r"needs a sensor of|trained on sensors of position, velocity"):
        controllers.factory(name)(TwoLinkArmEnv(sensors=("position",)).interface)


def test_a_wrong_observation_is_refused():
    policy = controllers.make("pid-flm", TwoLinkArmEnv())
    with pytest.raises(ValueError, match=r"observation must have shape \(12,\)"):
        policy.predict(np.zeros(7))
