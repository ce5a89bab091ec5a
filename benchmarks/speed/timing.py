"""Steps per second of several contestants, measured in turns."""

import time
from collections.abc import Callable, Mapping
from typing import Any, TypeAlias

import gymnasium as gym
import numpy as np

from fbl_gym.arm import Array

Contestant: TypeAlias = Callable[[], int]
"""A function that takes one step, and returns the number of environments that it stepped."""

ROUND_S = 0.1
"""Duration of a contestant's turn in each round [s]."""


def single(env: gym.Env, action: object) -> Contestant:
    """Return a contestant: a single environment with one action, reset at an episode's end."""
    env.reset(seed=0)

    def step() -> int:
        _, _, terminated, truncated, _ = env.step(action)
        if terminated or truncated:
            env.reset()
        return 1

    return step


def batch(env: gym.vector.VectorEnv, actions: np.ndarray) -> Contestant:
    """Return a contestant: a batched environment with the same actions at every step."""
    env.reset(seed=0)

    def step() -> int:
        env.step(actions)
        return env.num_envs

    return step


def measure_rates(contestants: Mapping[Any, Contestant], rounds: int) -> dict[Any, Array]:
    """Return the steps per second of each contestant in each round, after one step to warm up."""
    for step in contestants.values():
        step()
    rates: dict[Any, list[float]] = {name: [] for name in contestants}
    for _ in range(rounds):
        for name, step in contestants.items():
            count, begin = 0, time.perf_counter()
            while (elapsed := time.perf_counter() - begin) < ROUND_S:
                for _ in range(10 if elapsed < 0.5 * ROUND_S else 1):
                    count += step()
            rates[name].append(count / elapsed)
    return {name: np.array(values) for name, values in rates.items()}


def median_rates(contestants: Mapping[Any, Contestant], rounds: int) -> dict[Any, float]:
    """Return the median steps per second of each contestant; see `measure_rates`."""
    return {name: float(np.median(rates)) for name, rates in measure_rates(contestants, rounds).items()}
