"""`ArmVecEnv` equals SB3's `DummyVecEnv` of single environments, bit for bit."""

import gymnasium as gym
import numpy as np
import pytest
from stable_baselines3.common.vec_env import DummyVecEnv

import fbl_gym
from benchmarks.rl.vec_env import ArmVecEnv

LANES = 3
# Some lanes diverge, others are truncated, at different steps.
OPTIONS = {
    "scenario": "everything-3", "duration": 0.4, "limits": {"velocity": 4.0}, "constraints": {"velocity": 2.0},
}  # fmt: skip


def batched():
    return ArmVecEnv(fbl_gym.TwoLinkArmTrackingVectorEnv(LANES, autoreset_mode="SameStep", **OPTIONS))


def singles():
    make = lambda: gym.make("fbl_gym/TwoLinkArmTracking-v0", **OPTIONS)
    return DummyVecEnv([make] * LANES)


def test_every_step_equals_that_of_single_environments():
    ours, theirs = batched(), singles()
    assert ours.observation_space == theirs.observation_space
    assert ours.action_space == theirs.action_space
    rng, ends, costs = np.random.default_rng(0), {True: 0, False: 0}, set()
    for seed in (5, None, 9):
        if seed is not None:
            assert ours.seed(seed) == theirs.seed(seed)
        np.testing.assert_array_equal(ours.reset(), theirs.reset())
        assert ours.reset_infos == theirs.reset_infos
        for _ in range(100):
            actions = rng.uniform(-0.5, 0.5, (LANES, 2)).astype(np.float32)
            one, two = ours.step(actions), theirs.step(actions)
            for a, b in zip(one[:3], two[:3], strict=True):
                np.testing.assert_array_equal(a, b)
                assert a.dtype == b.dtype
            for info, single_info in zip(one[3], two[3], strict=True):
                assert info.keys() == single_info.keys()
                assert info["cost"] == single_info["cost"]
                costs.add(info["cost"])
                assert info["TimeLimit.truncated"] is bool(single_info["TimeLimit.truncated"])
                if "terminal_observation" in single_info:
                    np.testing.assert_array_equal(info["terminal_observation"], single_info["terminal_observation"])
                    ends[info["TimeLimit.truncated"]] += 1
    assert min(ends.values()) > 0
    assert costs == {0.0, 1.0}


def test_attributes_and_methods_follow_sb3():
    env = batched()
    assert env.get_attr("render_mode") == [None] * LANES
    assert env.get_attr("interface", indices=1) == [env.envs[0].unwrapped.interface]
    assert env.env_is_wrapped(gym.wrappers.TimeLimit) == [False] * LANES
    assert not env.has_attr("no_such_thing")
    for change in (lambda: env.set_attr("scenario", None), lambda: env.env_method("reset")):
        with pytest.raises(AttributeError, match="lanes share one environment"):
            change()


def test_environments_side_by_side_are_one():
    def batch(scenario):
        duration = 0.05 if scenario == "nominal" else 0.1
        return fbl_gym.TwoLinkArmTrackingVectorEnv(2, scenario, autoreset_mode="SameStep", duration=duration)

    names = ("nominal", "everything-2")
    together, parts = ArmVecEnv(*map(batch, names)), [ArmVecEnv(batch(name)) for name in names]
    for seed, env in ((1, together), (1, parts[0]), (3, parts[1])):
        env.seed(seed)
    np.testing.assert_array_equal(together.reset(), np.concatenate([part.reset() for part in parts]))
    rng, ends = np.random.default_rng(0), np.zeros(4)
    for _ in range(12):
        actions = rng.uniform(-1, 1, (4, 2)).astype(np.float32)
        *signals, infos = together.step(actions)
        one, two = parts[0].step(actions[:2]), parts[1].step(actions[2:])
        for signal, *halves in zip(signals, one, two, strict=False):
            np.testing.assert_array_equal(signal, np.concatenate(halves))
        for info, half in zip(infos, one[3] + two[3], strict=True):
            np.testing.assert_equal(info, half)
        ends += signals[2]
    assert ends.tolist() == [2, 2, 1, 1]


def test_seeds_and_options_hold_for_one_reset():
    env = batched()
    env.seed(4)
    first, second = env.reset(), env.reset()
    assert np.any(first != second)
    env.set_options({"mass": 3})
    with pytest.raises(ValueError, match="unknown reset option 'mass'"):
        env.reset()


def test_another_autoreset_mode_is_refused():
    with pytest.raises(ValueError, match="autoreset_mode"):
        ArmVecEnv(fbl_gym.TwoLinkArmVectorEnv(2))


def test_render_shows_all_lanes():
    pytest.importorskip("pygame")
    env = ArmVecEnv(fbl_gym.TwoLinkArmVectorEnv(2, autoreset_mode="SameStep", render_mode="rgb_array", render_size=160))
    env.seed(0)
    env.reset()
    assert env.render("rgb_array").shape == (320, 160, 3)
    assert env.metadata["render_fps"] == 100
