"""Steps per second of this and other environments, on one thread if not stated otherwise.

One step of the arm takes ten Runge-Kutta steps of 1 ms: forty evaluations of its dynamics. Batches
of 4,096 arms are compared with the same arms in C (`reference.c`), which is physics alone.
"""

import os
from dataclasses import dataclass
from importlib.util import find_spec
from typing import Any

import gymnasium as gym
import numpy as np

from benchmarks.speed import c_reference, peers
from benchmarks.speed.timing import Contestant, batch, measure_rates, single
from fbl_gym import TABLE_1, TwoLinkArmVectorEnv


@dataclass(frozen=True)
class Speed:
    """Environment steps per second of one contestant.

    Args:
        name: of the contestant.
        median: over the rounds.
        low: smallest of the rounds.
        high: largest of the rounds.
        ratio: to the peer's, the median over the rounds.
        peer: name of the contestant to compare with; empty: none.
    """

    name: str
    median: float
    low: float
    high: float
    ratio: float
    peer: str


_BUSY: dict[str, Any] = {
    "friction": {"coulomb": 10.0, "stiction": 10.0},
    "noise": {"position": 1e-3, "velocity": 1e-2, "acceleration": 1e-1},
    "disturbance": {"kind": "piecewise-constant", "amplitude": 10.0},
}
"""Options of the contestants named "busy"."""

_HARDWARE = {"scenario": "hardware-elastic-2"}
"""Options of an arm with elastic joints, delay, lag, encoders and friction."""

_ARM = "fbl_gym:fbl_gym/TwoLinkArm-v0"
_C, _C_ELASTIC = "C, physics alone, 4096", "C, physics of elastic joints alone, 4096"
_ACROBOT, _ACROBOTS = "Acrobot-v1", "SyncVectorEnv(Acrobot-v1), 256"


def _contestants() -> dict[str, tuple[Contestant, str]]:
    """Return each contestant and the name of its peer, by name."""
    acrobots = gym.make_vec(_ACROBOT, num_envs=256, vectorization_mode="sync")
    contestants: dict[str, tuple[Contestant, str]] = {
        _ACROBOT: (single(gym.make(_ACROBOT), 1), ""),
        "Pendulum-v1": (single(gym.make("Pendulum-v1"), np.zeros(1)), _ACROBOT),
        "TwoLinkArm-v0": (single(gym.make(_ARM), np.zeros(2)), _ACROBOT),
        "TwoLinkArm-v0, busy": (single(gym.make(_ARM, **_BUSY), np.zeros(2)), _ACROBOT),
        "TwoLinkArm-v0, unwrapped": (single(gym.make(_ARM).unwrapped, np.zeros(2)), _ACROBOT),
        _ACROBOTS: (batch(acrobots, np.ones(256, dtype=int)), ""),
    }
    if find_spec("mujoco"):
        contestants["Reacher-v5"] = (single(gym.make("Reacher-v5"), np.zeros(2)), _ACROBOT)
        contestants["MuJoCo, the same arm, RK4"] = (peers.mujoco_arm(TABLE_1), _ACROBOT)
        contestants["MuJoCo rollout of 256 such arms"] = (peers.mujoco_arms(TABLE_1, 256), _ACROBOTS)
    asynchronous = gym.make_vec(_ACROBOT, num_envs=4, vectorization_mode="async")
    contestants["AsyncVectorEnv(Acrobot-v1), 4 processes"] = (batch(asynchronous, np.ones(4, dtype=int)), _ACROBOTS)
    for name, elastic in ((_C, False), (_C_ELASTIC, True)):
        reference = c_reference.stepper(TABLE_1, 4096, elastic=elastic)
        if reference is not None:
            contestants[name] = (reference, "")
    for lanes in (16, 256, 4096):
        for suffix, options, peer in (("", {}, _C), (", busy", _BUSY, _C), (", hardware", _HARDWARE, _C_ELASTIC)):
            env = gym.make_vec(_ARM, num_envs=lanes, vectorization_mode="vector_entry_point", **options)
            peer = peer if lanes == 4096 and peer in contestants else _ACROBOTS
            contestants[f"TwoLinkArm-v0 batch, {lanes}{suffix}"] = (batch(env, np.zeros((lanes, 2))), peer)
    threads = os.cpu_count() or 1
    if threads > 1:
        env = TwoLinkArmVectorEnv(16384, threads=threads)
        contestants[f"TwoLinkArm-v0 batch, 16384, {threads} threads"] = (batch(env, np.zeros((16384, 2))), _ACROBOTS)
    return contestants


def measure_environments(rounds: int = 7) -> list[Speed]:
    """Return the speed of every contestant.

    "busy" has stick-slip friction, noise on every sensor and a disturbance.
    """
    contestants = _contestants()
    rates = measure_rates({name: step for name, (step, _) in contestants.items()}, rounds)
    rows = []
    for name, (_, peer) in contestants.items():
        rate, ratio = rates[name], float(np.median(rates[name] / rates[peer or name]))
        rows.append(Speed(name, float(np.median(rate)), float(rate.min()), float(rate.max()), ratio, peer))
    return rows


def compare(rows: list[Speed], baseline: list[dict[str, Any]]) -> dict[str, float]:
    """Return each contestant's ratio to its peer, divided by the same ratio in earlier rows.

    Contestants that the baseline lacks, or compares with another peer, are left out.
    """
    before = {(row["name"], row["peer"]): row["ratio"] for row in baseline if row["peer"]}
    return {row.name: row.ratio / before[row.name, row.peer] for row in rows if (row.name, row.peer) in before}
