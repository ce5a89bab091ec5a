"""The actor network in NumPy."""

import numpy as np
import pytest

from benchmarks.rl.adapter import AdapterSettings
from benchmarks.rl.network import Actor
from fbl_gym import TwoLinkArmEnv
from tests.benchmarks.rl.agents import random_actor


def test_a_lane_has_the_same_bits_alone_and_in_a_batch():
    actor = random_actor(AdapterSettings(), TwoLinkArmEnv().interface)
    observations = np.random.default_rng(1).normal(0, 3, (37, 12))
    np.testing.assert_array_equal(actor(observations), np.concatenate([actor(row[None]) for row in observations]))


def test_unknown_functions_are_refused():
    with pytest.raises(ValueError, match="unknown activation 'tan'; did you mean 'tanh'"):
        Actor((), "tan", "clip")
    with pytest.raises(ValueError, match="unknown output 'clipped'; did you mean 'clip'"):
        Actor((), "tanh", "clipped")
