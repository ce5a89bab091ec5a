"""The option `reward`."""

from fbl_gym import TwoLinkArmEnv


def test_reward_reaches_the_reward():
    rewards = []
    for reward in (None, {"tracking": "l1"}, {"worst": 0.5}, {"resolution": 0.1}, {"weight_effort": 1.0}):
        env = TwoLinkArmEnv(reward=reward, initial_error=0.05)
        env.reset(seed=0)
        rewards.append(env.step((0.1, 0.1))[1])
    env = TwoLinkArmEnv(reward={"weight_chatter": 2.0}, initial_error=0.05)
    env.reset(seed=0)
    rewards.append(env.step((0.1, 0.1))[1])
    assert len(set(rewards)) == 6
