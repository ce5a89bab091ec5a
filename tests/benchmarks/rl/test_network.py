"""The compiled actor network."""

import hashlib
from itertools import pairwise

import numpy as np
import pytest

from benchmarks.rl.adapter import AdapterSettings
from benchmarks.rl.network import Actor
from fbl_gym import TwoLinkArmEnv
from tests.benchmarks.rl.agents import random_actor

FUNCTIONS = {"tanh": np.tanh, "relu": lambda x: np.maximum(x, 0.0), "clip": lambda x: np.clip(x, -1.0, 1.0)}


def exact(shape, scale):
    """Return numbers without a pattern that are equal on every machine."""
    return scale * ((np.arange(np.prod(shape)) * 7919 % 10007) / 10007 - 0.5).reshape(shape)


def network(activation="tanh", output="tanh", sizes=(13, 20, 9, 2)):
    return Actor(tuple((exact((o, i), 1.0), exact(o, 0.3)) for i, o in pairwise(sizes)), activation, output)


@pytest.mark.parametrize("activation", ["tanh", "relu"])
@pytest.mark.parametrize("output", ["tanh", "clip"])
@pytest.mark.parametrize("sizes", [(13, 20, 9, 2), (4, 2), (1, 3, 2)])
def test_the_network_equals_its_formula(activation, output, sizes):
    actor = network(activation, output, sizes)
    x = observations = np.random.default_rng(0).normal(0, 2, (50, sizes[0]))
    for i, (weight, bias) in enumerate(actor.layers):
        x = FUNCTIONS[output if i == len(actor.layers) - 1 else activation](x @ weight.T + bias)
    np.testing.assert_allclose(actor(observations), x, rtol=0, atol=1e-14)


def test_tanh_is_accurate_and_bounded():
    x = np.concatenate([np.linspace(-25, 25, 99_999), [0.0, 1e-9, -1e300, 1e300]])
    y = Actor(((np.ones((1, 1)), np.zeros(1)),), "tanh", "tanh")(x[:, None])[:, 0]
    np.testing.assert_allclose(y, np.tanh(x), rtol=0, atol=4e-16)


def test_the_bits_are_the_same_on_every_machine():
    """The hash is that of any machine, also of one without fused multiply-adds (`NUMBA_CPU_NAME=generic`)."""
    bits = hashlib.sha256(network()(exact((64, 13), 4.0)).tobytes()).hexdigest()
    assert bits[:16] == "ac0eac93101ff4e6"


def test_a_lane_has_the_same_bits_alone_and_in_a_batch():
    actor = random_actor(AdapterSettings(), TwoLinkArmEnv().interface)
    observations = np.random.default_rng(1).normal(0, 3, (37, 12))
    np.testing.assert_array_equal(actor(observations), np.concatenate([actor(row[None]) for row in observations]))
    np.testing.assert_array_equal(actor(np.asfortranarray(observations)), actor(observations))


def test_observations_of_another_size_are_refused():
    with pytest.raises(ValueError, match="observation must have 13 entries for this network, got 12"):
        network()(np.zeros((1, 12)))


def test_unknown_functions_are_refused():
    with pytest.raises(ValueError, match="unknown activation 'tan'; did you mean 'tanh'"):
        Actor((), "tan", "clip")
    with pytest.raises(ValueError, match="unknown output 'clipped'; did you mean 'clip'"):
        Actor((), "tanh", "clipped")
