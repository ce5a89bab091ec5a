"""`info=True`: what training logs, and the previous actions in the observation."""

import numpy as np
import pytest
from gymnasium.vector import SyncVectorEnv

from fbl_gym import TwoLinkArmEnv, TwoLinkArmVectorEnv

REWARDS = [{}, {"tracking": "l1", "weight_effort": 0.5, "weight_chatter": 0.0}]


@pytest.mark.parametrize("reward", REWARDS)
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


def test_the_info_is_empty_without_the_option():
    env = TwoLinkArmEnv()
    env.reset(seed=0)
    assert env.step(np.zeros(2))[4] == {}


@pytest.mark.parametrize("mode", ["NextStep", "SameStep"])
def test_the_info_of_a_batch_is_that_of_single_environments(mode):
    options = {"scenario": "everything-2", "duration": 0.1, "info": True}
    ours = TwoLinkArmVectorEnv(2, autoreset_mode=mode, **options)
    theirs = SyncVectorEnv([lambda: TwoLinkArmEnv(**options)] * 2, autoreset_mode=mode)
    ours.reset(seed=0)
    theirs.reset(seed=0)
    for step in range(1, 25):
        a, b = (env.step(np.full((2, 2), 0.3))[4] for env in (ours, theirs))
        restarts = step % 10 == 0 if mode == "SameStep" else step % 11 == 0
        assert not (a["_tracking_error"] ^ (not restarts)).any()
        if not restarts:
            for name in ("tracking_error", "tracking_loss", "effort_loss", "chatter_loss", "saturation"):
                np.testing.assert_allclose(a[name], b[name], rtol=1e-12)


@pytest.mark.parametrize("action", ["normalized", "torque", "acceleration"])
def test_previous_actions_are_observed_on_demand(action):
    plain, env = TwoLinkArmEnv(action=action), TwoLinkArmEnv(action=action, past_actions=2)
    a, b = plain.reset(seed=0)[0], env.reset(seed=0)[0]
    assert len(b) == len(a) + 4
    for action in ((0.1, 0.2), (0.3, 0.4)):
        a, b = plain.step(action)[0], env.step(action)[0]
        np.testing.assert_array_equal(a, b[: len(a)])
    np.testing.assert_array_equal(b[-4:], [0.3, 0.4, 0.1, 0.2])
