"""Generalization ranges: errors within and beyond the radius that agents are trained on.

Every range is a cell of the store, run with the board's seeds; a shipped agent has one for each of
its training seeds.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from benchmarks.analysis.board import BOOTSTRAP_SEED, Board
from benchmarks.analysis.learned import results_of, training_errors, training_runs
from benchmarks.analysis.statistics import Estimate, estimate, trained
from benchmarks.policies.spec import PolicySpec, resolve
from benchmarks.rl.policy import shipped
from benchmarks.rl.training_settings import at_radius
from benchmarks.run.store import Store
from benchmarks.run.suite import Cell
from fbl_gym import scenarios
from fbl_gym.arm import Array

TRAINED_ON = "everything-2"
"""The scenario that the shipped agents are trained on."""

RADII = {"interpolation": 0.25, "in distribution": 0.5, "extrapolation": 1.0, "far extrapolation": 2.0}
"""The uncertainty radius of each range; TRAINED_ON has that of the second."""

MEANING = {name: f"{TRAINED_ON} with parameters off by factors of up to {1 + r:g}" for name, r in RADII.items()}
"""One line on each range."""


@dataclass(frozen=True)
class RangeErrors:
    """Errors of a board's policies in one generalization range.

    Args:
        error: geometric mean of each policy's errors [p] in %. Its interval is over the board's
            seeds, and over the training seeds too where an agent has several.
        diverged: share of each policy's runs that diverged [p]; the geometric mean does not
            show a few of them.
    """

    error: Estimate
    diverged: Array


def range_cells(policy: PolicySpec | str, name: str, seeds: Sequence[int]) -> list[Cell]:
    """Return the cells of a policy in a range of `RADII`, one for each training seed."""
    scenario = at_radius(scenarios.get(TRAINED_ON), RADII[name])
    spec = resolve(policy)
    training = shipped().get(spec.name, ())
    members = [resolve(f"{spec.name}@{seed}") for seed in training] if len(training) > 1 else [spec]
    return [Cell(member, scenario, tuple(seeds)) for member in members]


def measure_ranges(board: Board, store: Store, workers: int) -> dict[str, RangeErrors]:
    """Measure each generalization range on the board's seeds."""
    cells = {(spec.name, name): range_cells(spec, name, board.seeds) for spec in board.specs for name in RADII}
    results = results_of(cells, store, workers, "fbl-gym report --generalization")
    ranges = {}
    for name in RADII:
        rows = [_estimate(training_errors(results[policy, name]), board) for policy in board.policies]
        value, low, high = (np.array(x) for x in zip(*((e.value, e.low, e.high) for e in rows), strict=True))
        diverged = [training_runs(results[policy, name], "diverged").mean() for policy in board.policies]
        ranges[name] = RangeErrors(Estimate(value, low, high), np.array(diverged))
    return ranges


def _estimate(runs: Array, board: Board) -> Estimate:
    if len(runs) > 1:
        return trained(runs[:, None], board.counts, BOOTSTRAP_SEED)
    return estimate(runs, board.counts)
