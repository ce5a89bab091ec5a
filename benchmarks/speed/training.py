"""Time of PPO to an error: on the batch, on SB3's `DummyVecEnv` of as many arms, and on one arm.

`python -m benchmarks.speed.training` prints medians over the training seeds, one line for each way,
and the shares of the processor time. The batch and the `DummyVecEnv` learn the same bits.
"""

import argparse
import math
import time
from collections.abc import Callable
from statistics import median
from typing import Any

import gymnasium as gym
import torch
from stable_baselines3 import PPO
from stable_baselines3.common.logger import Logger
from stable_baselines3.common.vec_env import DummyVecEnv, VecEnv

from benchmarks.rl.training_settings import LANES, shipped_hyperparameters
from benchmarks.rl.validation import VALIDATION, tracking_error
from benchmarks.rl.vec_env import ArmVecEnv
from benchmarks.seeds import SPLITS
from fbl_gym.tracking import TwoLinkArmTrackingVectorEnv

ID, SCENARIO = "fbl_gym/TwoLinkArmTracking-v0", "practice-everything-3"
ERRORS = 100, 30
"""Validation errors to reach [mrad]."""


def ways(lanes: int) -> dict[str, Callable[[], VecEnv]]:
    """Return functions that make the environments, by the names of the lines."""
    make = lambda: gym.make(ID, scenario=SCENARIO)  # noqa: E731
    batch: dict[str, Any] = {"vectorization_mode": "vector_entry_point", "autoreset_mode": "SameStep"}
    return {
        f"ArmVecEnv, {lanes}": lambda: ArmVecEnv(gym.make_vec(ID, lanes, scenario=SCENARIO, **batch)),
        f"DummyVecEnv, {lanes}": lambda: DummyVecEnv([make] * lanes),
        "one arm": lambda: DummyVecEnv([make]),
    }


def measure_training(env: VecEnv, seed: int, updates: int) -> dict[str, float]:
    """Train until the last of `ERRORS`, or for a number of updates; return steps, times and shares.

    The hyperparameters are the shipped ones, with a constant learning rate. Each environment takes
    equally many steps between two updates. After every other update there is a validation, whose
    time does not count.
    """
    shipped = shipped_hyperparameters("ppo")
    arguments, steps = shipped["arguments"], shipped["lanes"] * shipped["arguments"]["n_steps"]
    arguments["n_steps"] = steps // env.num_envs
    model = PPO("MlpPolicy", env, seed=SPLITS["training"][seed * LANES], device="cpu", **arguments)
    model.set_logger(Logger(None, []))  # the default one makes a folder in /tmp
    stepping, updating = _Timed(env, "step"), _Timed(model, "train")
    arms = TwoLinkArmTrackingVectorEnv(len(VALIDATION), SCENARIO)
    reached: dict[str, float] = {}
    left, cpu, wall = list(ERRORS), 0.0, 0.0
    while left and model.num_timesteps < updates * steps:
        cpu, wall = cpu - time.process_time(), wall - time.perf_counter()
        model.learn(2 * steps, reset_num_timesteps=False)
        cpu, wall = cpu + time.process_time(), wall + time.perf_counter()
        error = tracking_error(model, arms, VALIDATION).mean()
        while left and error <= left[0]:
            place = f"to {left.pop(0)} mrad"
            reached |= {f"steps {place}": model.num_timesteps, f"CPU s {place}": cpu, f"wall s {place}": wall}
    step, update = 100 * stepping.total / cpu, 100 * updating.total / cpu
    shares = {"step %": step, "decisions %": 100 - step - update, "update %": update}
    return {"steps/CPU s": model.num_timesteps / cpu, **shares, **reached}


class _Timed:
    """A method of an object, with the processor time of its calls so far [s]."""

    def __init__(self, place: Any, name: str) -> None:
        self.total, self._method = 0.0, getattr(place, name)
        setattr(place, name, self)

    def __call__(self, *arguments: Any) -> Any:
        begin = time.process_time()
        result = self._method(*arguments)
        self.total += time.process_time() - begin
        return result


def main() -> None:
    """Print the measurements."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seeds", type=int, default=3, help="training seeds 0 to N-1 (%(default)s)")
    parser.add_argument("--updates", type=int, default=200, help="the most updates of a run (%(default)s)")
    options = parser.parse_args()
    torch.set_num_threads(1)
    for name, make in ways(shipped_hyperparameters("ppo")["lanes"]).items():
        runs = [measure_training(make(), seed, options.updates) for seed in range(options.seeds)]
        columns = dict.fromkeys(column for run in runs for column in run)
        medians = {column: median(run.get(column, math.inf) for run in runs) for column in columns}
        texts = [f"{column} {value:,.{0 if value >= 100 else 1}f}" for column, value in medians.items()]
        print(name, *texts, sep=" | ", flush=True)


if __name__ == "__main__":
    main()
