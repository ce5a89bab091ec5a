"""Orders of policies in two worlds, and their agreement."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy import special

from benchmarks.analysis.statistics import TAIL
from benchmarks.run.metrics import counted_errors, penalize
from benchmarks.run.store import Result
from fbl_gym.model.arm import Array


@dataclass(frozen=True)
class Runs:
    """The runs of policies in one world, [policies x scenarios x runs].

    The errors are in %, at least the encoder's resolution; `diverged` is 1 where a run diverged.
    """

    error: Array
    diverged: Array

    @classmethod
    def of(cls, results: Sequence[Sequence[Result]]) -> "Runs":
        """Return the runs of results [policies x scenarios]."""
        diverged = [[[run["diverged"] for run in result.rows] for result in row] for row in results]
        return cls(np.array([[counted_errors(result.rows) for result in row] for row in results]), np.array(diverged))

    @property
    def logs(self) -> Array:
        """Logarithms of the errors."""
        return np.log(self.error)

    @property
    def levels(self) -> Array:
        """Logarithm of the penalized error, by which a board ranks, [policies x scenarios]."""
        return np.log(penalize(self.error, self.diverged)).mean(axis=-1)

    @property
    def intervals(self) -> tuple[Array, Array]:
        """Both ends of a 95 % interval of each policy's mean logarithm, [policies] each.

        Scenarios share their seeds, so each seed gives one mean over the scenarios.
        """
        means = self.logs.mean(axis=1)
        runs = means.shape[-1]
        half = special.stdtrit(runs - 1, 1 - TAIL) * means.std(axis=-1, ddof=1) / np.sqrt(runs)
        return means.mean(axis=-1) - half, means.mean(axis=-1) + half

    def __getitem__(self, part: Any) -> "Runs":
        """Return some of the policies, scenarios and runs."""
        return Runs(self.error[part], self.diverged[part])


@dataclass(frozen=True)
class Agreement:
    """Kendall's tau between two orders of policies.

    Attributes:
        tau: of all pairs; NaN: there are none.
        pairs: their number.
        clear_tau: of the pairs that both sides separate; NaN: there are none.
        clear_pairs: their number.
    """

    tau: float
    pairs: int
    clear_tau: float
    clear_pairs: int


def compare_orders(first: Runs, second: Runs) -> Agreement:
    """Return the agreement between two orders of policies, by their errors.

    Two sides separate a pair of policies if its intervals are disjoint on both. A policy whose runs
    all diverge on both sides has no place in an order.
    """
    ordered = ~((first.diverged == 1).all(axis=(1, 2)) & (second.diverged == 1).all(axis=(1, 2)))
    signs, clear = [], []
    for runs in (first[ordered], second[ordered]):
        (low, high), mean = runs.intervals, runs.logs.mean(axis=(1, 2))
        signs.append(np.sign(mean[:, None] - mean[None, :]))
        clear.append((low[:, None] > high[None, :]) | (high[:, None] < low[None, :]))
    pairs = np.triu_indices(int(ordered.sum()), 1)
    products, both = (signs[0] * signs[1])[pairs], (clear[0] & clear[1])[pairs]
    tau, clear_tau = (float(x.mean()) if x.size else float("nan") for x in (products, products[both]))
    return Agreement(tau, len(products), clear_tau, int(both.sum()))


def compare_halves(runs: Runs) -> Agreement:
    """Return the agreement between the orders of two halves of the seeds, the most for worlds."""
    return compare_orders(runs[..., 0::2], runs[..., 1::2])
