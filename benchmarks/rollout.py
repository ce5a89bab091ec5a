"""A policy in closed loop with a batch of arms, in lockstep; every lane is one seed."""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

import controllers
from fbl_gym.arm import Array
from fbl_gym.scenarios import Scenario
from fbl_gym.vector_env import TwoLinkArmVectorEnv


@dataclass(frozen=True)
class Trace:
    """What happened, sample by sample, of the true arm.

    T is the number of control steps and n that of seeds. Sample 0 is the start.

    Args:
        scenario: in which it happened.
        seeds: [n].
        time: [T + 1] s.
        position, velocity, reference: [T + 1 x n x 2] rad, rad/s, rad.
        torque: applied torque [T + 1 x n x 2] N m.
        disturbance: [T + 1 x n x 2] N m.
        alive: [T + 1 x n]; False from the sample on at which a lane diverged. After that, only the reference is of its episode.
        decision_time: wall time of the policy for one decision of one lane [s], the median over the steps.
    """

    scenario: Scenario
    seeds: tuple[int, ...]
    time: Array
    position: Array
    velocity: Array
    reference: Array
    torque: Array
    disturbance: Array
    alive: NDArray[np.bool_]
    decision_time: float


_SIGNALS = ("position", "velocity", "reference", "torque", "disturbance")


def action_of(scenario: Scenario) -> str:
    """The kind of action that a policy is evaluated with: torque, as a fraction of the limit where there is one."""
    return "torque" if scenario.actuator.torque_limit is None else "fraction"


def rollout(policy: str, scenario: Scenario, seeds: Sequence[int], gains: dict[str, Any] | None = None) -> Trace:
    """One episode for each seed.

    Args:
        policy: a name that `controllers.make` knows.
        scenario: the task.
        seeds: one lane each.
        gains: arguments of the policy.
    """
    n, steps = len(seeds), scenario.steps
    env = TwoLinkArmVectorEnv(n, scenario, action=action_of(scenario))
    actor = controllers.make(policy, env, **(gains or {}))
    signals = {name: np.empty((steps + 1, n, 2)) for name in _SIGNALS}
    alive = np.ones((steps + 1, n), dtype=bool)
    waits = np.empty(steps)
    state: Any = None
    starts, ended = np.ones(n, dtype=bool), np.zeros(n, dtype=bool)
    observation, _ = env.reset(seed=list(seeds))
    _record(signals, 0, env)
    for k in range(steps):
        begin = time.perf_counter()
        action, state = actor.predict(observation, state=state, episode_start=starts, deterministic=True)
        waits[k] = time.perf_counter() - begin
        # A lane that diverged begins its next episode one step later, which nobody looks at.
        observation, _, terminated, truncated, _ = env.step(action)
        starts, ended = ended, terminated | truncated
        alive[k + 1] = alive[k] & ~terminated
        _record(signals, k + 1, env)
    env.close()
    if not alive.all():
        signals["reference"] = _asked(scenario, seeds)
    return Trace(
        scenario=scenario,
        seeds=tuple(seeds),
        time=scenario.control_dt * np.arange(steps + 1.0),
        alive=alive,
        decision_time=float(np.median(waits)) / n,
        **signals,
    )


def _asked(scenario: Scenario, seeds: Sequence[int]) -> Array:
    """The reference of each seed over the whole episode, [T + 1 x n x 2], whatever the arm does."""
    calm = scenario.replace(parameter_error=None, friction=None, disturbance=None, actuator=None, initial_error=0.0)
    env = TwoLinkArmVectorEnv(len(seeds), calm, action="torque")
    env.reset(seed=list(seeds))
    rows = [env.truth.reference]
    for _ in range(scenario.steps):
        env.step(np.zeros((len(seeds), 2)))
        rows.append(env.truth.reference)
    return np.array(rows)


def _record(signals: dict[str, Array], k: int, env: TwoLinkArmVectorEnv) -> None:
    truth = env.truth
    signals["position"][k], signals["velocity"][k] = truth.position, truth.velocity
    signals["reference"][k], signals["torque"][k] = truth.reference, truth.applied_torque
    signals["disturbance"][k] = truth.disturbance
