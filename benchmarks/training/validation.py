"""The tracking error on the validation seeds, by which training chooses the best agent."""

from collections.abc import Iterable, Sequence
from typing import Any

import numpy as np

import controllers
from benchmarks.agents.adapter import AdapterSettings
from benchmarks.agents.agent import Agent
from benchmarks.agents.network import Actor
from benchmarks.seeds import SPLITS
from controllers import Policy
from fbl_gym import Scenario
from fbl_gym.envs.vector_env import TwoLinkArmVectorEnv
from fbl_gym.model.arm import Array

VALIDATION = SPLITS["validation"][:16]


def validate(settings: AdapterSettings, actor: Actor | str, scenarios: Sequence[Scenario]) -> float:
    """Return the tracking error of an agent, or of a law [mrad].

    It is the mean over the seeds of the root mean square error; of several scenarios, as on a
    board, the geometric mean over all runs of the mean absolute error. So neither the hardest
    scenario nor the start of a run, which no agent can change, hides the rest.

    Args:
        settings: of its adapter.
        actor: its network, or the name of a law alone.
        scenarios: one or more.
    """
    errors = []
    for each in scenarios:
        env = TwoLinkArmVectorEnv(len(VALIDATION), each, preview=settings.previewed(each.control_dt))
        robot = env.interface
        policy = controllers.make(actor, robot) if isinstance(actor, str) else Agent(robot, settings, actor)
        errors.append(tracking_error(policy, env, VALIDATION, 2 if len(scenarios) == 1 else 1))
    return float(np.mean(errors) if len(scenarios) == 1 else np.exp(np.log(errors).mean()))


def tracking_error(policy: Policy, env: TwoLinkArmVectorEnv, seeds: Iterable[int], power: int = 2) -> Array:
    """Return the tracking error over one episode of each seed, [n] mrad.

    It is the root mean square; with a power of 1, the mean of the absolute error. The environment
    has one lane per seed. From the step at which a run diverges, its error counts as pi.
    """
    observation, _ = env.reset(seed=list(seeds))
    state: Any = None
    sums, alive = np.zeros(env.num_envs), np.ones(env.num_envs, dtype=bool)
    for _ in range(env.scenario.steps):
        action, state = policy.predict(observation, state, deterministic=True)
        observation, _, terminated, _, _ = env.step(action)
        alive &= ~terminated
        truth = env.true_signals()
        error = np.minimum(np.abs(truth["reference"] - truth["position"]), np.pi)
        sums += np.where(alive, (error**power).mean(axis=-1), np.pi**power)
    return 1e3 * (sums / env.scenario.steps) ** (1.0 / power)
