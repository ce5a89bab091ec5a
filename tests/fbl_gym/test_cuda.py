"""The step of a GPU: a lane at a time, it has the bits of the batch in every class of compiled step."""

import functools

import gymnasium as gym
import numpy as np
import pytest
from numba import njit

from fbl_gym.kernel.maths.fastmath import kernel_njit
from fbl_gym.kernel.step import api
from tests.fbl_gym.episodes import EVENTFUL, ID, TRACKING
from tests.fbl_gym.test_lanes import CHANGES, MODES

BUSY = {"friction": {"coulomb": 10.0, "stiction": 10.0}, "noise": {"position": 1e-3, "acceleration": 1e-1}}
CASES = {
    0: (ID, {"duration": 0.2}),
    1: (ID, {**BUSY, "disturbance": {"kind": "sine", "amplitude": 10.0, "frequency": 3.0}, "duration": 0.2}),
    2: (ID, {**EVENTFUL, **CHANGES}),
    3: (TRACKING, {"scenario": "servo-elastic-2", "duration": 0.2, "preview": 2}),
    4: (ID, {**EVENTFUL, **CHANGES, "link": 8.0}),
}
"""Name and options of environments, by the number of their step."""


@functools.cache
def lanes_of(number):
    """Return the step of a class, compiled for this processor, over each lane by itself."""
    step_lane = kernel_njit(api.LANE_STEPS[number])

    def step(memory, out, moves, lanes):
        for lane in range(lanes):
            step_lane(memory, out, moves, lane)

    return njit(step)


@pytest.mark.parametrize("mode", MODES)
@pytest.mark.parametrize("number", CASES)
def test_lane_by_lane_the_step_has_the_same_bits(number, mode):
    name, options = CASES[number]
    env = gym.make_vec(name, 37, vectorization_mode="vector_entry_point", autoreset_mode=mode, threads=1, **options)
    env.reset(seed=3)
    batch = env.unwrapped._batch
    assert batch._class == number
    memory = batch._memory.copy()
    out, expected = np.empty((2, 37 * env.unwrapped._size))
    rng, ends = np.random.default_rng(0), 0
    for _ in range(80):
        actions = rng.uniform(-1, 1, 74)
        memory[batch._actions] = actions
        batch.step(actions, expected)
        lanes_of(number)(memory, out, True, 37)
        np.testing.assert_array_equal(out, expected)
        ended = np.any(batch.outcomes[1:], axis=0)
        ends += ended.sum()
        if mode == "Disabled" and ended.any():
            batch.reset(np.flatnonzero(ended), expected)
            memory[:] = batch._memory
        assert memory[: batch._parts["blocks"].start].tobytes() == batch._memory[: batch._parts["blocks"].start].tobytes()
    assert ends > 0
