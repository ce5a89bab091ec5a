"""Train an agent of stable-baselines3, and judge it by the metrics of the board.

    python examples/train_sb3.py

It takes about two minutes. The saved model is a policy of every command:

    fbl-gym evaluate model.zip computed-torque@tuned --trust --scenario servo-nominal
"""

import gymnasium as gym
import torch
from stable_baselines3 import PPO

import benchmarks
import fbl_gym  # noqa: F401  registers the environments

torch.set_num_threads(1)  # small networks learn fastest so
env = gym.make("fbl_gym/TwoLinkArmTracking-v0", scenario="servo-practice-everything-1")
model = PPO("MlpPolicy", env, seed=1_000_000, device="cpu")  # the seeds 0 to 9,999 are for tests
model.learn(150_000)
model.save("model")

for policy in ("model.zip", "computed-torque@tuned"):
    runs = benchmarks.evaluate(policy, "servo-nominal", seeds=16, trust=True)
    print(f"{policy}: error {runs.error_pct.median():.2f} %, {100 * runs.diverged.mean():.0f} % diverged")
