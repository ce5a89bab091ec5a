"""The batch: each lane bit for bit the single environment, in every autoreset mode."""

import pickle

import gymnasium as gym
import numpy as np
import pytest
from gymnasium.error import ResetNeeded
from gymnasium.vector import AutoresetMode, SyncVectorEnv

from fbl_gym import TwoLinkArmEnv, TwoLinkArmVectorEnv

OPTIONS = {
    "scenario": "everything-3",
    "duration": 0.3,
    "limits": {"velocity": 9.0},
    "actuator": {"delay": 0.013, "lag": 0.01},
    "preview": 1,
}
MODES = [mode.value for mode in AutoresetMode]


def pair(lanes, mode):
    ours = gym.make_vec(
        "fbl_gym/TwoLinkArm-v0", lanes, vectorization_mode="vector_entry_point", autoreset_mode=mode, **OPTIONS
    )
    theirs = SyncVectorEnv([lambda: gym.make("fbl_gym/TwoLinkArm-v0", **OPTIONS)] * lanes, autoreset_mode=mode)
    return ours, theirs


@pytest.mark.parametrize("mode", MODES)
@pytest.mark.parametrize("lanes", [1, 2, 8, 9, 16, 17, 37])
def test_lanes_are_single_environments(lanes, mode):
    """Against Gymnasium's own vector environment over single ones: observations, rewards, flags and infos, to the bit."""
    ours, theirs = pair(lanes, mode)
    np.testing.assert_array_equal(ours.reset(seed=3)[0], theirs.reset(seed=3)[0])
    rng, ends = np.random.default_rng(0), 0
    for _ in range(100):
        actions = rng.uniform(-1, 1, (lanes, 2))
        a, b = ours.step(actions), theirs.step(actions)
        for x, y in zip(a[:4], b[:4], strict=True):
            np.testing.assert_array_equal(x, y)
        assert a[4].keys() == b[4].keys()
        done = a[2] | a[3]
        ends += done.sum()
        if "final_obs" in a[4]:
            np.testing.assert_array_equal(a[4]["_final_obs"], b[4]["_final_obs"])
            for lane in np.flatnonzero(done):
                np.testing.assert_array_equal(a[4]["final_obs"][lane], b[4]["final_obs"][lane])
        if mode == "Disabled" and done.any():
            mask = {"reset_mask": done}
            np.testing.assert_array_equal(ours.reset(options=dict(mask))[0], theirs.reset(options=dict(mask))[0])
    assert ends >= 3 * lanes


@pytest.mark.parametrize("mode", MODES)
def test_a_reset_mask_touches_only_its_lanes(mode):
    ours, theirs = pair(5, mode)
    ours.reset(seed=0)
    theirs.reset(seed=0)
    for k in range(10):
        ours.step(np.full((5, 2), 0.001 * k))
        theirs.step(np.full((5, 2), 0.001 * k))
    mask = np.array([False, True, False, True, False])
    seeds = [None, 7, None, None, None]
    a, _ = ours.reset(seed=seeds, options={"reset_mask": mask.copy()})
    b, _ = theirs.reset(seed=seeds, options={"reset_mask": mask.copy()})
    np.testing.assert_array_equal(a, b)
    for _ in range(15):
        np.testing.assert_array_equal(ours.step(np.zeros((5, 2)))[0], theirs.step(np.zeros((5, 2)))[0])


def test_seeds_by_list_and_by_number():
    env = TwoLinkArmVectorEnv(3)
    by_number, _ = env.reset(seed=4)
    by_list, _ = env.reset(seed=[4, 5, 6])
    np.testing.assert_array_equal(by_number, by_list)
    kept, _ = env.reset(seed=[None, 5, None])
    np.testing.assert_array_equal(kept[1], by_list[1])
    assert not np.array_equal(kept[0], by_list[0])
    single = TwoLinkArmEnv()
    single.reset(seed=4)
    np.testing.assert_array_equal(kept[0], single.reset()[0])


def test_the_mode_is_named_and_is_next_step_by_default():
    assert TwoLinkArmVectorEnv(2).metadata["autoreset_mode"] is AutoresetMode.NEXT_STEP
    assert TwoLinkArmVectorEnv(2, autoreset_mode="SameStep").metadata["autoreset_mode"] is AutoresetMode.SAME_STEP


def test_max_episode_steps():
    env = gym.make_vec("fbl_gym/TwoLinkArm-v0", 2, vectorization_mode="vector_entry_point", max_episode_steps=5)
    env.reset(seed=0)
    assert [bool(env.step(np.zeros((2, 2)))[3].all()) for _ in range(5)] == [False] * 4 + [True]


def test_one_bad_action_moves_no_lane():
    env, twin = TwoLinkArmVectorEnv(20), TwoLinkArmVectorEnv(20)
    env.reset(seed=0)
    twin.reset(seed=0)
    actions = np.zeros((20, 2))
    actions[13, 1] = np.nan
    with pytest.raises(ValueError, match=r"actions must be finite, got \[ ?0. nan\] in lane 13"):
        env.step(actions)
    with pytest.raises(ValueError, match=r"shape \(20, 2\), got shape \(2, 20\)"):
        env.step(actions.T)
    np.testing.assert_array_equal(env.step(np.zeros((20, 2)))[0], twin.step(np.zeros((20, 2)))[0])


def test_a_finished_lane_must_be_reset_where_nothing_resets_it():
    env = TwoLinkArmVectorEnv(2, autoreset_mode="Disabled", duration=0.02)
    with pytest.raises(ResetNeeded):
        env.step(np.zeros((2, 2)))
    env.reset(seed=0)
    env.step(np.zeros((2, 2)))
    env.step(np.zeros((2, 2)))
    with pytest.raises(ResetNeeded, match="lane 0 has ended"):
        env.step(np.zeros((2, 2)))


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"num_envs": 0}, "num_envs must be a whole number not below 1, got 0"),
        ({"num_envs": 2.5}, "num_envs must be"),
        ({"num_envs": 2, "autoreset_mode": "Nextstep"}, "did you mean 'NextStep'"),
        ({"num_envs": 2, "max_episode_steps": 0}, "max_episode_steps must be"),
        ({"num_envs": 2, "nois": 3}, "did you mean 'noise'"),
    ],
)
def test_bad_arguments_are_named(arguments, message):
    with pytest.raises(ValueError, match=message):
        TwoLinkArmVectorEnv(**arguments)


@pytest.mark.parametrize("mask", [[True, False], np.array([1, 0]), np.array([True]), np.array([False, False])])
def test_bad_masks_are_named(mask):
    env = TwoLinkArmVectorEnv(2)
    env.reset(seed=0)
    with pytest.raises(ValueError, match="reset_mask must"):
        env.reset(options={"reset_mask": mask})


def test_bad_seeds_are_named():
    env = TwoLinkArmVectorEnv(2)
    for seed in ([1, 2, 3], -1, [0, -1], 2**64 - 1):
        with pytest.raises(ValueError, match="seed must be"):
            env.reset(seed=seed)


def test_a_pickled_batch_goes_on_alike():
    env = TwoLinkArmVectorEnv(20, **OPTIONS)
    env.reset(seed=0)
    for _ in range(25):
        env.step(np.full((20, 2), 0.1))
    other = pickle.loads(pickle.dumps(env))
    for _ in range(25):
        np.testing.assert_array_equal(env.step(np.full((20, 2), 0.1))[0], other.step(np.full((20, 2), 0.1))[0])


def test_a_hundred_thousand_lanes():
    env = TwoLinkArmVectorEnv(100_000, "everything-1")
    env.reset(seed=0)
    observations, rewards, *_ = env.step(np.zeros((100_000, 2)))
    assert np.isfinite(observations).all()
    single = TwoLinkArmEnv("everything-1")
    single.reset(seed=99_999)
    np.testing.assert_array_equal(observations[-1], single.step(np.zeros(2))[0])
    assert env._batch._state.nbytes < 2**28
    assert rewards.shape == (100_000,)
