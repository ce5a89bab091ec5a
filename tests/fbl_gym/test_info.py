"""`info=True`: what training logs; `context=True`: what teachers see; and the previous actions in the observation."""

import numpy as np
import pytest

import fbl_gym
from fbl_gym import TwoLinkArmEnv


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
    plain, env = TwoLinkArmEnv(action=action), TwoLinkArmEnv(action=action, past_actions=2)
    a, b = plain.reset(seed=0)[0], env.reset(seed=0)[0]
    assert len(b) == len(a) + 4
    for action in ((0.1, 0.2), (0.3, 0.4)):
        a, b = plain.step(action)[0], env.step(action)[0]
        np.testing.assert_array_equal(a, b[: len(a)])
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
