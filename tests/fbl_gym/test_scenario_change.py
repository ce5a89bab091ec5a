"""A new scenario for an existing environment: by attribute, and by the options of `reset`."""

import gymnasium as gym
import numpy as np
import pytest
from gymnasium.error import ResetNeeded

from fbl_gym import TwoLinkArmEnv, TwoLinkArmVectorEnv
from tests.fbl_gym.episodes import ID, episode

VECTOR_SYNC = {"num_envs": 2, "vectorization_mode": "sync"}


def test_an_episode_after_a_change_is_that_of_a_fresh_environment():
    env = gym.make(ID, friction=None)
    fresh = episode(TwoLinkArmEnv("everything-2", friction=None))
    env.unwrapped.scenario = "everything-2"
    np.testing.assert_array_equal(episode(env), fresh)
    env.reset(options={"scenario": "noise-1"})
    assert env.unwrapped.scenario.friction is None
    env.reset(seed=5, options={"scenario": {"base": "everything-2"}})
    np.testing.assert_array_equal(env.step(np.zeros(2))[0], _second(TwoLinkArmEnv("everything-2", friction=None)))


def _second(env):
    env.reset(seed=5)
    return env.step(np.zeros(2))[0]


def test_seeds_continue_over_a_change():
    env, twin = TwoLinkArmEnv("noise-1"), TwoLinkArmEnv("everything-1")
    for each in (env, twin):
        each.reset(seed=7)
        each.reset()
    np.testing.assert_array_equal(env.reset(options={"scenario": "everything-1"})[0], twin.reset()[0])


def test_a_change_takes_effect_with_a_reset():
    for env in (TwoLinkArmEnv(), TwoLinkArmVectorEnv(2)):
        env.reset(seed=0)
        env.scenario = "everything-2"
        with pytest.raises(ResetNeeded):
            env.step(np.zeros(env.action_space.shape))
        with pytest.raises(ResetNeeded):
            _ = env.truth


def test_set_attr_of_gymnasium_reaches_the_arm():
    envs = gym.make_vec(ID, **VECTOR_SYNC)
    envs.set_attr("scenario", "everything-2")
    assert {env.unwrapped.scenario.name for env in envs.envs} == {"everything-2"}
    assert episode(envs.envs[0])[0, 0] == episode(TwoLinkArmEnv("everything-2"))[0, 0]


def test_all_lanes_of_a_batch_change_together():
    env, fresh = TwoLinkArmVectorEnv(3), TwoLinkArmVectorEnv(3, "everything-2")
    observations = env.reset(seed=2, options={"scenario": "everything-2"})[0]
    np.testing.assert_array_equal(observations, fresh.reset(seed=2)[0])
    np.testing.assert_array_equal(env.step(np.zeros((3, 2)))[0], fresh.step(np.zeros((3, 2)))[0])
    for options in (
        {"scenario": ["nominal", "noise-1", "nominal"]},
        {"scenario": "nominal", "reset_mask": np.array([True, False, False])},
    ):
        with pytest.raises(ValueError, match=r"one for all lanes, which share it: make an environment for each"):
            env.reset(options=options)


def test_a_scenario_of_other_observations_is_refused_and_changes_nothing():
    env = TwoLinkArmEnv("servo-nominal")
    env.reset(seed=0)
    for name in ("nominal", "servo-delay-3"):
        with pytest.raises(ValueError, match=r"previous_actions\[4\].*got .*`past_actions`, `sensors` and `limits`"):
            env.scenario = name
    assert env.scenario.name == "servo-nominal"
    env.step(np.zeros(2))
    env = TwoLinkArmEnv("servo-nominal", past_actions=5)
    env.scenario = "servo-delay-3"
