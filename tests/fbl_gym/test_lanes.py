"""The batch: each lane bit for bit the single environment, in every autoreset mode."""

import gymnasium as gym
import numpy as np
import pytest
from gymnasium.vector import AutoresetMode, SyncVectorEnv

from fbl_gym import TwoLinkArmEnv, TwoLinkArmVectorEnv
from tests.fbl_gym.episodes import EVENTFUL

MODES = [mode.value for mode in AutoresetMode]


def pair(lanes, mode):
    ours = gym.make_vec(
        "fbl_gym/TwoLinkArm-v0", lanes, vectorization_mode="vector_entry_point", autoreset_mode=mode, **EVENTFUL
    )
    theirs = SyncVectorEnv([lambda: gym.make("fbl_gym/TwoLinkArm-v0", **EVENTFUL)] * lanes, autoreset_mode=mode)
    return ours, theirs


def assert_same_infos(a, b, lanes):
    """Check that the infos of two vector environments are equal: keys, masks and final observations."""
    assert a.keys() == b.keys()
    for key in a:
        if key == "final_obs":
            assert a[key].shape == (lanes,)
            assert a[key].dtype == b[key].dtype == object
            for x, y in zip(a[key], b[key], strict=True):
                assert (x is None) == (y is None)
                if x is not None:
                    np.testing.assert_array_equal(x, y)
        elif key == "final_info":
            assert a[key] == b[key]
        else:
            np.testing.assert_array_equal(a[key], b[key])
            assert a[key].dtype == b[key].dtype


@pytest.mark.parametrize("mode", MODES)
@pytest.mark.parametrize("lanes", [1, 2, 3, 8, 9, 16, 17, 37])
def test_any_order_of_steps_and_resets_gives_what_single_environments_give(lanes, mode):
    """To the bit, 200 random calls: steps; resets of all or some lanes, with a seed, a list with None, or without."""
    rng, ends = np.random.default_rng(lanes), 0
    ours, theirs = pair(lanes, mode)
    ended = np.zeros(lanes, dtype=bool)
    np.testing.assert_array_equal(ours.reset(seed=3)[0], theirs.reset(seed=3)[0])
    for _ in range(200):
        if rng.random() < 0.85:
            if mode == "Disabled" and ended.any():
                continue
            actions = rng.uniform(-1, 1, (lanes, 2))
            a, b = ours.step(actions), theirs.step(actions)
            for x, y in zip(a[:4], b[:4], strict=True):
                np.testing.assert_array_equal(x, y)
                assert x.dtype == y.dtype
            assert_same_infos(a[4], b[4], lanes)
            ended = a[2] | a[3]
            ends += ended.sum()
            continue
        several = [None if rng.random() < 0.5 else int(rng.integers(1000)) for _ in range(lanes)]
        arguments = {"seed": (None, int(rng.integers(1000)), several)[rng.integers(3)]}
        mask = rng.random(lanes) < 0.4
        if rng.random() < 0.7 and mask.any() and not (mode == "Disabled" and (ended & ~mask).any()):
            a = ours.reset(**arguments, options={"reset_mask": mask.copy()})
            b = theirs.reset(**arguments, options={"reset_mask": mask.copy()})
            ended &= ~mask
        else:
            a, b = ours.reset(**arguments), theirs.reset(**arguments)
            ended[:] = False
        np.testing.assert_array_equal(a[0], b[0])
        assert a[1] == b[1] == {}
    assert ends >= 3


@pytest.mark.parametrize("lanes", [1, 16, 33])
def test_truth_of_a_lane_is_that_of_the_single_environment(lanes):
    options = {**EVENTFUL, "limits": {"position": 100.0, "velocity": 1e4}}
    env = TwoLinkArmVectorEnv(lanes, **options)
    env.reset(seed=5)
    singles = [TwoLinkArmEnv(**options) for _ in range(lanes)]
    for lane, single in enumerate(singles):
        single.reset(seed=5 + lane)
    for k in range(8):
        action = np.array([0.02 * k, -0.01])
        env.step(np.tile(action, (lanes, 1)))
        for single in singles:
            single.step(action)
    for lane, single in enumerate(singles):
        for name, value in vars(single.truth).items():
            np.testing.assert_array_equal(getattr(env.truth, name)[lane], value, err_msg=name)


def test_a_hundred_thousand_lanes_step():
    env = TwoLinkArmVectorEnv(100_000, "everything-3")
    env.reset(seed=0)
    observations, rewards, *_ = env.step(np.zeros((100_000, 2)))
    assert np.isfinite(observations).all()
    single = TwoLinkArmEnv("everything-3")
    single.reset(seed=99_999)
    np.testing.assert_array_equal(observations[-1], single.step(np.zeros(2))[0])
    assert env._batch._memory.nbytes + observations.nbytes < 2**28
    assert rewards.shape == (100_000,)
