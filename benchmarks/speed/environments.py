"""Steps per second of this and other environments, on one thread if not stated otherwise.

One step of the arm takes ten Runge-Kutta steps of 1 ms: forty evaluations of its dynamics.
"""

import itertools
import time
from collections.abc import Callable, Iterator, Mapping
from typing import Any, TypeAlias

import gymnasium as gym
import numpy as np

from fbl_gym import TwoLinkArmVectorEnv
from fbl_gym.kernel.cuda import TorchGpu, open_gpu
from fbl_gym.kernel.step.pool import cores
from fbl_gym.model.arm import Array

Contestant: TypeAlias = Callable[[], int]
"""A function that takes one step, and returns the number of environments that it stepped."""

ROUND_S = 0.1
"""Duration of a contestant's turn in each round [s]."""

BUSY: dict[str, Any] = {
    "friction": {"coulomb": 10.0, "stiction": 10.0},
    "noise": {"position": 1e-3, "velocity": 1e-2, "acceleration": 1e-1},
    "disturbance": {"kind": "piecewise-constant", "amplitude": 10.0},
}

_ARM = "fbl_gym:fbl_gym/TwoLinkArm-v0"
_ACROBOT, _ACROBOTS = "Acrobot-v1", "SyncVectorEnv(Acrobot-v1), 256"


def _contestants() -> dict[str, tuple[Contestant, str]]:
    """Return each contestant and the name of its peer, by name."""
    contestants: dict[str, tuple[Contestant, str]] = {
        _ACROBOT: (contestant(gym.make(_ACROBOT), 1), ""),
        "TwoLinkArm-v0": (contestant(gym.make(_ARM), np.zeros(2)), _ACROBOT),
        "TwoLinkArm-v0, busy": (contestant(gym.make(_ARM, **BUSY), np.zeros(2)), _ACROBOT),
        "TwoLinkArmTracking-v0": (contestant(gym.make(_ARM.replace("Arm-", "ArmTracking-")), np.zeros(2)), _ACROBOT),
        "TwoLinkArm-v0, unwrapped": (contestant(gym.make(_ARM).unwrapped, np.zeros(2)), _ACROBOT),
        _ACROBOTS: (contestant(gym.make_vec(_ACROBOT, 256, "sync"), np.ones(256, dtype=int)), ""),
    }
    kinds: dict[str, Any] = {"": {}, ", busy": BUSY, ", servo-elastic-2": {"scenario": "servo-elastic-2"}}
    for lanes, threads in ((16, 1), (256, 1), (4096, 1), (4096, cores())):
        for kind, options in kinds.items():
            env = gym.make_vec(_ARM, lanes, vectorization_mode="vector_entry_point", threads=threads, **options)
            name = f"TwoLinkArm-v0 batch, {lanes}{kind}{f', {threads} threads' if threads > 1 else ''}"
            contestants[name] = (contestant(env, np.zeros((lanes, 2))), _ACROBOTS)
    return contestants


def contestant(env: Any, action: Any) -> Contestant:
    """Return a contestant: an environment, or a batch, with the same action at every step.

    A single environment is reset at an episode's end.
    """
    env.reset(seed=0)
    lanes = getattr(env, "num_envs", 1)

    def step() -> int:
        _, _, terminated, truncated, _ = env.step(action)
        if lanes == 1 and (terminated or truncated):
            env.reset()
        return lanes

    return step


def measure_rates(contestants: Mapping[Any, Contestant], rounds: int) -> dict[Any, Array]:
    """Return the steps per second of each contestant in each round, after one step to warm up."""
    for step in contestants.values():
        step()
    rates: dict[Any, list[float]] = {name: [] for name in contestants}
    for _ in range(rounds):
        for name, step in contestants.items():
            count, begin = 0, time.perf_counter()
            while (elapsed := time.perf_counter() - begin) < ROUND_S:
                for _ in range(10 if elapsed < 0.5 * ROUND_S else 1):
                    count += step()
            rates[name].append(count / elapsed)
    return {name: np.array(values) for name, values in rates.items()}


def measure_environments(rounds: int = 7) -> list[dict[str, Any]]:
    """Return the speed of every contestant in environment steps per second.

    Each row has the contestant's name, the median of the rounds, the name of its peer, if there is
    one, and the median ratio to it.
    """
    contestants = _contestants()
    rates = measure_rates({name: step for name, (step, _) in contestants.items()}, rounds)
    rows = []
    for name, (_, peer) in contestants.items():
        median, ratio = np.median(rates[name]), np.median(rates[name] / rates[peer or name])
        rows.append({"name": name, "median": float(median), "ratio": float(ratio), "peer": peer})
    return rows


def measure_gpu(rounds: int = 7) -> Iterator[tuple[str, int, float]]:
    """Yield a name, its number of lanes, and the most steps per second of batches on a GPU.

    A CUDA graph of torch draws the actions and makes the steps.

    Raises:
        ImportError: without the extra `cuda`, or a torch with CUDA.
        RuntimeError: without a GPU.
    """
    if not isinstance(open_gpu(), TorchGpu):
        raise ImportError("--device cuda needs a torch with CUDA: pip install torch")
    import torch

    names = {name: {"scenario": name} for name in ("servo-everything-2", "servo-elastic-2")}
    kinds: dict[str, Any] = {"plain": {}, "busy": BUSY, **names, "links that bend": {"link": 8.0}}
    for name, lanes in itertools.product(kinds, (4_096, 65_536, 1_048_576)):
        env = TwoLinkArmVectorEnv(lanes, device="cuda", **kinds[name])
        env.reset(seed=0)
        actions = torch.empty(lanes, 2, dtype=torch.float64, device="cuda")
        env.step(actions.uniform_(-1, 1))
        graph = torch.cuda.CUDAGraph()
        with torch.cuda.graph(graph):
            env.step(actions.uniform_(-1, 1))

        def step(graph: Any = graph, lanes: int = lanes) -> int:
            for _ in range(20):
                graph.replay()
            torch.cuda.synchronize()
            return 20 * lanes

        yield name, lanes, float(measure_rates({name: step}, rounds)[name].max())
        env.check()


def compare(rows: list[dict[str, Any]], baseline: list[dict[str, Any]]) -> dict[str, float]:
    """Return each contestant's ratio to its peer, divided by the same ratio in earlier rows.

    Contestants that the baseline lacks, or compares with another peer, are left out.
    """
    before = {(row["name"], row["peer"]): row["ratio"] for row in baseline if row["peer"]}
    return {row["name"]: row["ratio"] / before[key] for row in rows if (key := (row["name"], row["peer"])) in before}
