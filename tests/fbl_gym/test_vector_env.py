"""The vector environment fulfils Gymnasium's rules; `test_lanes.py` tests the motion of its lanes."""

import itertools

import gymnasium as gym
import numpy as np
import pytest
from gymnasium.vector import AutoresetMode

from fbl_gym import TwoLinkArmEnv, TwoLinkArmVectorEnv
from fbl_gym.kernel.step import api
from tests.fbl_gym.episodes import ID, started_batch

MODES = [mode.value for mode in AutoresetMode]


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
    returned, finals = [env.reset(seed=0)[0]], []
    for _ in range(20):
        *arrays, infos = env.step(np.full((3, 2), 0.1))
        returned += arrays
        finals += [observation for observation in infos.get("final_obs", ()) if observation is not None]
        if mode == "Disabled" and arrays[3].any():
            env.reset()
    assert len(finals) == (12 if mode == "SameStep" else 0)
    returned += [*finals, env.truth.position]
    copies = [array.copy() for array in returned]
    env.reset(seed=9)
    env.step(np.full((3, 2), 0.3))
    for array, copied in zip(returned, copies, strict=True):
        np.testing.assert_array_equal(array, copied)
    assert not any(np.shares_memory(a, b) for a, b in itertools.combinations(returned, 2))


def test_make_vec_takes_the_same_options_as_make():
    options = {"scenario": "noise-1", "action": "acceleration", "preview": 2, "reward": {"tracking": "l1"}}
    envs = gym.make_vec(ID, 3, vectorization_mode="vector_entry_point", **options)
    assert isinstance(envs.unwrapped, TwoLinkArmVectorEnv)
    single = gym.make(ID, **options)
    for name in ("interface", "single_observation_space", "single_action_space"):
        assert getattr(envs.unwrapped, name) == getattr(single.unwrapped, name.removeprefix("single_"))
    assert envs.observation_space.shape == (3, *single.observation_space.shape)
    np.testing.assert_array_equal(envs.reset(seed=6)[0][0], single.reset(seed=6)[0])


@pytest.mark.parametrize("mode", [*AutoresetMode, *MODES, None])
def test_a_mode_is_given_as_gymnasium_takes_it(mode):
    given = {"autoreset_mode": mode} if mode else {}
    envs = gym.make_vec(ID, 2, vectorization_mode="vector_entry_point", **given)
    assert envs.metadata["autoreset_mode"] is AutoresetMode(mode or "NextStep")
    assert "autoreset_mode" not in TwoLinkArmEnv.metadata


@pytest.mark.parametrize("mode", MODES)
def test_an_episode_ends_at_the_smaller_of_max_episode_steps_and_duration(mode):
    for most, expected in ((5, 5), (50, 10)):
        env = started_batch(2, autoreset_mode=mode, max_episode_steps=most, duration=0.1)
        flags = [env.step(np.zeros((2, 2)))[3] for _ in range(expected)]
        assert np.array(flags).all(axis=1).tolist() == [False] * (expected - 1) + [True]


def test_actions_of_any_memory_layout_and_type_move_the_arms_alike():
    """None of them needs another compilation."""
    actions, spread = np.full((8, 2), 0.25), np.full((8, 4), 0.25)
    frozen = actions.copy()
    frozen.flags.writeable = False
    layouts = (
        frozen,
        spread[:, ::2],
        actions[::-1],
        np.asfortranarray(actions),
        actions.astype("f4"),
        actions.tolist(),
    )
    expected = started_batch(8).step(actions)[0]
    for given in layouts:
        env = started_batch(8)
        np.testing.assert_array_equal(env.step(given)[0], expected)
    env.reset(options={"reset_mask": np.ones(16, dtype=bool)[::2]})
    assert len(api.STEPS[0].signatures) == 1
