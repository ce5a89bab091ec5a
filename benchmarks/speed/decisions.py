"""Time of one decision of one arm: a step of `controllers.Runner`, from reading to torque."""

import time
from collections.abc import Iterable, Iterator
from itertools import islice
from typing import Any

import numpy as np

from controllers import Runner
from fbl_gym import TwoLinkArmEnv, scenarios

SCENARIO = "servo-delay-2"

WARM_UP = 50
"""First decisions, which do not count."""

TURN = 100
"""Decisions of a policy before those of the next one."""


def decisions(policy: str) -> Iterator[float]:
    """Yield the time of each decision [s], without end; the robot is an arm of `SCENARIO`."""
    scenario = scenarios.get(SCENARIO)
    runner = Runner(policy, scenario, max_error=1e3)
    env = TwoLinkArmEnv(scenario, action="torque", preview=runner.rows - 1)
    slots = [slot for slot in env.layout.slots if slot.name.startswith(("reference", "preview"))]
    ahead = [i for slot in slots for i in range(slot.start, slot.start + slot.size)]
    for seed in range(2**63):
        observation, _ = env.reset(seed=seed)
        runner.reset()
        ended, k = False, 0
        while not (ended or runner.stopped):
            reading, reference = observation[env.layout["position"]], observation[ahead]
            begin = time.perf_counter()
            torque = runner.step(reading, reference, time=k * scenario.control_dt)
            yield time.perf_counter() - begin
            observation, _, terminated, truncated, _ = env.step(torque)
            ended, k = terminated or truncated, k + 1


def measure_decisions(policies: Iterable[str], turns: int = 20) -> list[dict[str, Any]]:
    """Return name, median and 99 % quantile [microseconds] of each policy's decisions, in turns."""
    loops = {policy: decisions(policy) for policy in policies}
    waits: dict[str, list[float]] = {policy: [] for policy in loops}
    for loop in loops.values():
        next(islice(loop, WARM_UP, None))
    for _ in range(turns):
        for policy, loop in loops.items():
            waits[policy].extend(islice(loop, TURN))
    quantiles = {policy: 1e6 * np.quantile(times, (0.5, 0.99)) for policy, times in waits.items()}
    return [{"name": policy, "median_us": float(a), "p99_us": float(b)} for policy, (a, b) in quantiles.items()]
