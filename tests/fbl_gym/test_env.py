"""The single environment fulfils the rules of Gymnasium and stable-baselines3."""

import gymnasium as gym
import numpy as np
import pytest
from gymnasium.error import ResetNeeded
from gymnasium.utils.env_checker import check_env

from fbl_gym import TwoLinkArmEnv
from tests.fbl_gym.episodes import ID, MUJOCO, RECORDS, TIGHT, TRACKING, started

COSTS = {"constraints": TIGHT}
PASSIVE = {"scenario": "dfki-c1-acrobot"}


@pytest.mark.parametrize(
    ("name", "options"),
    [
        *[(ID, options) for options in ({}, RECORDS, {"scenario": "everything-3"}, COSTS, PASSIVE)],
        *[(TRACKING, options) for options in ({}, RECORDS, {"scenario": "servo-delay-2"}, COSTS, PASSIVE)],
        *[(MUJOCO, options) for options in ({}, {"scenario": "everything-2"}, PASSIVE)],
    ],
    ids=lambda value: str(value)[:30],
)
def test_checkers_pass_without_a_warning(name, options):
    """pytest turns every warning into an error, with those of Gymnasium's logger."""
    if name == MUJOCO:
        pytest.importorskip("mujoco")
    env = gym.make(name, **options)
    check_env(env.unwrapped)
    pytest.importorskip("stable_baselines3.common.env_checker").check_env(env)


def test_an_episode_is_truncated_after_its_duration_and_then_needs_a_reset():
    env = TwoLinkArmEnv(duration=0.2)
    with pytest.raises(ResetNeeded, match=r"call reset\(\)"):
        env.step((0, 0))
    env.reset(seed=0)
    flags = [env.step((0, 0))[2:4] for _ in range(20)]
    assert flags == [(False, False)] * 19 + [(False, True)]
    with pytest.raises(ResetNeeded):
        env.step((0, 0))
    env.reset()
    env.step((0, 0))


def test_truth_is_a_copy_and_reading_it_changes_nothing():
    env, twin = started("everything-2"), started("everything-2")
    for _ in range(50):
        truth = env.truth
        before = truth.position.copy()
        truth.velocity[:] = 99.0
        a, b = env.step((0.1, 0.1)), twin.step((0.1, 0.1))
        np.testing.assert_array_equal(a[0], b[0])
        np.testing.assert_array_equal(truth.position, before)


def test_returned_arrays_are_never_changed_later():
    env = TwoLinkArmEnv(**RECORDS)
    observations = [env.reset(seed=0)[0]] + [env.step((0.1, 0.1))[0] for _ in range(50)] + [env.reset()[0]]
    copies = [observation.copy() for observation in observations]
    infos = [env.step((0.2, 0.2))[4] for _ in range(10)]
    np.testing.assert_array_equal(observations, copies)
    assert len({id(info) for info in infos}) == 10


def test_an_action_is_neither_changed_nor_shared():
    env, twin = started(actuator={"delay": 0.02}), started(actuator={"delay": 0.02})
    action = np.array([3.0, -0.5])
    env.step(action)
    np.testing.assert_array_equal(action, [3.0, -0.5])
    action[:] = 0.0
    twin.step((3.0, -0.5))
    np.testing.assert_array_equal(env.step((0.1, 0.1))[0], twin.step((0.1, 0.1))[0])
