"""The tracking error on the validation seeds, by which training chooses the best agent."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import Any

import numpy as np

from benchmarks.rl.adapter import AdapterSettings
from benchmarks.rl.agent import make_agent
from benchmarks.rl.network import Actor
from benchmarks.seeds import SPLITS
from controllers import Policy
from fbl_gym import Scenario
from fbl_gym.envs.vector_env import TwoLinkArmVectorEnv
from fbl_gym.model.arm import Array

VALIDATION = SPLITS["validation"][:16]


def validate(settings: AdapterSettings, actor: Actor, scenarios: Sequence[Scenario]) -> float:
    """Return the tracking error of an agent [mrad].

    It is the mean over the seeds; of several scenarios, where a quarter of the seeds is enough,
    the geometric mean over all runs, as on a board.

    Args:
        settings: of its adapter.
        actor: its network.
        scenarios: one or more.
    """
    seeds = VALIDATION if len(scenarios) == 1 else VALIDATION[::4]
    envs = [TwoLinkArmVectorEnv(len(seeds), each, preview=settings.previewed(each.control_dt)) for each in scenarios]
    errors = np.array([tracking_error(make_agent(env, settings, actor), env, seeds) for env in envs])
    return float(errors.mean() if len(scenarios) == 1 else np.exp(np.log(errors).mean()))


def tracking_error(policy: Policy, env: TwoLinkArmVectorEnv, seeds: Iterable[int]) -> Array:
    """Return the root mean square tracking error over one episode of each seed, [n] mrad.

    The environment has one lane per seed. From the step at which a run diverges, its error counts
    as pi.
    """
    observation, _ = env.reset(seed=list(seeds))
    state: Any = None
    squares, alive = np.zeros(env.num_envs), np.ones(env.num_envs, dtype=bool)
    for _ in range(env.scenario.steps):
        action, state = policy.predict(observation, state, deterministic=True)
        observation, _, terminated, _, _ = env.step(action)
        alive &= ~terminated
        truth = env.true_signals()
        error = np.minimum(np.abs(truth["reference"] - truth["position"]), np.pi)
        squares += np.where(alive, (error**2).mean(axis=-1), np.pi**2)
    return 1e3 * np.sqrt(squares / env.scenario.steps)
