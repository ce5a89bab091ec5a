"""Errors of options that contradict each other, are too large or have a wrong name; those of single fields: test_options.py."""

import re
import tomllib
from pathlib import Path

import gymnasium as gym
import numpy as np
import pytest

from fbl_gym import TwoLinkArmEnv
from tests.fbl_gym.episodes import ID, started

JOINT = {"stiffness": 500.0, "rotor_inertia": 0.5}
WRONG = tomllib.loads(Path(__file__).with_name("option_errors.toml").read_text(encoding="utf-8"))["wrong"]


@pytest.mark.parametrize(("message", "options"), [*WRONG, ("needs a torque limit", {"actuator": None})], ids=str)
def test_wrong_options_are_named(message, options):
    with pytest.raises(ValueError, match=message):
        TwoLinkArmEnv(**options)


LIGHT = {"m1": 0.05, "m2": 0.02, "L1": 0.2, "L2": 0.2}
JITTER = {"control_dt": 0.0025, "physics_dt": 5e-4, "actuator": {"jitter": 0.0015}}


@pytest.mark.parametrize(("options", "cause", "speed"), [
    ({"joint": {**JOINT, "stiffness": 2e6}}, "these joints", 15.0),
    ({"joint": JOINT, "physics_dt": 5e-3, "parameter_error": {"radius": 5.0}}, "these joints", 15.0),
    ({"link": 300.0, **JITTER}, r"these links \(link.frequency, link.damping\)", 15.0),
    ({"friction": {"viscous": 5.0}, "arm": LIGHT}, "this friction", 1.0),
], ids=str)  # fmt: skip
def test_a_step_too_long_is_refused_with_one_that_does(options, cause, speed):
    """It divides all other times too, and the speeds of an arm that starts with 10 rad/s stay below `speed`."""
    with pytest.raises(ValueError, match=rf"physics_dt=\S+ s is too long for {cause}") as error:
        TwoLinkArmEnv(**options)
    step = float(re.search(r"physics_dt=([0-9.e-]+) s would do", str(error.value)).group(1))
    env = started(**options | {"physics_dt": step, "initial_velocity": 10.0})
    assert not env.step((0.0, 0.0))[2]
    assert np.abs(env.truth.velocity).max() < speed


@pytest.mark.filterwarnings("ignore::fbl_gym.scenarios.files.UnitsWarning")
@pytest.mark.parametrize(("options", "message"), [
    ({"base": "servo-nominal", "arm": {"centre": 1e15}}, r"given arm\.centre: actuator: torque_limit"),
    ({"base": "geared-nominal", "parameter_error": 0.02}, r"given parameter_error: physics_dt=0\.0005 s is too long"),
    ({"base": "geared-nominal", "arm": {"centre": [0.5, -5.0]}}, r"given arm\.centre: physics_dt"),
])  # fmt: skip
def test_an_error_names_an_option_that_was_given(options, message):
    """Though another one, which follows from it or comes from the base, is wrong by it."""
    with pytest.raises(ValueError, match=message):
        TwoLinkArmEnv(options)


@pytest.mark.parametrize("name", ["friction", "action", "reward", "scenario"])
def test_an_unknown_option_is_a_type_error_in_pythons_words(name):
    """TorchRL tries `frameskip` on every environment, and goes on after this error alone."""
    with pytest.raises(TypeError, match=rf"unexpected keyword argument '{name}x'; did you mean '{name}'\?"):
        gym.make(ID, **{f"{name}x": 100})


def test_an_unknown_slot_or_field_is_named():
    with pytest.raises(ValueError, match=r"did you mean 'reference_position'.* Known: "):
        TwoLinkArmEnv().layout["referense_position"]
    with pytest.raises(ValueError, match="unknown option 'rate'"):
        TwoLinkArmEnv().scenario.replace(rate=3)


def test_a_payload_that_is_never_picked_up_is_no_error():
    env = started(parameter_error={"payload": {"mass": 1.0, "pick_up": 1.7e308}})
    env.step(np.zeros(2))
    assert env.truth.payload == 0.0
