"""The single environment: rules of Gymnasium and stable-baselines3, seeds, infos and contexts."""

import random

import gymnasium as gym
import numpy as np
import pytest
from gymnasium.utils.env_checker import check_env

import fbl_gym
from fbl_gym import TwoLinkArmEnv, TwoLinkArmVectorEnv
from tests.fbl_gym.episodes import ID, MUJOCO, RECORDS, TIGHT, TRACKING, episode, needs_mujoco, started

COSTS = {"constraints": TIGHT}
PASSIVE = {"scenario": "dfki-c1-acrobot"}


@pytest.mark.parametrize(("name", "options"), [
    *[(ID, options) for options in ({}, RECORDS, {"scenario": "everything-3"}, COSTS, PASSIVE)],
    *[(TRACKING, options) for options in ({}, RECORDS, {"scenario": "servo-delay-2"}, COSTS, PASSIVE)],
    *[pytest.param(MUJOCO, options, marks=needs_mujoco) for options in ({}, {"scenario": "everything-2"}, PASSIVE)],
], ids=lambda value: str(value)[:30])  # fmt: skip
def test_checkers_pass_without_a_warning(name, options):
    """pytest turns every warning into an error, with those of Gymnasium's logger."""
    env = gym.make(name, **options)
    check_env(env.unwrapped)
    pytest.importorskip("stable_baselines3.common.env_checker").check_env(env)


def test_truth_is_a_copy_and_reading_it_changes_nothing():
    env, twin = started("everything-2"), started("everything-2")
    for _ in range(50):
        truth, before = env.truth, env.truth.position
        truth.velocity[:] = 99.0
        np.testing.assert_array_equal(env.step((0.1, 0.1))[0], twin.step((0.1, 0.1))[0])
        np.testing.assert_array_equal(truth.position, before)


def test_returned_arrays_are_never_changed_later():
    env = TwoLinkArmEnv(**RECORDS)
    observations = [env.reset(seed=0)[0], *(env.step((0.1, 0.1))[0] for _ in range(50)), env.reset()[0]]
    copies, infos = np.array(observations), [env.step((0.2, 0.2))[4] for _ in range(10)]
    np.testing.assert_array_equal(observations, copies)
    assert len({*map(id, infos)}) == 10


def test_an_action_is_neither_changed_nor_shared():
    env, twin = started(actuator={"delay": 0.02}), started(actuator={"delay": 0.02})
    env.step(action := np.array([3.0, -0.5]))
    np.testing.assert_array_equal(action, [3.0, -0.5])
    action[:] = 0.0
    twin.step((3.0, -0.5))
    np.testing.assert_array_equal(env.step((0.1, 0.1))[0], twin.step((0.1, 0.1))[0])


@pytest.mark.parametrize("reward", [{}, {"tracking": "l1", "weight_effort": 0.5, "weight_chatter": 0.0}], ids=str)
def test_the_losses_add_up_to_the_reward(reward):
    env = TwoLinkArmEnv("everything-2", reward=reward, info=True)
    assert env.reset(seed=0)[1] == {}
    rng = np.random.default_rng(0)
    for _ in range(30):
        _, value, _, _, info = env.step(rng.uniform(-1.5, 1.5, 2))
        losses = sum(info[f"{name}_loss"] for name in ("tracking", "effort", "chatter"))
        assert value == pytest.approx(1.0 - losses, abs=1e-9)
        np.testing.assert_array_equal(info["tracking_error"], env.truth.reference - env.truth.position)
    env.step((1.0, 0.0))
    assert env.step((-1.5, 0.5))[4]["saturation"] == 0.5


@pytest.mark.parametrize("action", ["normalized", "torque", "acceleration"])
def test_previous_actions_are_observed_on_demand(action):
    plain, env = started(action=action), started(action=action, past_actions=2)
    for action in ((0.1, 0.2), (0.3, 0.4)):
        a, b = plain.step(action)[0], env.step(action)[0]
        np.testing.assert_array_equal(a, b[:-4])
    np.testing.assert_array_equal(b[-4:], [0.3, 0.4, 0.1, 0.2])


@pytest.mark.parametrize("name", ["TwoLinkArmEnv", "TwoLinkArmTrackingEnv"])
def test_the_context_is_the_truth_of_the_episode_and_not_observed(name):
    make = getattr(fbl_gym, name)
    env, plain = make("servo-practice-everything-3", context=True), make("servo-practice-everything-3")
    assert env.observation_space == plain.observation_space
    contexts = []
    for seed in (0, None):
        (observation, info), (twin, nothing) = env.reset(seed=seed), plain.reset(seed=seed)
        np.testing.assert_array_equal(observation, twin)
        assert (info.keys(), nothing, info["context"].shape) == ({"context"}, {}, (len(env.context_names),))
        numbers, truth = dict(zip(env.context_names, info["context"], strict=True)), env.truth
        for field in ("viscous", "coulomb", "load_friction", "gain", "stiffness"):
            assert [numbers[f"{field}[{joint}]"] for joint in (0, 1)] == getattr(truth, field).tolist()
        assert [numbers[f"parameters[{i}]"] for i in range(4)] == [*truth.masses, *truth.lengths]
        assert numbers["delay[0]"] * env.scenario.physics_dt == pytest.approx(truth.delay)
        assert np.isfinite(info["context"]).all()
        contexts.append(info["context"])
        np.testing.assert_array_equal(env.step((0.1, 0.1))[0], plain.step((0.1, 0.1))[0])
        assert env.step((0.1, 0.1))[4] == {}
        plain.step((0.1, 0.1))
    assert np.mean(contexts[0] != contexts[1]) > 0.2


@pytest.mark.parametrize("options", [{"scenario": "everything-2"}, RECORDS], ids=["scenario", "records"])
def test_an_episode_is_a_function_of_its_seed(options):
    env = TwoLinkArmEnv(**options)
    first, other = episode(env, seed=1), episode(env, 21, seed=2)
    assert not np.array_equal(first[:22], other)
    for steps in (0, 14):  # whatever episodes came before
        episode(env, steps, seed=3)
        np.testing.assert_array_equal(first, episode(env, seed=1))
    second = started(**options, seed=1).reset()[0]
    assert not np.array_equal(second, first[0, :-1])
    np.testing.assert_array_equal(started(**options, seed=1).reset()[0], second)


def test_no_numpy_or_python_random_state_is_touched_by_making_seeding_or_drawing():
    before = random.getstate(), repr(np.random.get_state(legacy=False))  # noqa: NPY002
    env = TwoLinkArmEnv("everything-3", reference="fourier")
    env.reset()
    env.reset(seed=4)
    episode(env)
    assert random.getstate() == before[0]
    assert repr(np.random.get_state(legacy=False)) == before[1]  # noqa: NPY002


@pytest.mark.parametrize("seed", [-1, 1.5, "1", True, 2**64])
def test_a_bad_seed_is_an_error(seed):
    with pytest.raises(ValueError, match=r"seed must be (a whole number not below 0|below 2\*\*64), got"):
        TwoLinkArmEnv().reset(seed=seed)
    TwoLinkArmEnv().reset(seed=2**64 - 1)


def test_seeds_may_be_numpy_numbers():
    env = TwoLinkArmVectorEnv(2)
    first, *others = (env.reset(seed=seed)[0] for seed in (np.int64(3), np.array([3, 4]), (3, 4)))
    np.testing.assert_array_equal(others, [first, first])


def test_episodes_and_lanes_without_a_seed_differ():
    starts = [TwoLinkArmEnv().reset()[0][0] for _ in range(2)]
    assert len({*starts, *TwoLinkArmVectorEnv(16).reset()[0][:, 0]}) == 18
