"""The single environment as Gymnasium, stable-baselines3 and their users expect it."""

import copy
import json
import pickle
import random

import gymnasium as gym
import numpy as np
import pytest
from gymnasium.envs.registration import EnvSpec
from gymnasium.error import ResetNeeded
from gymnasium.utils.env_checker import check_env
from stable_baselines3.common.env_checker import check_env as check_sb3

from fbl_gym import Actuator, Friction, Noise, ParameterError, SensorError, SineDisturbance, TwoLinkArmEnv

ID = "fbl_gym/TwoLinkArm-v0"
RECORDS = {
    "parameter_error": ParameterError(ratio={"m2": 2.0}, radius=0.5, payload={"mass": 3.0, "pick_up": 0.2}),
    "noise": Noise(position=SensorError(sigma=0.01, bias=1e-3, quantization=1e-3), velocity=0.02),
    "friction": Friction(coulomb=5.0, stiction=(3.0, 2.0)),
    "disturbance": SineDisturbance(amplitude=10.0),
    "actuator": Actuator(delay=0.015, lag=0.02),
    "reference": {"kind": "filtered-steps", "bandwidth": 6.0},
    "preview": 2,
    "duration": 1.0,
}
PLAIN = {
    "parameter_error": {"ratio": {"m2": 2.0}, "radius": 0.5, "payload": {"mass": 3.0, "pick_up": 0.2}},
    "noise": {"position": {"sigma": 0.01, "bias": 1e-3, "quantization": 1e-3}, "velocity": 0.02},
    "friction": {"coulomb": 5.0, "stiction": (3.0, 2.0)},
    "disturbance": {"kind": "sine", "amplitude": 10.0},
    "actuator": {"delay": 0.015, "lag": 0.02},
    "reference": {"kind": "filtered-steps", "bandwidth": 6.0},
    "preview": 2,
    "duration": 1.0,
}


def episode(env, steps=60, seed=5):
    """Everything a run returns, as one array."""
    rng = np.random.default_rng(0)
    rows = [np.append(env.reset(seed=seed)[0], 0.0)]
    for _ in range(steps):
        observation, reward, *_ = env.step(rng.uniform(-0.3, 0.3, 2))
        rows.append(np.append(observation, reward))
    return np.array(rows)


@pytest.mark.parametrize("options", [{}, RECORDS, {"scenario": "everything-3"}], ids=["default", "many", "everything"])
def test_checkers_pass_without_a_warning(options):
    """pytest turns every warning into an error here, Gymnasium's own logger's included."""
    env = gym.make(ID, **options)
    check_env(env.unwrapped)
    check_sb3(env)


def test_plain_data_makes_the_same_environment_as_records():
    one, two = gym.make(ID, **RECORDS), gym.make(ID, **PLAIN)
    assert one.unwrapped.scenario == two.unwrapped.scenario
    np.testing.assert_array_equal(episode(one), episode(two))


@pytest.mark.parametrize("options", [RECORDS, PLAIN, {"scenario": "paper-10", "noise": None, "action": "torque"}])
def test_options_survive_the_spec(options):
    env = gym.make(ID, **options)
    again = gym.make(EnvSpec.from_json(env.spec.to_json()))
    assert again.unwrapped.scenario == env.unwrapped.scenario
    assert again.unwrapped.interface == env.unwrapped.interface
    np.testing.assert_array_equal(episode(env, 20), episode(again, 20))
    json.loads(env.spec.to_json())


@pytest.mark.parametrize(
    "duplicate", [lambda env: pickle.loads(pickle.dumps(env)), copy.deepcopy], ids=["pickle", "copy"]
)
def test_a_copy_in_mid_episode_goes_on_alike_and_apart(duplicate):
    env = TwoLinkArmEnv(**RECORDS)
    episode(env, 10)
    other = duplicate(env)
    for k in range(20):
        a, b = env.step((0.1, 0.01 * k)), other.step((0.1, 0.01 * k))
        np.testing.assert_array_equal(a[0], b[0])
        assert a[1:4] == b[1:4]
    env.step((1.0, 1.0))
    assert not np.array_equal(env.truth.velocity, other.truth.velocity)


def test_an_episode_is_a_function_of_its_seed():
    env = TwoLinkArmEnv("everything-2")
    first = episode(env, seed=1)
    assert not np.array_equal(first, episode(env, seed=2))
    np.testing.assert_array_equal(first, episode(env, seed=1))
    env.reset(seed=1)
    second = env.reset()[0]
    assert not np.array_equal(second, first[0, :-1])
    env.reset(seed=1)
    np.testing.assert_array_equal(env.reset()[0], second)


def test_without_a_seed_episodes_differ():
    assert not np.array_equal(TwoLinkArmEnv().reset()[0], TwoLinkArmEnv().reset()[0])


def test_no_global_random_state_is_touched():
    before = random.getstate(), np.random.get_state()[1].tobytes()  # noqa: NPY002
    episode(TwoLinkArmEnv("everything-3"))
    assert (random.getstate(), np.random.get_state()[1].tobytes()) == before  # noqa: NPY002


def test_an_episode_is_truncated_after_its_duration_and_then_needs_a_reset():
    env = TwoLinkArmEnv(duration=0.2)
    with pytest.raises(ResetNeeded, match=r"call reset\(\)"):
        env.step((0, 0))
    env.reset(seed=0)
    flags = [env.step((0, 0))[2:4] for _ in range(20)]
    assert flags == [(False, False)] * 19 + [(False, True)]
    with pytest.raises(ResetNeeded):
        env.step((0, 0))
    env.reset()
    env.step((0, 0))


@pytest.mark.parametrize("form", ["log", "l1"])
def test_reward_is_what_its_documentation_says(form):
    weights = {"weight_tracking": 2.0, "weight_effort": 0.3, "weight_chatter": 0.7}
    reward = {"tracking": form, "worst": 1.5, "resolution": 2e-3, **weights}
    env = TwoLinkArmEnv(reward=reward, noise={"position": 0.1})
    env.reset(seed=0)
    rng, before = np.random.default_rng(0), env.truth.applied_torque / env.torque_limit
    for _ in range(60):
        u = rng.uniform(-0.2, 0.2, 2)
        found = env.step(u)[1]
        error = np.abs(env.truth.reference - env.truth.position).sum()
        t = np.log(1 + error / 2e-3) / np.log(1 + 1.5 / 2e-3) if form == "log" else error / 1.5
        e, c = np.abs(u).mean(), np.abs(u - before).mean() / 2
        assert found == pytest.approx(1 - (2.0 * min(t, 1.0) + 0.3 * e + 0.7 * c) / 3.0, abs=1e-12)
        assert 0.0 <= found <= 1.0
        before = u


@pytest.mark.parametrize(
    ("bad", "message"),
    [
        ((np.nan, 0.0), "action must be finite, got .*nan"),
        ((0.0, np.inf), "action must be finite, got .*inf"),
        (np.zeros(3), r"action must have shape \(2,\), got shape \(3,\)"),
        (np.zeros((1, 2)), r"action must have shape \(2,\), got shape \(1, 2\)"),
        (0.5, r"action must have shape \(2,\)"),
        (("a", "b"), r"action must be numbers of shape \(2,\), got \('a', 'b'\)"),
        (None, "action must"),
    ],
)
def test_a_bad_action_is_named_and_nothing_is_lost(bad, message):
    env, twin = TwoLinkArmEnv(**RECORDS), TwoLinkArmEnv(**RECORDS)
    episode(env, 10)
    episode(twin, 10)
    with pytest.raises(ValueError, match=message):
        env.step(bad)
    np.testing.assert_array_equal(env.step((0.1, 0.1))[0], twin.step((0.1, 0.1))[0])


@pytest.mark.parametrize("seed", [-1, 1.5, "1", True, 2**64])
def test_a_bad_seed_is_named(seed):
    env = TwoLinkArmEnv()
    with pytest.raises(ValueError, match="seed must be"):
        env.reset(seed=seed)
    env.reset(seed=2**64 - 1)


@pytest.mark.parametrize(
    ("options", "message"),
    [
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


def test_reset_takes_no_options():
    with pytest.raises(ValueError, match="unknown reset option 'low'"):
        TwoLinkArmEnv().reset(options={"low": 1})


def test_truth_is_a_copy_and_looking_changes_nothing():
    env, twin = TwoLinkArmEnv("everything-2"), TwoLinkArmEnv("everything-2")
    env.reset(seed=0)
    twin.reset(seed=0)
    for _ in range(50):
        truth = env.truth
        before = truth.position.copy()
        truth.velocity[:] = 99.0
        a, b = env.step((0.1, 0.1)), twin.step((0.1, 0.1))
        np.testing.assert_array_equal(a[0], b[0])
        np.testing.assert_array_equal(truth.position, before)


def test_what_a_controller_may_know():
    env = gym.make(ID, scenario="mixed-error-3").unwrapped
    assert env.nominal.m1 == 20.0
    assert env.control_dt == 0.01
    assert env.torque_limit == (2000.0, 800.0)
    assert env.layout.size == env.observation_space.shape[0]
    assert len(env.layout.names) == len(env.layout.units) == env.layout.size
    assert env.observation_space.dtype == np.float64
