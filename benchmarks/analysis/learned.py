"""The error of agents over all training seeds, and its parts: training, world, and the rest."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from benchmarks.analysis.statistics import Components, Estimate, components, resample, trained
from benchmarks.policies.spec import resolve
from benchmarks.rl.policy import shipped
from benchmarks.run.runner import run
from benchmarks.run.store import Store
from benchmarks.run.suite import Cell
from fbl_gym import Scenario


@dataclass(frozen=True)
class Learned:
    """A shipped agent over all its training seeds on one scenario.

    Attributes:
        policy: Name of the agent.
        scenario: Name of the scenario.
        training_seeds: Number of training seeds.
        error: Interquartile mean of the error in % over training and test seeds; its interval
            resamples both.
        parts: Variances of the logarithm of the error: training, world, and neither alone.
    """

    policy: str
    scenario: str
    training_seeds: int
    error: Estimate
    parts: Components


def measure_learned(
    scenarios: Sequence[Scenario], seeds: Sequence[int], store: Store, workers: int = 1, rng: int = 0
) -> list[Learned]:
    """Measure each shipped agent with two training seeds or more on each scenario.

    Each training seed is a cell, such as "ppo-memory@3". Cells of the store are not run again.

    Args:
        scenarios: Tasks.
        seeds: Test seeds, the same for every agent.
        store: Store of the cells.
        workers: Number of processes.
        rng: Seed of the bootstrap.

    Raises:
        ValueError: If a cell fails.
    """
    agents = {policy: training for policy, training in shipped().items() if len(training) > 1}
    cells = {
        (policy, scenario.name): [Cell(resolve(f"{policy}@{seed}"), scenario, tuple(seeds)) for seed in training]
        for policy, training in agents.items()
        for scenario in scenarios
    }
    every = [cell for group in cells.values() for cell in group]
    for outcome in run(every, store, workers=workers, command="fbl-gym report --learned"):
        if outcome.error:
            raise ValueError(f"{outcome.id} failed: {outcome.error}")
    counts = resample(len(seeds), rng)
    rows = []
    for (policy, scenario), group in cells.items():
        results = [result for cell in group if (result := store.find(cell)) is not None]
        errors = np.array([[row["error_pct"] for row in result.rows] for result in results])
        estimate = trained(errors[:, None], counts, rng)
        rows.append(Learned(policy, scenario, len(group), estimate, components(np.log(errors))))
    return rows
