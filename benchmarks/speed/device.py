"""Steps per second of batches on a GPU, in a CUDA graph of torch, with actions drawn there."""

import time
from collections.abc import Iterator
from typing import Any

from benchmarks.speed.environments import BUSY
from fbl_gym import TwoLinkArmVectorEnv
from fbl_gym.kernel.cuda import TorchGpu, open_gpu

_KINDS: dict[str, dict[str, Any]] = {
    "plain": {}, "busy": BUSY, "servo-everything-2": {"scenario": "servo-everything-2"},
    "servo-elastic-2": {"scenario": "servo-elastic-2"}, "links that bend": {"link": 8.0},
}  # fmt: skip
_LANES = 4_096, 65_536, 1_048_576
_STEPS = 100
"""Steps of a round."""


def measure_device(rounds: int) -> Iterator[tuple[str, int, float]]:
    """Yield the name of a kind, its lanes, and the most steps per second of the rounds.

    Raises:
        ImportError: without the extra `cuda`, or torch with CUDA.
        RuntimeError: without a GPU.
    """
    if not isinstance(open_gpu(), TorchGpu):
        raise ImportError("--device cuda needs a torch with CUDA: pip install torch")
    for name, options in _KINDS.items():
        for lanes in _LANES:
            yield name, lanes, _rate(TwoLinkArmVectorEnv(lanes, device="cuda", **options), rounds)


def _rate(env: TwoLinkArmVectorEnv, rounds: int) -> float:
    """Return the most environment steps per second of the rounds."""
    import torch

    env.reset(seed=0)
    actions = torch.empty(env.num_envs, 2, dtype=torch.float64, device="cuda")
    graph, side = torch.cuda.CUDAGraph(), torch.cuda.Stream()
    torch.cuda.synchronize()
    with torch.cuda.stream(side):
        env.step(actions.uniform_(-1, 1))
    torch.cuda.synchronize()
    with torch.cuda.graph(graph):
        env.step(actions.uniform_(-1, 1))
    rates = []
    for _ in range(rounds):
        begin = time.perf_counter()
        for _ in range(_STEPS):
            graph.replay()
        torch.cuda.synchronize()
        rates.append(_STEPS * env.num_envs / (time.perf_counter() - begin))
    env.check()
    return max(rates)
