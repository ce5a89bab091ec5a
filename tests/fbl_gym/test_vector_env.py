"""The vector environment fulfils Gymnasium's rules; `test_lanes.py` tests the motion of its lanes."""

import gymnasium as gym
import numpy as np
import pytest
from gymnasium.vector import AutoresetMode

from fbl_gym import TwoLinkArmEnv, TwoLinkArmVectorEnv
from fbl_gym.kernel import api
from tests.fbl_gym.episodes import started_batch

MODES = [mode.value for mode in AutoresetMode]


def test_the_default_autoreset_mode_is_next_step():
    assert TwoLinkArmVectorEnv(2).metadata["autoreset_mode"] is AutoresetMode.NEXT_STEP
    assert TwoLinkArmVectorEnv(2, autoreset_mode="SameStep").metadata["autoreset_mode"] is AutoresetMode.SAME_STEP


@pytest.mark.parametrize("scenario", ["everything-3", "servo-elastic-2"])
def test_true_signals_are_those_of_the_truth(scenario):
    env = started_batch(17, scenario)
    env.step(np.full((17, 2), 0.1))
    signals, truth = env.true_signals(), vars(env.truth)
    truth["command"] = truth["commands"][:, 0]
    assert set(signals) == {"position", "velocity", "reference", "command", "applied_torque", "disturbance", "payload"}
    for name, values in signals.items():
        np.testing.assert_array_equal(values, truth[name])


@pytest.mark.parametrize("mode", MODES)
def test_returned_arrays_are_never_changed_later(mode):
    env = TwoLinkArmVectorEnv(3, autoreset_mode=mode, duration=0.05)
    returned = [(env.reset(seed=0)[0], np.zeros(3), np.zeros(3), np.zeros(3))]
    copies = [[x.copy() for x in returned[0]]]
    finals, before = [], []
    for _ in range(20):
        *arrays, infos = env.step(np.full((3, 2), 0.1))
        returned.append(arrays)
        copies.append([x.copy() for x in arrays])
        finals += [x for x in infos.get("final_obs", ()) if x is not None]
        before += [x.copy() for x in infos.get("final_obs", ()) if x is not None]
        if mode == "Disabled" and arrays[3].any():
            env.reset()
    truth = env.truth
    position = truth.position.copy()
    env.reset(seed=9)
    env.step(np.full((3, 2), 0.3))
    for arrays, old in zip(returned, copies, strict=True):
        for x, y in zip(arrays, old, strict=True):
            np.testing.assert_array_equal(x, y)
    for x, y in zip(finals, before, strict=True):
        np.testing.assert_array_equal(x, y)
    np.testing.assert_array_equal(truth.position, position)
    assert len(finals) == (12 if mode == "SameStep" else 0)


def test_make_vec_takes_the_same_options_as_make():
    options = {"scenario": "noise-1", "action": "acceleration", "preview": 2, "reward": {"tracking": "l1"}}
    envs = gym.make_vec("fbl_gym/TwoLinkArm-v0", 3, vectorization_mode="vector_entry_point", **options)
    assert isinstance(envs.unwrapped, TwoLinkArmVectorEnv)
    single = gym.make("fbl_gym/TwoLinkArm-v0", **options)
    assert envs.unwrapped.interface == single.unwrapped.interface
    assert envs.single_observation_space == single.observation_space
    assert envs.single_action_space == single.action_space
    assert envs.observation_space.shape == (3, single.observation_space.shape[0])
    assert envs.metadata["autoreset_mode"] is AutoresetMode.NEXT_STEP
    actions = np.array([[1.0, 2.0]] * 3)
    np.testing.assert_array_equal(envs.reset(seed=6)[0][0], single.reset(seed=6)[0])
    a, b = envs.step(actions), single.step(actions[0])
    np.testing.assert_array_equal(a[0][0], b[0])
    assert a[1][0] == b[1]


@pytest.mark.parametrize("mode", [*AutoresetMode, *MODES])
def test_a_mode_is_given_as_gymnasium_takes_it(mode):
    envs = gym.make_vec("fbl_gym/TwoLinkArm-v0", 2, vectorization_mode="vector_entry_point", autoreset_mode=mode)
    actual = envs.metadata["autoreset_mode"]
    assert isinstance(actual, AutoresetMode)
    assert mode in (actual, actual.value)
    assert "autoreset_mode" not in TwoLinkArmEnv.metadata


@pytest.mark.parametrize("mode", MODES)
def test_an_episode_ends_at_the_smaller_of_max_episode_steps_and_duration(mode):
    for most, expected in ((5, 5), (50, 10)):
        env = started_batch(2, autoreset_mode=mode, max_episode_steps=most, duration=0.1)
        flags = [env.step(np.zeros((2, 2)))[3] for _ in range(expected)]
        assert np.array(flags).all(axis=1).tolist() == [False] * (expected - 1) + [True]


def test_actions_of_any_memory_layout_and_type_move_the_arms_alike():
    """None of them needs another compilation."""
    spread = np.zeros((8, 4))
    spread[:, ::2] = 0.25
    actions = np.full((8, 2), 0.25)
    frozen = actions.copy()
    frozen.flags.writeable = False
    observations = []
    for given in (
        actions,
        frozen,
        spread[:, ::2],
        actions[::-1],
        np.asfortranarray(actions),
        actions.astype("f4"),
        actions.tolist(),
    ):
        env = started_batch(8)
        observations.append(env.step(given)[0])
    env.reset(options={"reset_mask": np.ones(16, dtype=bool)[::2]})
    assert all(np.array_equal(observations[0], other) for other in observations)
    assert len(api.STEPS[0].signatures) == 1
