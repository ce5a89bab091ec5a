"""Options that no environment can have: what is said of them."""

import gymnasium as gym
import pytest

from fbl_gym import TwoLinkArmEnv
from tests.fbl_gym.episodes import ID


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"threads": 2}, "'threads' is an option of many arms at once"),
        ({"frictionn": 1}, "unknown option 'frictionn'; did you mean 'friction'"),
        ({"scenario": "paper-3c"}, "unknown scenario 'paper-3c'; did you mean"),
        ({"scenario": 3}, "scenario must be"),
        ({"action": "torques"}, "unknown action 'torques'; did you mean 'torque'"),
        ({"actuator": None}, "action='fraction' needs a torque limit"),
        ({"sensors": ("position",), "action": "acceleration"}, "has none"),
        ({"sensors": ("velocity",)}, "sensors must include 'position'"),
        ({"preview": -1}, "preview must be a whole number not below 0, got -1"),
        ({"render_mode": "humann"}, "render_mode"),
        ({"reward": {"weight_effort": -1}}, "reward: weight_effort must be a finite number not below 0, got -1"),
        ({"physics_dt": 0.003}, "control_dt must be a multiple of physics_dt=0.003 s, got control_dt=0.01 s"),
        ({"physics_dt": 0.02}, "physics_dt must divide control_dt, got physics_dt=0.02 s and control_dt=0.01 s"),
        ({"arm": {"m1": -1}}, "arm: m1 must be a positive, finite number, got -1"),
        ({"noise": {"position": -0.1}}, "noise: position: sigma.* must be a finite number not below 0, got -0.1"),
        ({"noise": {"velocity": 0.1}, "sensors": ("position",)}, "noise.velocity is given, but sensors"),
        (
            {"disturbance": {"kind": "sinus", "amplitude": 1}},
            "unknown kind of disturbance 'sinus'; did you mean 'sine'",
        ),
        ({"disturbance": {"kind": "sine"}}, "disturbance must have the fields of SineDisturbance"),
        ({"actuator": {"delay": 0.0005}}, "actuator.delay must be a multiple of physics_dt"),
        ({"reference": {"kind": "steps", "low": 1, "high": 0}}, "low must not exceed high"),
    ],
)
def test_bad_options_are_named(options, message):
    with pytest.raises(ValueError, match=message):
        TwoLinkArmEnv(**options)


@pytest.mark.parametrize("wrong", [{"acton": "torque"}, {"rewards": {}}, {"prevew": 2}, {"scenaro": "nominal"}])
def test_a_mistyped_argument_of_the_environment_is_recognised(wrong):
    """Not only the scenario's fields: action, reward, preview and scenario are options of `gym.make` too."""
    meant = {"acton": "action", "rewards": "reward", "prevew": "preview", "scenaro": "scenario"}
    (name,) = wrong
    with pytest.raises(ValueError, match=f"did you mean '{meant[name]}'"):
        gym.make(ID, **wrong)


@pytest.mark.parametrize("sensors", [None, 5])
def test_sensors_of_the_wrong_type_are_named(sensors):
    with pytest.raises(ValueError, match="sensors"):
        TwoLinkArmEnv(sensors=sensors)
