"""The same environment again, pickled and copied; batches too."""

import copy
import functools
import pickle

import numpy as np
import pytest

from fbl_gym import TwoLinkArmEnv, TwoLinkArmTrackingEnv, TwoLinkArmTrackingVectorEnv, TwoLinkArmVectorEnv
from tests.fbl_gym.episodes import EVENTFUL, RECORDS, episode, needs_mujoco, started, started_batch, truths_of

ON_MUJOCO = pytest.param({"scenario": "everything-2@mujoco"}, marks=needs_mujoco)
PLANT = pytest.param({"plant": "mujoco"}, marks=needs_mujoco)
TRACKING = TwoLinkArmTrackingEnv, TwoLinkArmTrackingVectorEnv


@pytest.mark.parametrize("options", [RECORDS, ON_MUJOCO], ids=["own", "mujoco"])
@pytest.mark.parametrize("copied", [lambda env: pickle.loads(pickle.dumps(env)), copy.deepcopy], ids=["pickle", "copy"])
def test_a_copy_in_mid_episode_continues_independently(copied, options):
    """Its steps, its truth, its next episode and those of its seeds are those of the original."""
    env = TwoLinkArmEnv(**options)
    episode(env, 10)
    other = copied(env)
    for k in range(20):
        np.testing.assert_equal(env.step((0.1, 0.01 * k)), other.step((0.1, 0.01 * k)))
    np.testing.assert_equal(vars(other.truth), vars(env.truth))
    env.step((1.0, 1.0))
    assert not np.array_equal(env.truth.velocity, other.truth.velocity)
    np.testing.assert_array_equal(other.reset()[0], env.reset()[0])
    np.testing.assert_array_equal(episode(other, seed=9), episode(env, seed=9))


def test_an_environment_unpickled_onto_read_only_memory_steps():
    """Joblib gives its workers such memory maps."""
    env, buffers = started(), []
    data = pickle.dumps(env, protocol=5, buffer_callback=buffers.append)
    other = pickle.loads(data, buffers=[bytes(buffer) for buffer in buffers])
    np.testing.assert_array_equal(other.step((0.1, -0.2))[0], env.step((0.1, -0.2))[0])


HISTORY = {"scenario": "servo-nominal", "duration": 0.3, "history": 3}


@pytest.mark.parametrize("lanes", [None, 20], ids=["single", "batch"])
@pytest.mark.parametrize("options", [EVENTFUL, ON_MUJOCO, HISTORY], ids=["own", "mujoco", "tracking"])
def test_a_state_that_is_set_continues_as_before(lanes, options):
    """Through the start of another episode, in an environment that has not begun, with its earlier observations."""
    single, batch = TRACKING if "history" in options else (TwoLinkArmEnv, TwoLinkArmVectorEnv)
    make = single if lanes is None else functools.partial(batch, lanes)
    env, other = make(**options), make(**options)
    env.reset(seed=1)
    action = np.full(env.action_space.shape, 0.1)
    for _ in range(25):
        observation = env.step(action)[0]
    state, observation[:] = env.state(), np.nan  # the caller may change what was returned
    after = [env.step(action)[0] for _ in range(5)] + [env.reset()[0]]
    other.set_state(state)
    again = [other.step(action)[0] for _ in range(5)] + [other.reset()[0]]
    np.testing.assert_array_equal(again, after)
    for one, given in ((make(scenario="noise-2"), state), (other, state[0])):
        with pytest.raises(ValueError, match="same arguments and number of arms"):
            one.set_state(given)


@pytest.mark.parametrize("options", [{}, {"joint": {"frequency": 12, "rotor_inertia": 0.5}, "physics_dt": 5e-4}, PLANT])
def test_an_episode_starts_where_reset_says(options):
    """And the next one starts on its own reference again."""
    start = {"position": (-1.2, 0.4), "velocity": (0.5, -0.25), "reference": (-1.0, 0.5)}
    env, plain = TwoLinkArmEnv(**options), TwoLinkArmEnv(**options)
    env.reset(seed=3, options=start)
    first, *_, last = truths_of(env, np.zeros((300, 2)))
    np.testing.assert_array_equal([first.position, first.velocity, last.reference], [*start.values()])
    np.testing.assert_array_equal(env.reset(seed=3)[0], plain.reset(seed=3)[0])


def test_some_lanes_of_a_batch_start_where_reset_says():
    env = started_batch(20)
    mask = np.arange(20) % 3 == 0
    position = np.stack([np.linspace(-1.0, -0.5, 20), np.zeros(20)], axis=1)
    before = env.truth.position
    env.reset(options={"reset_mask": mask, "position": position})
    np.testing.assert_array_equal(env.truth.position, np.where(mask[:, None], position, before))


@pytest.mark.parametrize(("options", "reason"), [
    ({"position": (np.nan, 0.0)}, r"position must be finite numbers of shape \(2,\), got \(nan, 0.0\)"),
    ({"velocity": 1.0}, r"velocity must be finite numbers of shape \(2,\), got 1.0"),
    ({"reference": np.zeros((99, 2))}, "or fewer way-points, got shape"),
    ({"positon": (0.0, 0.0)}, "did you mean 'position'"),
    ({"reference": (0.0, 0.0)}, r"must be left out: .* this reference is sine"),
])  # fmt: skip
def test_a_start_that_cannot_be_is_refused(options, reason):
    reference = "sine" if "sine" in reason else "minimum-jerk"
    with pytest.raises(ValueError, match=reason):
        TwoLinkArmEnv(reference=reference).reset(options=options)
