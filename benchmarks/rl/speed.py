"""PPO on the batch beside PPO on one environment: steps per second of processor time, in one interleaved run.

`python -m benchmarks.rl.speed` prints both and their ratio.
"""

from __future__ import annotations

import time
from statistics import median

import gymnasium as gym
import torch
from stable_baselines3 import PPO

from benchmarks.rl.settings import shipped_hyperparameters
from benchmarks.rl.vec_env import ArmVecEnv
from fbl_gym.vector_env import TwoLinkArmVectorEnv
from fbl_gym.wrappers import ErrorCoordinates, VectorErrorCoordinates


def measure_speed(rounds: int = 3) -> tuple[float, float]:
    """Steps per CPU second of the batch and of one environment, medians over the rounds.

    Both learn with the shipped hyper-parameters, and from equally many steps between two updates.
    """
    own = shipped_hyperparameters("ppo")
    lanes, arguments = own["lanes"], own["arguments"]
    batch = TwoLinkArmVectorEnv(lanes, "everything-2", autoreset_mode="SameStep")
    one = ErrorCoordinates(gym.make("fbl_gym/TwoLinkArm-v0", scenario="everything-2"))
    rollout = lanes * arguments["n_steps"]
    many = PPO("MlpPolicy", ArmVecEnv(VectorErrorCoordinates(batch)), device="cpu", **arguments)
    single = PPO("MlpPolicy", one, device="cpu", **{**arguments, "n_steps": rollout})
    rates: dict[PPO, list[float]] = {many: [], single: []}
    for _ in range(rounds + 1):
        for model, found in rates.items():
            begin = time.process_time()
            model.learn(rollout, reset_num_timesteps=False)
            found.append(rollout / (time.process_time() - begin))
    return median(rates[many][1:]), median(rates[single][1:])  # the first round warms up


if __name__ == "__main__":
    torch.set_num_threads(1)
    batch_rate, one_rate = measure_speed()
    print(f"{batch_rate:,.0f} steps per CPU second batched, {one_rate:,.0f} alone: {batch_rate / one_rate:.1f} times")
