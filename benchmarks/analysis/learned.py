"""The error of agents over all training seeds, and its parts: training, world, and the rest."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from benchmarks.analysis.statistics import Components, Estimate, components, resample, trained
from benchmarks.policies.spec import resolve
from benchmarks.rl.policy import shipped
from benchmarks.run.runner import run
from benchmarks.run.store import Result, Store
from benchmarks.run.suite import Cell
from fbl_gym import Scenario
from fbl_gym.arm import Array


@dataclass(frozen=True)
class Learned:
    """A shipped agent over all its training seeds on one scenario.

    Attributes:
        error: geometric mean of the error in %, with an interval over training and test seeds.
        parts: variances of the logarithm of the error: training, world, and neither alone.
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

    Each training seed is a cell, such as "ppo-memory@3". `rng` is the seed of the bootstrap.
    """
    agents = {policy: training for policy, training in shipped().items() if len(training) > 1}
    cells = {
        (policy, scenario.name): [Cell(resolve(f"{policy}@{seed}"), scenario, tuple(seeds)) for seed in training]
        for policy, training in agents.items()
        for scenario in scenarios
    }
    counts = resample(len(seeds), rng)
    rows = []
    for (policy, scenario), results in results_of(cells, store, workers, "fbl-gym report --learned").items():
        errors = training_errors(results)
        estimate = trained(errors[:, None], counts, rng)
        rows.append(Learned(policy, scenario, len(results), estimate, components(np.log(errors))))
    return rows


def results_of(
    groups: Mapping[tuple[str, str], Sequence[Cell]], store: Store, workers: int, command: str
) -> dict[tuple[str, str], list[Result]]:
    """Return the results of each group of cells; those that the store lacks are computed."""
    for outcome in run([cell for cells in groups.values() for cell in cells], store, workers=workers, command=command):
        if outcome.error:
            raise ValueError(f"{outcome.id} failed: {outcome.error}")
    return {key: [result for cell in cells if (result := store.find(cell))] for key, cells in groups.items()}


def training_runs(results: Sequence[Result], metric: str) -> Array:
    """Return a metric of an agent's results [training seeds x seeds]."""
    return np.array([[row[metric] for row in result.rows] for result in results])


def training_errors(results: Sequence[Result]) -> Array:
    """Return the errors of an agent's results in % [training seeds x seeds]."""
    return np.maximum(training_runs(results, "error_pct"), training_runs(results, "resolution_pct"))
