"""Errors of options that contradict each other, are too large or have a wrong name; those of single fields: test_options.py."""

import re

import gymnasium as gym
import numpy as np
import pytest

from fbl_gym import TwoLinkArmEnv
from tests.fbl_gym.declared import TABLE
from tests.fbl_gym.episodes import ID, started

SHORT = {"kind": "array", "position": TABLE, "velocity": TABLE[:1]}
JOINT = {"stiffness": 500.0, "rotor_inertia": 0.5}
NO_WEIGHTS = dict.fromkeys(("weight_tracking", "weight_effort", "weight_chatter"), 0.0)
PULSES = {"kind": "pulses", "amplitude": 1.0}
SINE = {"kind": "sine", "amplitude": 1.0}
VELOCITY_NOISE = {"noise": {"velocity": 0.1}}
FAST = {"kind": "minimum-jerk", "move_time": 1e-300, "hold_time": 0.0}
ONLY_POSITION = {"sensors": ("position",)}


def with_payload(**fields):
    return {"parameter_error": {"payload": {"mass": 1.0, **fields}}}


def with_coulomb(value):
    return {"friction": {"coulomb": value}}


def with_position_noise(**fields):
    return {"noise": {"position": fields}}


@pytest.mark.parametrize(("options", "message"), [
    # Fields that contradict each other
    (with_payload(pick_up=2.0, drop=2.0), "drop must be .* than 2, got 2.0"),
    (with_payload(pick_up={"uniform": [0, 2]}, drop=1.0), "greater than 2, got 1"),
    ({"disturbance": {**PULSES, "period": 0.5, "width": 0.6}}, r"width must be .* not above 0\.5"),
    (with_position_noise(sigma=0.1, snr_db=3.0), "give one of sigma, density, snr_db, got .*'sigma': .*'snr_db': 3"),
    (with_position_noise(sigma=1, density=1), "give one of sigma, density, snr_db, got .*'density'"),
    ({"reference": {"kind": "steps", "low": 1.0, "high": (2.0, 0.0)}}, r"low must not exceed high, got low=\(1.0"),
    ({"reference": SHORT}, "velocity must have the 2 rows"),
    ({"constraints": {"low": (1, -1), "high": (0, 1)}}, r"low must be below high, got low=\(1.0, -1.0\) and high="),
    ({"reward": NO_WEIGHTS}, "at least one of weight_tracking, weight_effort, weight_chatter must be positive"),
    ({"actuator": None}, "action='normalized' needs a torque limit"),
    ({**ONLY_POSITION, "action": "acceleration"}, "has none"),
    ({"sensors": ("velocity",)}, "sensors must include 'position'"),
    ({**ONLY_POSITION, **VELOCITY_NOISE}, "noise.velocity is given, but sensors"),
    ({**ONLY_POSITION, "datasheet": {"velocity_noise": 0.1}}, "datasheet.velocity_noise is given, but sensors="),
    ({"datasheet": {"stiffness": 1e3}}, "datasheet.stiffness is of elastic joints, but the scenario has no joint"),
    ({"encoder": {"low_pass": 10}}, "low_pass filters a computed velocity: give difference too, got low_pass=10.0"),
    ({"encoder": {"difference": 1}, **VELOCITY_NOISE}, "noise.velocity is of a measured velocity"),
    ({"encoder": {"difference": 1}, **ONLY_POSITION}, "encoder.difference computes a velocity, but sensors"),
    ({"encoder": 4096, **with_position_noise(quantization=0.1)}, "encoder.counts or noise.position.quant.*, not both"),
    ({"events": [{"kind": "friction", "time": 1.0, "factor": 2.0}]}, "friction is None"),
    # Arms and limits beyond the numbers of a float
    *[
        ({"arm": {name: x}}, rf"arm must have inertia about both joints, .*{name}={x}".replace("+", r"\+"))
        for name, x in (("m1", 1e-300), ("L1", 1e200), ("L1", 1e-105), ("gravity", 1e308))
    ],
    ({"joint": 1000.0}, r"need rotors: give joint.rotor_inertia or arm.rotor"),
    ({"joint": {**JOINT, "frequency": 9.0}}, "give one of stiffness .* and frequency .*; got stiffness=.*frequency="),
    ({"joint": {"rotor_inertia": 0.5}}, "give one of stiffness .* and frequency"),
    ({"joint": {**JOINT, "stiffness": {"choice": [500.0, 1e8]}}}, "too long for these joints"),
    ({"joint": JOINT, "friction": {"law": "literal"}}, r"friction\.law must be 'exact' with elastic joints"),
    ({"link": 10.0, "friction": {"law": "literal"}}, "law must be 'exact' with elastic joints, links that bend"),
    ({"plant": "mujoco", "friction": {"law": "literal"}}, r"friction\.law must be 'exact' .* in MuJoCo"),
    # Times that are no multiples of their step
    ({"control_dt": 0.01, "physics_dt": 0.003}, "multiple of physics_dt=0.003 s, got control_dt=0.01 s"),
    ({"physics_dt": 0.02}, "control_dt must be a multiple of physics_dt=0.02 s, got control_dt=0.01 s"),
    ({"duration": 1.005}, "must be a multiple of control_dt=0.01 s, got duration=1.005"),
    ({"actuator": {"delay": 0.0015}}, "must be a multiple of physics_dt=0.001 s, got actuator.delay=0.0015"),
    ({"disturbance": {"kind": "piecewise-constant", "amplitude": 1, "period": 0.0125}}, "0.001.*period=0.0125"),
    *[
        ({"disturbance": {**PULSES, name: x}}, f"physics_dt=0.001.*{name}={x}")
        for name, x in (("width", 0.0125), ("start", 0.0125), ("period", 2.0005))
    ],
    ({"disturbance": {"kind": "array", "torque": TABLE, "dt": 0.0125}}, "physics_dt=0.001.*dt=0.0125"),
    # Too many physics steps, and levels that are too short
    ({"physics_dt": 1e-12}, "control_dt must have at most 10000 physics steps .*, got 10000000000"),
    ({"plant": {"kind": "mujoco", "substeps": 1001}}, "at most 10000 physics steps .*, got 10010"),
    ({"reference": {"kind": "steps", "period": 1e-30}}, "period must be at least control_dt=0.01 s, got 1e-30"),
    ({"reference": {"kind": "filtered-steps", "period": 1e-30}}, "period must be at least control_dt=0.01 s"),
    ({"reference": FAST}, r"reference.move_time \+ hold_time must be at least control_dt=0.01 s"),
    # Tasks that cannot be done
    ({"reference": {**SINE, "amplitude": 24.0}}, r"sensors' range, 2 limits.position = 25.13.* from \(-25.5"),
    ({"reference": {**SINE, "amplitude": {"uniform": [0, 30]}}}, r"must stay .* from \(-31.*to \(28"),
    ({"reference": {"kind": "steps", "low": 25.0, "high": 26.0}}, "got positions from .* to .26.0, 26.0. rad"),
    ({"reference": {"kind": "array", "position": [(1, 0), (0, 13.0)]}}, "limits.position=12.5664 rad of its start"),
    ({"limits": {"position": 0.5}}, "reference must stay within the sensors' range, 2 limits.position = 1 rad"),
    ({"disturbance": {**SINE, "frequency": 251.0}}, "frequency must be at most 250 Hz, a quarter .* 251"),
    ({"disturbance": {**SINE, "frequency": {"uniform": [1, 300]}}}, "disturbance.frequency must be at most 250 Hz"),
    # Names and types
    *[
        ({"scenario": name}, f"unknown scenario '{name}'; did you mean '{near}'.* Nearest")
        for name, near in (("paper3a", "paper-3a"), ("everthing-3", "everything-3"), ("servo-nominl", "servo-nominal"))
    ],
    ({"scenario": 3}, "scenario must be a Scenario, .*got 3"),
    ({"scenario": "servo-practice"}, "got the tier 'servo-practice': take one of it, such as 'servo-practice-nominal'"),
    ({"scenario": ["nominal", "noise-1"]}, "scenario must be one scenario, got 2: gym.make_vec takes a list"),
    *[({name: "False"}, f"{name} must be True or False, got 'False'") for name in ("info", "context")],
    ({"action": "torques"}, "unknown action 'torques'; did you mean 'torque'.* Known: "),
    ({"arm": "tabel-1"}, "unknown arm 'tabel-1'; did you mean 'table-1'"),
    ({"disturbance": {**SINE, "kind": "sinus"}}, "unknown kind of disturbance 'sinus'; did you mean 'sine'"),
    ({"disturbance": {"kind": ["sine"]}}, "unknown kind of disturbance"),
    ({"disturbance": {"amplitude": 5.0}}, "disturbance must be .*a 'kind' of"),
    ({"events": [{"kind": "kick", "time": 1.0}]}, r"kind of events\[0\] 'kick'"),
    *[({"events": events}, "events must be a list") for events in ({"kind": "drop", "time": 1.0}, "drop", 3.0)],
    ({"reference": "minimum-jrk"}, "'minimum-jrk'; did you mean 'minimum-jerk'"),
    ({"parameter_error": {"ratio": (1.0, 2.0)}}, r"ratio must be one number, four .* got \(1.0, 2.0\)"),
    ({"parameter_error": {"ratio": 0.0}}, "ratio must be a finite number greater than 0, got 0.0"),
    ({"parameter_error": {"ratio": {"m2": "x"}}}, "ratio of m2 must be a finite number greater than 0, got 'x'"),
    ({"parameter_error": {"ratio": {"mm1": 2.0}}}, "unknown parameter of ratio 'mm1'; did you mean 'm1'"),
    *[({"preview": x}, f"preview must be a whole number not below 0 and not above 100000, got {x}") for x in (-1, 2**60)],
    # Distributions
    (with_coulomb({"uniform": [5, 1]}), r"friction: coulomb: a range must be two .* got \(5.0, 1.0\)"),
    (with_coulomb({"log_uniform": [0, 1]}), r"coulomb: log_uniform\[0\] must be .* greater than 0, got 0"),
    (with_coulomb({"uniform": 3}), "coulomb: uniform must be a list of numbers, got 3"),
    (with_coulomb({"choice": []}), r"coulomb: choice must be a list of numbers, got \[\]"),
    (with_coulomb({"unifrom": [0, 1]}), "unknown field of coulomb 'unifrom'; did you mean 'uniform'"),
    (with_coulomb({"uniform": [0, 1], "choice": [1]}), "give one of uniform, log_uniform, choice, got"),
], ids=str)  # fmt: skip
def test_wrong_options_are_named(options, message):
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
