"""How far a policy carries beyond what agents are trained on: its error over the radius of the parameters' error.

Every radius is a cell of the store, run with the board's seeds, and of a shipped agent one for each of its training seeds.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from benchmarks.analysis.board import CHANCE, Board
from benchmarks.analysis.statistics import Estimate, estimate, trained
from benchmarks.rl.policy import shipped
from benchmarks.rl.training_settings import at_radius
from benchmarks.run.runner import run
from benchmarks.run.store import Store
from benchmarks.run.suite import Cell
from fbl_gym import scenarios
from fbl_gym.arm import Array

TRAINED_ON = "everything-2"
"""The scenario that the shipped agents are trained on."""

RADII = {"interpolation": 0.25, "in distribution": 0.5, "extrapolation": 1.0, "far extrapolation": 2.0}
"""The radius of the parameters' error in each split; TRAINED_ON has that of the second."""

MEANING = {
    split: f"{TRAINED_ON} with parameters off by factors of up to {1 + radius:g}" for split, radius in RADII.items()
}


@dataclass(frozen=True)
class Split:
    """How the policies of a board do in one split.

    Args:
        error: interquartile mean of each policy's errors [p] in %; its interval is over the board's seeds, and over the
            training seeds too where an agent has several.
        diverged: share of each policy's runs that diverged [p], which the middle half does not show while they are few.
    """

    error: Estimate
    diverged: Array


def split_cells(policy: str, split: str, seeds: Sequence[int]) -> list[Cell]:
    """The cells behind one number: of an agent with several training seeds, one for each, as "ppo-memory@3"."""
    scenario = at_radius(scenarios.get(TRAINED_ON), RADII[split])
    training = shipped().get(policy, ())
    members = [f"{policy}@{seed}" for seed in training] if len(training) > 1 else [policy]
    return [Cell(member, scenario, tuple(seeds)) for member in members]


def measure_splits(board: Board, store: Store, workers: int, trusted: Sequence[str] = ()) -> dict[str, Split]:
    """Each split of the radius. What the store has is not run again.

    Args:
        board: for its policies and seeds.
        store: for the cells.
        workers: processes.
        trusted: archives that may be loaded; see `resolve.trust`.
    """
    cells = {(policy, split): split_cells(policy, split, board.seeds) for policy in board.policies for split in RADII}
    every = [cell for some in cells.values() for cell in some]
    for outcome in run(every, store, workers=workers, command="fbl-gym report --splits", trusted=trusted):
        if outcome.error:
            raise ValueError(f"{outcome.id} failed: {outcome.error}")

    def runs(policy: str, split: str, metric: str) -> Array:
        """[training seeds x seeds]."""
        results = [result for cell in cells[policy, split] if (result := store.find(cell)) is not None]
        return np.array([[row[metric] for row in result.rows] for result in results])

    found = {}
    for split in RADII:
        rows = [_estimate(runs(policy, split, "error_pct"), board) for policy in board.policies]
        value, low, high = (np.array(x) for x in zip(*((e.value, e.low, e.high) for e in rows), strict=True))
        diverged = np.array([runs(policy, split, "diverged").mean() for policy in board.policies])
        found[split] = Split(Estimate(value, low, high), diverged)
    return found


def _estimate(runs: Array, board: Board) -> Estimate:
    if len(runs) > 1:
        return trained(runs[:, None], board.counts, CHANCE)
    return estimate(runs, board.counts)
