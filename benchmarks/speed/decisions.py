"""Time of one decision of one arm: a step of `controllers.Runner`, from reading to torque."""

import time
from collections.abc import Iterable
from typing import Any

import numpy as np

from controllers import Runner
from fbl_gym import TwoLinkArmEnv, scenarios

SCENARIO = "hardware-delay-2"

WARM_UP = 50
"""First decisions, which do not count."""


def measure_decisions(policies: Iterable[str], decisions: int = 2000) -> list[dict[str, Any]]:
    """Return name, median and 99 % quantile [microseconds] of each policy's decisions.

    The robot is an arm of `SCENARIO`, and the loop does not wait.
    """
    scenario = scenarios.get(SCENARIO)
    rows = []
    for policy in policies:
        runner = Runner(policy, scenario, max_error=1e3)
        env = TwoLinkArmEnv(scenario, action="torque", preview=runner.rows - 1)
        position = env.layout["position"]
        slots = [slot for slot in env.layout.slots if slot.name.startswith(("reference", "preview"))]
        ahead = [i for slot in slots for i in range(slot.start, slot.start + slot.size)]
        waits, ended, observation = [], True, np.empty(0)
        for k in range(WARM_UP + decisions):
            if ended:
                observation, _ = env.reset(seed=k)
                runner.reset()
            reading, reference = observation[position], observation[ahead]
            begin = time.perf_counter()
            torque = runner.step(reading, reference, time=k * scenario.control_dt)
            waits.append(time.perf_counter() - begin)
            observation, _, terminated, truncated, _ = env.step(torque)
            ended = terminated or truncated or bool(runner.stopped)
        median, slow = 1e6 * np.quantile(waits[WARM_UP:], (0.5, 0.99))
        rows.append({"name": policy, "median_us": float(median), "p99_us": float(slow)})
    return rows
