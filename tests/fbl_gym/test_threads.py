"""A batch on several threads."""

import multiprocessing
import os

import numpy as np
import pytest
from gymnasium.error import ResetNeeded

from fbl_gym import TwoLinkArmVectorEnv


@pytest.mark.parametrize("mode", ["NextStep", "SameStep"])
def test_threads_change_no_bit(mode):
    """Through several episodes, also with more threads than blocks."""
    envs = [
        TwoLinkArmVectorEnv(75, "everything-3", autoreset_mode=mode, duration=0.2, threads=threads)
        for threads in (1, 2, 3, 64)
    ]
    rng = np.random.default_rng(0)
    first, *others = [env.reset(seed=5)[0] for env in envs]
    for other in others:
        assert np.array_equal(first, other)
    for _ in range(45):
        actions = rng.uniform(-1, 1, (75, 2))
        one, *many = [env.step(actions) for env in envs]
        for other in many:
            assert all(np.array_equal(a, b) for a, b in zip(one[:4], other[:4], strict=True))
            assert ("final_obs" in one[4]) == ("final_obs" in other[4])


def test_no_lane_moves_if_one_thread_finds_an_error():
    env = TwoLinkArmVectorEnv(64, autoreset_mode="Disabled", duration=0.05, threads=4)
    env.reset(seed=0)
    before = env.truth.position
    actions = np.zeros((64, 2))
    actions[63, 1] = np.nan
    with pytest.raises(ValueError, match="in lane 63"):
        env.step(actions)
    assert np.array_equal(env.truth.position, before)
    for _ in range(5):
        env.step(np.zeros((64, 2)))
    env.reset(options={"reset_mask": np.arange(64) != 40})
    before = env.truth.position
    with pytest.raises(ResetNeeded, match="lane 40"):
        env.step(np.zeros((64, 2)))
    assert np.array_equal(env.truth.position, before)


@pytest.mark.skipif(not hasattr(os, "fork"), reason="needs fork")
def test_a_forked_process_starts_its_own_threads():
    env = TwoLinkArmVectorEnv(64, threads=2)
    env.reset(seed=0)
    env.step(np.zeros((64, 2)))
    with multiprocessing.get_context("fork").Pool(1) as pool:
        positions = pool.apply_async(_positions_of_a_step).get(60)
    env.reset(seed=0)
    env.step(np.zeros((64, 2)))
    assert np.array_equal(positions, env.truth.position)


def _positions_of_a_step():
    env = TwoLinkArmVectorEnv(64, threads=2)
    env.reset(seed=0)
    env.step(np.zeros((64, 2)))
    return env.truth.position
