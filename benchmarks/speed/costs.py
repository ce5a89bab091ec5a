"""Time of a step by batch size and physics steps, of policies' decisions, and of an evaluation."""

import time
from typing import Any

import numpy as np

import controllers
from benchmarks.run.metrics import measure
from benchmarks.run.rollout import rollout
from benchmarks.speed.timing import Contestant, batch, median_rates
from fbl_gym import TwoLinkArmVectorEnv, scenarios

LANES = (1, 4, 16, 64, 256, 1024, 4096, 16384, 65536)
PHYSICS_STEPS = (1, 2, 5, 10, 20, 50)

SETTLED = 60
"""Steps after which an adaptive law has data to fit."""


def measure_growth(rounds: int = 3) -> tuple[dict[int, float], dict[int, float]]:
    """Return the time of a lane's step [ns] by batch size, and by physics steps for 256 lanes."""

    def times(envs: dict[int, TwoLinkArmVectorEnv]) -> dict[int, float]:
        rates = median_rates({key: batch(env, np.zeros((env.num_envs, 2))) for key, env in envs.items()}, rounds)
        return {key: 1e9 / rate for key, rate in rates.items()}

    by_lanes = times({lanes: TwoLinkArmVectorEnv(lanes) for lanes in LANES})
    return by_lanes, times({steps: TwoLinkArmVectorEnv(256, control_dt=1e-3 * steps) for steps in PHYSICS_STEPS})


def measure_policies(rounds: int = 3, lanes: int = 4096) -> dict[str, float]:
    """Return the time of a batched decision of each policy, in environment steps."""
    env = TwoLinkArmVectorEnv(lanes, scenarios.get("everything-2"))
    contestants = {
        name: _decision(controllers.make(name, env), env)
        for name in controllers.names()
        if controllers.access(name) != "privileged" and name != "nmpc"
    }
    rates = median_rates({**contestants, "step": batch(env, np.zeros((lanes, 2)))}, rounds)
    return {name: rates["step"] / rates[name] for name in contestants}


def _decision(policy: Any, env: TwoLinkArmVectorEnv) -> Contestant:
    observation, _ = env.reset(seed=0)
    actions, state = policy.predict(observation)
    for _ in range(SETTLED):
        observation = env.step(actions)[0]
        actions, state = policy.predict(observation, state)

    def decide() -> int:
        policy.predict(observation, state)
        return len(observation)

    return decide


def measure_evaluation(policy: str = "robust-flm", episodes: int = 4096) -> float:
    """Return the steps per second of an evaluation: decisions, steps, trace and metrics."""
    scenario = scenarios.get("everything-2")
    measure(rollout(policy, scenario, range(8)))
    begin = time.perf_counter()
    measure(rollout(policy, scenario, range(episodes)))
    return episodes * scenario.steps / (time.perf_counter() - begin)
