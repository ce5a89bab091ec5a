"""Time of a decision: by `controllers.Runner`, from reading to torque, and of a batch of arms."""

import time
from collections.abc import Iterable, Iterator
from itertools import islice

import numpy as np

from benchmarks.policies.spec import resolve
from controllers import Runner
from fbl_gym import TwoLinkArmEnv, scenarios
from fbl_gym.envs.vector_env import TwoLinkArmVectorEnv

SCENARIO, BATCH, ARMS = "servo-delay-2", "geared-delay-2", 32
"""Of the single arm, and of a batch at 1 kHz with its number of arms."""

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


def batch_decisions(policy: str) -> Iterator[float]:
    """Yield the time of each decision for `ARMS` arms of `BATCH` [s], without end.

    An agent that cannot drive these gets arms of `SCENARIO`.
    """
    env, state = TwoLinkArmVectorEnv(ARMS, BATCH), None
    try:
        law = resolve(policy).make(env)
    except ValueError:
        env = TwoLinkArmVectorEnv(ARMS, SCENARIO)
        law = resolve(policy).make(env)
    observation, _ = env.reset(seed=0)
    while True:
        begin = time.perf_counter()
        action, state = law.predict(observation, state)
        yield time.perf_counter() - begin
        observation = env.step(action)[0]


def measure_decisions(policies: Iterable[str], turns: int = 20) -> list[tuple[str, float, float]]:
    """Return each policy with its median times [microseconds]: of one arm, of a batch; in turns."""
    loops = {policy: (decisions(policy), batch_decisions(policy)) for policy in policies}
    waits: dict[str, tuple[list[float], list[float]]] = {policy: ([], []) for policy in loops}
    for turn in range(turns + 1):
        for policy, pair in loops.items():
            for loop, times in zip(pair, waits[policy], strict=True):
                times.extend(islice(loop, TURN) if turn else islice(loop, WARM_UP, WARM_UP))
    return [(name, *(1e6 * float(np.median(times)) for times in pair)) for name, pair in waits.items()]  # type: ignore[misc]
