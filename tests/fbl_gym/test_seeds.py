"""Seeds: an episode depends on its seed, and on no global random state."""

import random

import numpy as np
import pytest

from fbl_gym import TwoLinkArmEnv, TwoLinkArmVectorEnv
from tests.fbl_gym.episodes import RECORDS, episode, started


def test_an_episode_is_a_function_of_its_seed():
    env = TwoLinkArmEnv("everything-2")
    first, other = episode(env, seed=1), episode(env, seed=2)
    assert not np.array_equal(first, other)
    np.testing.assert_array_equal(first, episode(env, seed=1))
    second = started("everything-2", seed=1).reset()[0]
    assert not np.array_equal(second, first[0, :-1])
    np.testing.assert_array_equal(started("everything-2", seed=1).reset()[0], second)


def test_an_episode_does_not_depend_on_earlier_ones():
    fresh, used = TwoLinkArmEnv(**RECORDS), TwoLinkArmEnv(**RECORDS)
    for seed in range(3):
        episode(used, 7 * seed, seed)
    np.testing.assert_array_equal(episode(fresh), episode(used))


def test_no_numpy_or_python_random_state_is_touched_by_making_seeding_or_drawing():
    before = random.getstate(), repr(np.random.get_state(legacy=False))  # noqa: NPY002
    env = TwoLinkArmEnv("everything-3", reference="fourier")
    env.reset()
    env.reset(seed=4)
    episode(env)
    assert random.getstate() == before[0]
    assert repr(np.random.get_state(legacy=False)) == before[1]  # noqa: NPY002


@pytest.mark.parametrize("seed", [-1, 1.5, "1", True, 2**64])
def test_a_bad_seed_is_an_error(seed):
    env = TwoLinkArmEnv()
    with pytest.raises(ValueError, match="seed must be"):
        env.reset(seed=seed)
    env.reset(seed=2**64 - 1)


def test_seeds_may_be_numpy_numbers():
    env = TwoLinkArmVectorEnv(2)
    first, _ = env.reset(seed=np.int64(3))
    np.testing.assert_array_equal(first, env.reset(seed=np.array([3, 4]))[0])
    np.testing.assert_array_equal(first, env.reset(seed=(3, 4))[0])


def test_episodes_and_lanes_without_a_seed_differ():
    starts = [TwoLinkArmEnv().reset()[0][0] for _ in range(2)]
    assert len({*starts, *TwoLinkArmVectorEnv(16).reset()[0][:, 0]}) == 18
