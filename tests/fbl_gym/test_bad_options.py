"""Errors of wrong options: they name the argument, the value, the right form and the nearest name."""

import re

import gymnasium as gym
import numpy as np
import pytest

from fbl_gym import Friction, ParameterError, Reward, Scenario, SensorError, TwoLinkArmEnv, TwoLinkArmVectorEnv
from tests.fbl_gym.episodes import ID


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"scenario": "paper-3c"}, "unknown scenario 'paper-3c'; did you mean"),
        ({"scenario": 3}, "scenario must be"),
        ({"action": "torques"}, "unknown action 'torques'; did you mean 'torque'"),
        ({"actuator": None}, "action='normalized' needs a torque limit"),
        ({"sensors": ("position",), "action": "acceleration"}, "has none"),
        ({"sensors": ("velocity",)}, "sensors must include 'position'"),
        ({"noise": {"position": 10**400}}, "must be a finite number not below 0, got 1000"),
        ({"scenario": {"name": ["a"]}}, r"name must be text, got \['a'\]"),
        ({"plant": {"kind": "mujoco", "substeps": 1001}}, "plant.substeps must be at most 1000, .* got 1001"),
        ({"preview": -1}, "preview must be a whole number not below 0, got -1"),
        ({"render_mode": "humann"}, "render_mode"),
        ({"reward": {"weight_effort": -1}}, "reward: weight_effort must be a finite number not below 0, got -1"),
        ({"physics_dt": 0.003}, "control_dt must be a multiple of physics_dt=0.003 s, got control_dt=0.01 s"),
        ({"physics_dt": 0.02}, "physics_dt must divide control_dt, got physics_dt=0.02 s and control_dt=0.01 s"),
        ({"arm": {"m1": -1}}, "arm: m1 must be a finite number greater than 0, got -1"),
        ({"noise": {"position": -0.1}}, "noise: position: sigma.* must be a finite number not below 0, got -0.1"),
        ({"noise": {"velocity": 0.1}, "sensors": ("position",)}, "noise.velocity is given, but sensors"),
        (
            {"disturbance": {"kind": "sinus", "amplitude": 1}},
            "unknown kind of disturbance 'sinus'; did you mean 'sine'",
        ),
        ({"disturbance": {"kind": "sine"}}, r"disturbance must give amplitude, got \{'kind': 'sine'\}"),
        ({"disturbance": "sine"}, r"disturbance must give amplitude, got \{'kind': 'sine'\}"),
        ({"actuator": {"delay": 0.0005}}, "actuator.delay must be a multiple of physics_dt"),
        ({"reference": {"kind": "steps", "low": 1, "high": 0}}, "low must not exceed high"),
        ({"duration": 1e12}, r"duration must be at most some 8.39e\+06 s here, .* for 16 arms, got 1000000000000.0 s"),
        (
            {"duration": 1e9, "reference": {"kind": "array", "position": [[0, 0], [1, 1]]}},
            "duration must be at most some",
        ),
        ({"duration": 1e9, "reference": "filtered-steps"}, "duration must be at most some"),
        ({"actuator": {"delay": 1e9}}, r"actuator.delay must be at most some 2.1e\+04 s here"),
        ({"preview": 10**400}, r"preview must be at most some 1.4e\+06 here"),
        (
            {"reference": {"kind": "fourier", "harmonics": 10**9}},
            r"reference.harmonics must be at most some 4.19e\+06 here",
        ),
        ({"physics_dt": 1e-12}, "physics_dt must be at least control_dt / 10000 = 1e-06 s, got 1e-12 s"),
        ({"physics_dt": 1e-300}, "control_dt must be at most .* times physics_dt=1e-300 s, got 0.01 s"),
        ({"duration": 1.7e308}, "duration must be at most .* times control_dt=0.01 s"),
        ({"actuator": {"delay": 1.7e308}}, "actuator.delay must be at most .* times physics_dt"),
        ({"actuator": {"delay": {"uniform": [0, 1.7e308]}}}, "actuator.delay must be .* not above 9.0072e\\+12"),
        ({"actuator": {"delay_samples": {"choice": [0, -1]}}}, "delay_samples.* not below 0, got -1"),
        ({"reward": {"worst": 1e-300}}, "worst / resolution must be from 1e-9 to 1e15"),
        ({"reward": {"weight_effort": 1.7e308, "weight_chatter": 1.7e308}}, "must be finite"),
    ],
)
def test_bad_options_are_named(options, message):
    with pytest.raises(ValueError, match=message):
        TwoLinkArmEnv(**options)


@pytest.mark.parametrize(
    ("name", "advice"),
    [
        ("frictionn", "did you mean 'friction'?"),
        ("acton", "did you mean 'action'?"),
        ("rewards", "did you mean 'reward'?"),
        ("scenaro", "did you mean 'scenario'?"),
        ("threads", "it is an option of the vector environment"),
        ("torque_limit", "did you mean actuator={'torque_limit': ...}"),
        ("mass", "did you mean parameter_error={'payload': {'mass': ...}}"),
        ("snr_db", "did you mean noise={'position': {'snr_db': ...}} or noise={'velocity': {'snr_db': ...}} or "),
        ("bandwidth", "did you mean reference={'kind': 'filtered-steps', 'bandwidth': ...}"),
        ("weight_effort", "did you mean reward={'weight_effort': ...}"),
    ],
)
def test_an_unknown_option_is_a_type_error_in_pythons_words(name, advice):
    """TorchRL tries `frameskip` on every environment, and goes on after this error alone."""
    with pytest.raises(TypeError, match=re.escape(f"got an unexpected keyword argument {name!r}; {advice}")):
        gym.make(ID, **{name: 100})


@pytest.mark.parametrize("sensors", [None, 5])
def test_sensors_of_the_wrong_type_are_named(sensors):
    with pytest.raises(ValueError, match="sensors"):
        TwoLinkArmEnv(sensors=sensors)


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: Friction(law="exct"), "unknown law 'exct'; did you mean 'exact'"),
        (lambda: Reward(tracking="logg"), "unknown tracking 'logg'; did you mean 'log'"),
        (lambda: ParameterError(sampling="eech"), "unknown sampling 'eech'; did you mean 'each'"),
        (lambda: ParameterError(parameters=("m1", "L3")), "unknown parameter 'L3'; did you mean 'L"),
        (lambda: ParameterError(ratio={"mm1": 2.0}), "unknown parameter of ratio 'mm1'; did you mean 'm1'"),
        (lambda: Scenario(sensors=("position", "velocty")), "unknown sensor 'velocty'; did you mean 'velocity'"),
        (lambda: Scenario(arm="tabel-1"), "unknown arm 'tabel-1'; did you mean 'table-1'"),
        (
            lambda: Scenario(reference="minimum-jrk"),
            "unknown kind of reference 'minimum-jrk'; did you mean 'minimum-jerk'",
        ),
        (lambda: Scenario(disturbance={"kind": "pulse", "amplitude": 1.0}), "'pulse'; did you mean 'pulses'"),
        (lambda: Scenario(noise={"positon": 0.1}), "unknown field of noise 'positon'; did you mean 'position'"),
        (
            lambda: Scenario(noise={"position": {"sigm": 1}}),
            "noise: unknown field of position 'sigm'; did you mean 'sigma'",
        ),
        (lambda: Scenario(friction={"stikction": 1}), "unknown field of friction 'stikction'; did you mean 'stiction'"),
        (lambda: Scenario(actuator={"dealy": 1}), "unknown field of actuator 'dealy'; did you mean 'delay'"),
        (
            lambda: Scenario(reference={"kind": "sine", "freqency": 1}),
            "unknown field of reference 'freqency'.*'frequency'",
        ),
        (
            lambda: Scenario(parameter_error={"payload": {"mas": 1}}),
            "unknown field of payload 'mas'; did you mean 'mass'",
        ),
        (lambda: Scenario(limits={"postion": 1}), "unknown field of limits 'postion'; did you mean 'position'"),
        (lambda: TwoLinkArmEnv(reward={"wight_effort": 1}), "unknown field of reward 'wight_effort'.*'weight_effort'"),
        (lambda: TwoLinkArmEnv("mixed-eror-2"), "unknown scenario 'mixed-eror-2'; did you mean 'mixed-error-2'"),
        (lambda: TwoLinkArmEnv(action="accelaration"), "unknown action 'accelaration'; did you mean 'acceleration'"),
        (lambda: TwoLinkArmEnv().layout["referense_position"], "did you mean 'reference_position'"),
    ],
)
def test_the_nearest_known_name_is_suggested(make, message):
    with pytest.raises(ValueError, match=message) as problem:
        make()
    assert "Known: " in str(problem.value) or "Also near: " in str(problem.value)


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: Scenario(friction=3.0), "friction must be a Friction, a dict of its fields .viscous.*got 3.0"),
        (lambda: Scenario(noise=0.1), "noise must be a Noise, a dict of its fields .*got 0.1"),
        (
            lambda: Scenario(disturbance=5.0),
            "disturbance must be one of its records, or a dict with a 'kind' of .*got 5.0",
        ),
        (lambda: Scenario(disturbance={"amplitude": 5.0}), "disturbance must be .*a 'kind' of"),
        (lambda: Scenario(reference=None), "reference must be one of its records, .*got None"),
        (lambda: Scenario(limits=None), "limits must be a Limits, .*got None"),
        (lambda: Scenario(arm=3.0), "arm must be .*got 3.0"),
        (lambda: TwoLinkArmEnv(reward="l1"), "reward must be a Reward, a dict of its fields .*got 'l1'"),
        (lambda: TwoLinkArmEnv(scenario=3), "scenario must be a Scenario, .*got 3"),
        (lambda: Scenario(reference={"kind": "array"}), "reference must give position, got"),
        (lambda: Scenario(parameter_error="2"), "parameter_error must be .*got '2'"),
        (lambda: ParameterError(payload="2"), "payload must be a Payload, .* or its mass, got '2'"),
    ],
)
def test_a_value_of_the_wrong_type_is_named_with_the_right_form(make, message):
    with pytest.raises(ValueError, match=message):
        make()


@pytest.mark.parametrize(
    "make",
    [
        lambda: ParameterError(parameters=5),
        lambda: ParameterError(parameters=None),
        lambda: Scenario(sensors=5),
        lambda: Scenario(sensors=None),
        lambda: Scenario(disturbance={"kind": ["sine"]}),
        lambda: SensorError(sigma=np.array("x")),
    ],
    ids=["parameters=5", "parameters=None", "sensors=5", "sensors=None", "kind=[...]", "0-d array"],
)
def test_every_wrong_value_is_a_value_error(make):
    with pytest.raises(ValueError, match=r"must be|unknown"):
        make()


def test_an_error_does_not_change_the_next_environment():
    before = TwoLinkArmEnv().reset(seed=0)[0]
    for bad in ({"noise": {"position": -1}}, {"control_dt": 0.0015}, {"reference": "sinus"}):
        with pytest.raises(ValueError, match=r"must be|unknown"):
            TwoLinkArmEnv(**bad)
    np.testing.assert_array_equal(TwoLinkArmEnv().reset(seed=0)[0], before)


def test_a_batch_beyond_any_memory_is_refused():
    with pytest.raises(ValueError, match=r"num_envs must be at most [\d,]+ here, which take 16 GiB, got 1000000000"):
        TwoLinkArmVectorEnv(10**9)


def test_a_payload_that_is_never_picked_up_is_no_error():
    env = TwoLinkArmEnv(parameter_error={"payload": {"mass": 1.0, "pick_up": 1.7e308}})
    env.reset(seed=0)
    env.step(np.zeros(2))
    assert env.truth.payload == 0.0
