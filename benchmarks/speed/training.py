"""Training steps per CPU second: PPO on the batched environment beside PPO on a single one.

`python -m benchmarks.speed.training` prints both and their ratio.
"""

import time
from statistics import median

import gymnasium as gym
import torch
from stable_baselines3 import PPO
from stable_baselines3.common.logger import Logger

from benchmarks.rl.training_settings import shipped_hyperparameters
from benchmarks.rl.vec_env import ArmVecEnv
from fbl_gym.tracking import TwoLinkArmTrackingVectorEnv


def measure_training(rounds: int = 3) -> tuple[float, float]:
    """Return the steps per CPU second of the batch and of the single environment, as medians.

    Both learn with the shipped hyperparameters, and take equally many steps between two updates. A
    round more than those measured warms up.
    """
    hyperparameters = shipped_hyperparameters("ppo")
    lanes, arguments = hyperparameters["lanes"], hyperparameters["arguments"]
    steps = lanes * arguments["n_steps"]
    arms = TwoLinkArmTrackingVectorEnv(lanes, "everything-2", autoreset_mode="SameStep")
    arm = gym.make("fbl_gym/TwoLinkArmTracking-v0", scenario="everything-2")
    batched = PPO("MlpPolicy", ArmVecEnv(arms), device="cpu", **arguments)
    single = PPO("MlpPolicy", arm, device="cpu", **{**arguments, "n_steps": steps})
    for model in (batched, single):
        model.set_logger(Logger(None, []))  # the default one makes a folder in /tmp
    rates: dict[PPO, list[float]] = {batched: [], single: []}
    for _ in range(rounds + 1):
        for model, values in rates.items():
            begin = time.process_time()
            model.learn(steps, reset_num_timesteps=False)
            values.append(steps / (time.process_time() - begin))
    return median(rates[batched][1:]), median(rates[single][1:])


if __name__ == "__main__":
    torch.set_num_threads(1)
    batched_rate, single_rate = measure_training()
    print(
        f"{batched_rate:,.0f} steps per CPU second batched, {single_rate:,.0f} single: "
        f"{batched_rate / single_rate:.1f} times"
    )
