"""Train PPO with a price on the cost of constraints, which rises while the cost is too frequent.

python examples/priced_ppo.py my_bounds.toml

It takes about ten minutes.
"""

import sys

import gymnasium as gym
import numpy as np
from stable_baselines3 import PPO
from stable_baselines3.common.callbacks import BaseCallback

from fbl_gym import scenarios


class Priced(gym.Wrapper):
    """An environment whose reward is less the price of its cost."""

    def __init__(self, env):
        super().__init__(env)
        self.price, self.costs = 0.0, []

    def step(self, action):
        observation, reward, terminated, truncated, info = self.env.step(action)
        self.costs.append(info["cost"])
        return observation, reward - self.price * info["cost"], terminated, truncated, info


class Price(BaseCallback):
    """Move the price after each batch of steps."""

    def _on_step(self):
        return True

    def _on_rollout_end(self):
        env.price = max(0.0, env.price + 0.5 * (np.mean(env.costs) - 0.01))
        env.costs.clear()


env = Priced(gym.make("fbl_gym/TwoLinkArmTracking-v0", scenario=scenarios.get(sys.argv[1])))
model = PPO("MlpPolicy", env, seed=1_000_000, device="cpu")  # the seeds 0 to 9,999 are for tests
model.learn(300_000, callback=Price())
model.save("priced")
