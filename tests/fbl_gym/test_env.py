"""The single environment: rules of Gymnasium and stable-baselines3, seeds, infos, contexts, and actions up to the torque."""

import itertools
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


# Actions, from what is given to the torque at the joints.


MODES = ("normalized", "torque", "acceleration")


NOISY = {"noise": {"position": 0.1, "velocity": 0.3}, "parameter_error": 1.5}
SATURATED = {"limits": {"velocity": 1.0}, "noise": {"velocity": {"bias": 5.0}}}


@pytest.mark.parametrize("options", [
    *[{"action": mode, **NOISY} for mode in MODES],
    {"action": "torque", "actuator": None},
    {"action": MODES[2], **SATURATED},
], ids=str)  # fmt: skip
def test_the_interface_says_what_torque_an_action_makes(options):
    """And what action makes a torque; an acceleration goes through the nominal model at the readings that are shown."""
    env = TwoLinkArmEnv(**options)
    observation, _ = env.reset(seed=0)
    rng = np.random.default_rng(0)
    for k in range(60):
        reach = 1.5 if k % 3 == 0 else 0.1  # also where the action, or the torque it makes, is beyond its limit
        action = rng.uniform(-reach, reach, 2) * np.minimum(env.interface.action_limit, 2000.0)
        q, v = observation[env.layout["position"]], observation[env.layout["velocity"]]
        expected = env.interface.torque_from_action(action, q, v)
        if reach < 1.0:
            inverse = env.interface.action_from_torque(expected, q, v)
            np.testing.assert_allclose(inverse, action, rtol=1e-7, atol=1e-9)
        observation, _, terminated, *_ = env.step(action)
        np.testing.assert_allclose(env.truth.applied_torque, expected, rtol=1e-12, atol=1e-9)
        if terminated:
            break


HUGE = ({"bias": 1e200}, {"bias": -1e308, "sigma": 1e308}, {"quantization": 1e-310}, {"quantization": 1e308})


@pytest.mark.parametrize("error", HUGE, ids=str)
@pytest.mark.parametrize("sensor", ["position", "velocity"])
def test_a_reading_beyond_all_bounds_makes_no_nan(sensor, error):
    """Not in the torque that an acceleration becomes at that reading, nor, before a delay lets it through, in the reward."""
    env = started(action="acceleration", actuator={"delay": 0.02}, noise={sensor: error})
    for _ in range(5):
        observation, reward, terminated, *_ = env.step((1.0, 1.0))
        assert observation in env.observation_space
        assert 0.0 <= reward <= 1.0
        assert np.isfinite(env.truth.applied_torque).all()
        if terminated:
            break


@pytest.mark.parametrize("mode", MODES)
def test_an_action_outside_its_box_acts_as_the_nearest_inside(mode):
    one, two = started(action=mode), started(action=mode)
    edge = np.array(one.interface.action_limit)
    for far, inside in itertools.product((1.5, 1e9, 1e300), ((1.0, -0.25), (0.0, -1.0))):
        beyond = np.where(np.abs(inside) == 1.0, far, 1.0) * inside
        np.testing.assert_equal(one.step(beyond * edge), two.step(inside * edge))


def test_a_refused_reset_leaves_no_start_behind():
    env = TwoLinkArmEnv()
    with pytest.raises(ValueError, match="seed"):
        env.reset(seed=1.0, options={"position": (0.3, 0.4)})
    np.testing.assert_array_equal(env.reset(seed=0)[0], TwoLinkArmEnv().reset(seed=0)[0])


@pytest.mark.parametrize("kind", [np.float64, np.float32])
def test_an_action_keeps_its_precision(kind):
    env = started()
    env.step(np.array([0.1, 0.1], dtype=kind))
    np.testing.assert_array_equal(env.truth.applied_torque, np.float64(kind(0.1)) * np.array([2000.0, 800.0]))


@pytest.mark.parametrize(("bad", "message"), [
    ((np.nan, -np.inf), "be finite, got .*nan"), ((0.0, np.inf), "be finite, got .*inf"),
    *[(bad, rf"be numbers of shape \(2,\), got shape \({text}\)")
      for bad, text in ((0.5, ""), (np.zeros(3), "3,"), (np.zeros((1, 2)), "1, 2"))],
    (("a", "b"), r"be numbers of shape \(2,\), got \('a', 'b'\)"),
    *[(bad, "") for bad in ("ab", None, [None, None], {}, (1j, 0.0), np.array([1j, 0.0]))],
], ids=str)  # fmt: skip
def test_what_is_not_two_numbers_is_refused_in_mid_episode(bad, message):
    """And the run goes on, over many steps, as that of an undisturbed twin: observations, rewards, truth."""
    env, twin = TwoLinkArmEnv(**RECORDS), TwoLinkArmEnv(**RECORDS)
    episode(env, 10)
    episode(twin, 10)
    for k in range(30):
        if k % 7 == 0:
            with pytest.raises(ValueError, match=f"action must {message}"):
                env.step(bad)
        np.testing.assert_equal(env.step((0.1, 0.02 * k)), twin.step((0.1, 0.02 * k)))
        np.testing.assert_array_equal(env.truth.velocity, twin.truth.velocity)


def test_a_bad_action_at_the_border_of_an_episode_is_no_step_either():
    env = started(duration=0.01)
    with pytest.raises(ValueError, match="finite"):
        env.step((np.nan, 0.0))
    assert env.step((0.0, 0.0))[3]
