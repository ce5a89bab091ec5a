"""How fast the environment and the controllers are, beside their peers: all in one interleaved run, on one thread unless said.

Machines drift, so what counts is the ratio of medians over rounds in which every contestant had its turn. One step of the
arm is ten Runge-Kutta steps of 1 ms, forty evaluations of its dynamics.
"""

from __future__ import annotations

import os
import time
from collections.abc import Callable, Mapping
from dataclasses import asdict, dataclass
from importlib.util import find_spec
from typing import Any

import gymnasium as gym
import numpy as np

import controllers
from benchmarks.run.metrics import measure
from benchmarks.run.rollout import rollout
from benchmarks.speed import peers
from fbl_gym import TABLE_1, TwoLinkArmVectorEnv, scenarios

ROUND_S = 0.1
"""How long a contestant runs in each round [s]."""

SETTLED = 60
"""Steps after which an adaptive law has data to fit."""


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


_BUSY: dict[str, Any] = {
    "friction": {"coulomb": 10.0, "stiction": 10.0},
    "noise": {"position": 1e-3, "velocity": 1e-2, "acceleration": 1e-1},
    "disturbance": {"kind": "piecewise-constant", "amplitude": 10.0},
}
_OURS = "fbl_gym:fbl_gym/TwoLinkArm-v0"
_ACROBOT, _ACROBOTS = "Acrobot-v1", "SyncVectorEnv(Acrobot-v1), 256"


def _contestants() -> dict[str, tuple[Callable[[], int], str]]:
    """A name, its step, and the name of the peer that it is compared with."""
    found: dict[str, tuple[Callable[[], int], str]] = {
        _ACROBOT: (_single(gym.make(_ACROBOT), 1), ""),
        "Pendulum-v1": (_single(gym.make("Pendulum-v1"), np.zeros(1)), _ACROBOT),
        "TwoLinkArm-v0": (_single(gym.make(_OURS), np.zeros(2)), _ACROBOT),
        "TwoLinkArm-v0, busy": (_single(gym.make(_OURS, **_BUSY), np.zeros(2)), _ACROBOT),
        "TwoLinkArm-v0, unwrapped": (_single(gym.make(_OURS).unwrapped, np.zeros(2)), _ACROBOT),
        _ACROBOTS: (
            _batch(gym.make_vec(_ACROBOT, num_envs=256, vectorization_mode="sync"), np.ones(256, dtype=int)),
            "",
        ),
    }
    if find_spec("mujoco"):
        found["Reacher-v5"] = (_single(gym.make("Reacher-v5"), np.zeros(2)), _ACROBOT)
        found["MuJoCo, the same arm, RK4"] = (peers.mujoco_arm(TABLE_1), _ACROBOT)
        found["MuJoCo rollout of 256 such arms"] = (peers.mujoco_arms(TABLE_1, 256), _ACROBOTS)
    asynchronous = gym.make_vec(_ACROBOT, num_envs=4, vectorization_mode="async")
    found["AsyncVectorEnv(Acrobot-v1), 4 processes"] = (_batch(asynchronous, np.ones(4, dtype=int)), _ACROBOTS)
    if find_spec("gymnax"):
        found["gymnax's Acrobot-v1, 256, XLA's threads"] = (peers.gymnax_acrobots(256), _ACROBOTS)
    for lanes in (16, 256, 4096):
        for name, options in (("", {}), (", busy", _BUSY)):
            env = gym.make_vec(_OURS, num_envs=lanes, vectorization_mode="vector_entry_point", **options)
            found[f"TwoLinkArm-v0 batch, {lanes}{name}"] = (_batch(env, np.zeros((lanes, 2))), _ACROBOTS)
    threads = os.cpu_count() or 1
    if threads > 1:
        env = TwoLinkArmVectorEnv(16384, threads=threads)
        found[f"TwoLinkArm-v0 batch, 16384, {threads} threads"] = (_batch(env, np.zeros((16384, 2))), _ACROBOTS)
    return found


def _rates(contestants: Mapping[str, Callable[[], int]], rounds: int) -> dict[str, list[float]]:
    """Steps per second of each in each round, one after the other within a round."""
    for step in contestants.values():
        step()
    rates: dict[str, list[float]] = {name: [] for name in contestants}
    for _ in range(rounds):
        for name, step in contestants.items():
            count, begin = 0, time.perf_counter()
            while (elapsed := time.perf_counter() - begin) < ROUND_S:
                for _ in range(10 if elapsed < 0.5 * ROUND_S else 1):
                    count += step()
            rates[name].append(count / elapsed)
    return rates


def measure_speed(rounds: int = 7) -> list[Speed]:
    """Steps per second of every contestant. "busy" has stick-slip friction, noise on every sensor and a disturbance."""
    contestants = _contestants()
    rates = _rates({name: step for name, (step, _) in contestants.items()}, rounds)
    medians = {name: float(np.median(values)) for name, values in rates.items()}
    return [
        Speed(name, medians[name], min(rates[name]), max(rates[name]), medians[name] / medians[peer or name], peer)
        for name, (_, peer) in contestants.items()
    ]


LANES = (1, 4, 16, 64, 256, 1024, 4096, 16384, 65536)
SUBSTEPS = (1, 2, 5, 10, 20, 50)


def measure_growth(rounds: int = 3) -> tuple[dict[int, float], dict[int, float]]:
    """Time of a step of one lane [ns]: by the size of the batch, and by the physics steps in it for 256 lanes."""

    def of(scenario: dict[str, Any], lanes: int) -> Callable[[], int]:
        return _batch(TwoLinkArmVectorEnv(lanes, **scenario), np.zeros((lanes, 2)))

    by_lanes = _rates({str(n): of({}, n) for n in LANES}, rounds)
    by_substeps = _rates({str(k): of({"control_dt": 1e-3 * k}, 256) for k in SUBSTEPS}, rounds)
    times = [{int(n): 1e9 / float(np.median(r)) for n, r in rates.items()} for rates in (by_lanes, by_substeps)]
    return times[0], times[1]


def measure_policies(rounds: int = 3, lanes: int = 4096) -> dict[str, float]:
    """How many of the environment's own steps a batched decision of each policy takes, once its loop has run for a while."""
    env = TwoLinkArmVectorEnv(lanes, scenarios.get("everything-2"))
    contestants = {
        name: _decision(controllers.make(name, env), env)
        for name in controllers.names()
        if controllers.access(name) != "privileged" and name != "nmpc"
    }
    contestants["the step itself"] = _batch(env, np.zeros((lanes, 2)))
    rates = {name: float(np.median(r)) for name, r in _rates(contestants, rounds).items()}
    return {name: rates["the step itself"] / rate for name, rate in rates.items() if name != "the step itself"}


def _decision(policy: Any, env: TwoLinkArmVectorEnv) -> Callable[[], int]:
    observation, _ = env.reset(seed=0)
    actions, state = policy.predict(observation)
    for _ in range(SETTLED):
        observation = env.step(actions)[0]
        actions, state = policy.predict(observation, state)

    def decide() -> int:
        policy.predict(observation, state)
        return len(observation)

    return decide


def measure_loop(policy: str = "robust-flm", episodes: int = 4096) -> float:
    """Steps per second of episodes in closed loop, with all that an evaluation costs: decisions, steps, trace and metrics."""
    scenario = scenarios.get("everything-2")
    measure(rollout(policy, scenario, range(8)))
    begin = time.perf_counter()
    measure(rollout(policy, scenario, range(episodes)))
    return episodes * scenario.steps / (time.perf_counter() - begin)


def as_plain(rows: list[Speed]) -> list[dict[str, Any]]:
    """The rows as plain data."""
    return [asdict(row) for row in rows]


def against(rows: list[Speed], baseline: list[dict[str, Any]]) -> dict[str, float]:
    """Each contestant's ratio to its peer, over what it was in a stored baseline."""
    before = {row["name"]: row["ratio"] for row in baseline if row["peer"]}
    return {row.name: row.ratio / before[row.name] for row in rows if row.peer and row.name in before}
