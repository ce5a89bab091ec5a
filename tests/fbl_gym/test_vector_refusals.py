"""Errors of the vector environment: they name the lane and the value, and change no episode."""

import numpy as np
import pytest
from gymnasium.error import ResetNeeded

from fbl_gym import TwoLinkArmVectorEnv
from tests.fbl_gym.episodes import EVENTFUL, started_batch


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        *[({"num_envs": n}, "num_envs must be .* not below 1 and .*, got") for n in (0, -1, 2.5, True, "2", None)],
        ({"num_envs": 2, "autoreset_mode": "Nextstep"}, "'Nextstep' is not a valid AutoresetMode"),
        ({"num_envs": 2, "max_episode_steps": 0}, "max_episode_steps must be"),
    ],
)
def test_bad_arguments_are_named(arguments, message):
    with pytest.raises(ValueError, match=message):
        TwoLinkArmVectorEnv(**arguments)
    with pytest.raises(TypeError, match="unexpected keyword argument 'nois'; did you mean 'noise'"):
        TwoLinkArmVectorEnv(2, nois=3)


def test_the_first_bad_lane_is_named_and_the_episode_continues():
    env, twin = started_batch(37, **EVENTFUL), started_batch(37, **EVENTFUL)
    for k in range(45):
        actions = np.random.default_rng(k).uniform(-1, 1, (37, 2))
        for lane, value in ((36, np.nan), (20, np.inf), (k % 37, -np.inf)):
            bad = actions.copy()
            bad[lane, k % 2] = value
            bad[36, 0] = np.nan
            with pytest.raises(ValueError, match=f"finite, got .*in lane {lane}$"):
                env.step(bad)
        with pytest.raises(ValueError, match=r"shape \(37, 2\), got shape \(2, 37\)"):
            env.step(actions.T)
        a, b = env.step(actions), twin.step(actions)
        for x, y in zip(a[:4], b[:4], strict=True):
            np.testing.assert_array_equal(x, y)


SEEDS = [2.5, np.float64(2.0), np.array(5), "5", True, -1, 2**64 - 1, {}, [1], [0, -1], [1, 2.5], [1, "2"]]
MASKS = [[True, False], np.array([1, 0]), np.array([True]), np.zeros(2, bool), np.ones(3, bool)]


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        *[({"seed": seed}, "seed must be") for seed in SEEDS],
        *[({"seed": 5, "options": {"reset_mask": mask}}, "reset_mask must") for mask in MASKS],
        ({"options": {"reset_masc": np.ones(2, bool)}}, "unknown reset option 'reset_masc'; did you mean 'reset_mask'"),
    ],
    ids=str,
)
def test_a_bad_reset_is_named_and_changes_no_episode(arguments, message):
    env, twin = started_batch(2), started_batch(2)
    with pytest.raises(ValueError, match=message):
        env.reset(**arguments)
    np.testing.assert_array_equal(env.step(np.zeros((2, 2)))[0], twin.step(np.zeros((2, 2)))[0])
    np.testing.assert_array_equal(env.reset()[0], twin.reset()[0])


@pytest.mark.parametrize("mode", ["NextStep", "SameStep", "Disabled"])
def test_the_first_reset_is_of_every_lane(mode):
    env, twin = TwoLinkArmVectorEnv(2, autoreset_mode=mode), TwoLinkArmVectorEnv(2, autoreset_mode=mode)
    with pytest.raises(ResetNeeded, match="the first reset must be of every lane"):
        env.reset(seed=3, options={"reset_mask": np.array([True, False])})
    np.testing.assert_array_equal(env.reset(seed=0)[0], twin.reset(seed=0)[0])


def test_without_autoreset_a_lane_that_ended_must_be_reset():
    env = TwoLinkArmVectorEnv(2, autoreset_mode="Disabled", duration=0.02)
    with pytest.raises(ResetNeeded):
        env.step(np.zeros((2, 2)))
    env.reset(seed=0)
    env.step(np.zeros((2, 2)))
    env.step(np.zeros((2, 2)))
    with pytest.raises(ResetNeeded, match="lane 0 has ended"):
        env.step(np.zeros((2, 2)))
