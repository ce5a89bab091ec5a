"""The same environment again, pickled and copied; batches too."""

import copy
import pickle

import numpy as np
import pytest

from fbl_gym import TwoLinkArmEnv
from tests.fbl_gym.episodes import EVENTFUL, RECORDS, episode, started, started_batch


@pytest.mark.parametrize("options", [RECORDS, {"scenario": "everything-2@mujoco"}], ids=["own", "mujoco"])
@pytest.mark.parametrize("copied", [lambda env: pickle.loads(pickle.dumps(env)), copy.deepcopy], ids=["pickle", "copy"])
def test_a_copy_in_mid_episode_continues_independently(copied, options):
    """Its steps, its truth, its next episode and those of its seeds are those of the original."""
    if options is not RECORDS:
        pytest.importorskip("mujoco")
    env = TwoLinkArmEnv(**options)
    episode(env, 10)
    other = copied(env)
    for k in range(20):
        a, b = env.step((0.1, 0.01 * k)), other.step((0.1, 0.01 * k))
        np.testing.assert_array_equal(a[0], b[0])
        assert a[1:4] == b[1:4]
    for name, value in vars(env.truth).items():
        np.testing.assert_array_equal(getattr(other.truth, name), value, err_msg=name)
    env.step((1.0, 1.0))
    assert not np.array_equal(env.truth.velocity, other.truth.velocity)
    np.testing.assert_array_equal(other.reset()[0], env.reset()[0])
    np.testing.assert_array_equal(episode(other, seed=9), episode(env, seed=9))


def test_a_pickled_batch_continues_alike():
    env = started_batch(20, **EVENTFUL)
    for _ in range(25):
        env.step(np.full((20, 2), 0.1))
    other = pickle.loads(pickle.dumps(env))
    for _ in range(25):
        np.testing.assert_array_equal(env.step(np.full((20, 2), 0.1))[0], other.step(np.full((20, 2), 0.1))[0])


def test_an_environment_unpickled_onto_read_only_memory_steps():
    """Joblib gives its workers such memory maps."""
    env = started()
    buffers = []
    data = pickle.dumps(env, protocol=5, buffer_callback=buffers.append)
    other = pickle.loads(data, buffers=[bytes(buffer) for buffer in buffers])
    action = np.array([0.1, -0.2])
    np.testing.assert_array_equal(other.step(action)[0], env.step(action)[0])
