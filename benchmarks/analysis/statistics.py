"""Statistics of the leaderboard: pure functions on arrays.

Runs lie in arrays [... x s x n] of s scenarios and n seeds; axes before these stay. A draw of the
bootstrap is a row of counts, one for each seed. `resample` makes all b - 1 draws at once, below a
first row for the data themselves. A statistic is computed for each row, and `interval` turns its
draws [b x ...] into an estimate. Statistics with the same counts are compared in pairs.

Scenarios share seeds: seed 7 has the same motion everywhere, so a policy's errors in two scenarios
are correlated. All scenarios therefore share the counts. Drawing the seeds of each scenario
separately (Agarwal et al., "Deep Reinforcement Learning at the Edge of the Statistical
Precipice", NeurIPS 2021) would give intervals that are too narrow here.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike
from scipy import special

from fbl_gym.model.arm import Array

LEVEL = 0.95

#: Share of the draws on each side of an interval.
TAIL = (1 - LEVEL) / 2

RESAMPLES = 2000


@dataclass(frozen=True)
class Estimate:
    """Values with their intervals, element by element.

    Args:
        value: of the data.
        low, high: ends of the interval, in the shape of `value`.
    """

    value: Array
    low: Array
    high: Array


def resample(n: int, seed: int | Sequence[int], resamples: int = RESAMPLES) -> Array:
    """Return how often each of n seeds counts in the data, and in each resample, [b x n].

    The first row is of the data, all ones. Each row sums to n.
    """
    return np.vstack([np.ones(n), np.random.default_rng(seed).multinomial(n, np.full(n, 1 / n), size=resamples)])


def mean(runs: ArrayLike, counts: Array) -> Array:
    """Return the mean of the runs [... x s x n] for each row of the counts [b x n], [b x ...]."""
    x = np.asarray(runs, dtype=float)
    if np.isnan(x).any():
        raise ValueError(f"every run must have a number, the worst where it diverged; got {np.isnan(x).sum()} NaN")
    return np.moveaxis(x.mean(axis=-2) @ counts.T, -1, 0) / counts.shape[1]


def geometric_mean(runs: ArrayLike, counts: Array) -> Array:
    """Return the geometric mean of the runs, which are above 0; otherwise as `mean`."""
    return np.exp(mean(np.log(runs), counts))


def interval(draws: Array) -> Estimate:
    """Return the first of some draws [b x ...], with the percentile interval of the others."""
    low, high = np.quantile(draws[1:], (TAIL, 1 - TAIL), axis=0)
    return Estimate(draws[0], low, high)


def wins(a: ArrayLike, b: ArrayLike, counts: Array) -> Array:
    """Return the share of the runs in which a errs less than b on the same seed, [b x ...].

    Ties are half.
    """
    a, b = np.asarray(a), np.asarray(b)
    return mean((a < b) + 0.5 * (a == b), counts)


def ranks(draws: Array) -> Estimate:
    """Return median and interval of each policy's rank over the resamples.

    Rank 1 has the smallest number of a draw [b x p], and ties share their mean. Bounds and median
    are ranks that occurred. The first draw, that of the data, is left out.
    """
    from scipy.stats import rankdata  # takes as long to import as all that `evaluate` needs

    rank = rankdata(draws[1:], axis=-1)
    low, median, high = np.quantile(rank, (TAIL, 0.5, 1 - TAIL), axis=0, method="inverted_cdf")
    return Estimate(median, low, high)


def tail_mean(x: ArrayLike, share: float = 0.05) -> Array:
    """Return the mean of the largest of the runs [... x n], a share of them and at least one."""
    x = np.sort(np.asarray(x, dtype=float), axis=-1)
    return np.asarray(x[..., -max(round(share * x.shape[-1]), 1) :].mean(axis=-1))


def proportion(count: ArrayLike, runs: ArrayLike) -> Estimate:
    """Return the share of some runs, such as those that diverged, in all runs.

    It has Clopper and Pearson's interval (1934), which covers at least as often as its confidence.
    The number of these runs, and that of all runs, are [...].
    """
    k, n = np.asarray(count, dtype=float), np.asarray(runs, dtype=float)
    if np.any((k < 0) | (k > n) | (n < 1)):
        raise ValueError(f"count must lie between 0 and runs, and runs be positive, got {count!r} of {runs!r}")
    with np.errstate(invalid="ignore"):
        low = np.where(k > 0, special.betaincinv(k, n - k + 1, TAIL), 0.0)
        high = np.where(k < n, special.betaincinv(k + 1, n - k, 1 - TAIL), 1.0)
    return Estimate(k / n, low, high)
