"""How far an agent carries beyond its training: the error on held-out seeds, over the radius of the parameters' error.

`python -m benchmarks.rl.splits NAME ...` prints the table; without names, that of every shipped agent.
"""

from __future__ import annotations

import sys
from collections.abc import Sequence
from typing import Any

import controllers
from benchmarks.rl.policy import shipped, shipped_agent
from benchmarks.rl.settings import at_radius
from benchmarks.rl.train import tracking_error
from benchmarks.statistics import Estimate, estimate, mean, resample
from benchmarks.suite import SPLITS
from fbl_gym import scenarios
from fbl_gym.vector_env import TwoLinkArmVectorEnv

RADII = {"interpolation": 0.25, "in distribution": 0.5, "extrapolation": 1.0, "far extrapolation": 2.0}
"""The radius of each split, for agents trained on everything-2, whose radius is 0.5."""


def measure_splits(name: str, seeds: Sequence[int] = SPLITS["test"][:32]) -> dict[str, Estimate]:
    """The RMS error [mrad] of a policy in each split, with a 95 % interval.

    The interval of an agent that was trained with several seeds says how much that matters; of any other policy, it is over the
    episodes.

    Args:
        name: of a shipped agent, or of a controller.
        seeds: of the episodes.
    """
    found = {}
    for split, radius in RADII.items():
        env = TwoLinkArmVectorEnv(len(seeds), at_radius(scenarios.get("everything-2"), radius))
        policies: list[Any] = [shipped_agent(name, env, k) for k in shipped().get(name, ())]
        policies = policies or [controllers.make(name, env)]
        errors = [tracking_error(policy, env, seeds) for policy in policies]
        runs = [error.mean() for error in errors] if len(errors) > 1 else errors[0]
        found[split] = estimate([runs], resample(len(runs), 0), mean)
    return found


if __name__ == "__main__":
    print(f"{'':<18}" + "".join(f"{f'{split} ({radius:g})':>28}" for split, radius in RADII.items()))
    for agent in sys.argv[1:] or shipped():
        cells = (f"{e.value:.2f} [{e.low:.2f}, {e.high:.2f}]" for e in measure_splits(agent).values())
        print(f"{agent:<18}" + "".join(f"{cell:>28}" for cell in cells), flush=True)
