"""Steps per second beside Gymnasium's Acrobot, which is the same kind of arm: all in one interleaved run, one thread.

Machines drift, so what counts is the ratio of medians over rounds in which every contestant had its turn.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import gymnasium as gym
import numpy as np

ROUND_S = 0.1
"""How long a contestant runs in each round [s]."""


@dataclass(frozen=True)
class Speed:
    """Environment steps per second of one contestant: median, and the extremes over the rounds."""

    name: str
    median: float
    low: float
    high: float
    ratio: float
    peer: str


def _single(env: gym.Env, action: object) -> Callable[[], int]:
    env.reset(seed=0)

    def step() -> int:
        _, _, terminated, truncated, _ = env.step(action)
        if terminated or truncated:
            env.reset()
        return 1

    return step


def _batch(env: gym.vector.VectorEnv, actions: np.ndarray) -> Callable[[], int]:
    env.reset(seed=0)

    def step() -> int:
        env.step(actions)
        return env.num_envs

    return step


def _contestants() -> dict[str, tuple[Callable[[], int], str]]:
    """A name, its step, and the name of the peer that it is compared with."""
    ours = "fbl_gym:fbl_gym/TwoLinkArm-v0"
    busy: dict[str, Any] = {
        "friction": {"coulomb": 10.0, "stiction": 10.0},
        "noise": {"position": 1e-3, "velocity": 1e-2, "acceleration": 1e-1},
        "disturbance": {"kind": "piecewise-constant", "amplitude": 10.0},
    }
    found: dict[str, tuple[Callable[[], int], str]] = {
        "Acrobot-v1": (_single(gym.make("Acrobot-v1"), 1), ""),
        "TwoLinkArm-v0": (_single(gym.make(ours), np.zeros(2)), "Acrobot-v1"),
        "TwoLinkArm-v0, busy": (_single(gym.make(ours, **busy), np.zeros(2)), "Acrobot-v1"),
        "SyncVectorEnv(Acrobot-v1), 256": (
            _batch(gym.make_vec("Acrobot-v1", num_envs=256, vectorization_mode="sync"), np.ones(256, dtype=int)),
            "",
        ),
    }
    for lanes in (16, 256, 4096):
        for name, options in (("", {}), (", busy", busy)):
            env = gym.make_vec(ours, num_envs=lanes, vectorization_mode="vector_entry_point", **options)
            step = _batch(env, np.zeros((lanes, 2)))
            found[f"TwoLinkArm-v0 batch, {lanes}{name}"] = (step, "SyncVectorEnv(Acrobot-v1), 256")
    return found


def measure_speed(rounds: int = 7) -> list[Speed]:
    """Steps per second of every contestant. "busy" has stick-slip friction, noise on every sensor and a disturbance."""
    contestants = _contestants()
    for step, _ in contestants.values():
        step()
    rates: dict[str, list[float]] = {name: [] for name in contestants}
    for _ in range(rounds):
        for name, (step, _) in contestants.items():
            count, begin = 0, time.perf_counter()
            while (elapsed := time.perf_counter() - begin) < ROUND_S:
                for _ in range(10):
                    count += step()
            rates[name].append(count / elapsed)
    medians = {name: float(np.median(values)) for name, values in rates.items()}
    return [
        Speed(name, medians[name], min(rates[name]), max(rates[name]), medians[name] / medians[peer or name], peer)
        for name, (_, peer) in contestants.items()
    ]
