"""Statistics of the leaderboard: pure functions on arrays.

Runs lie in arrays [... x s x n] of s scenarios and n seeds. Axes before these (policies,
severities, training seeds) stay. A bootstrap resample is an array of counts, the weight of each
run, and `resample` draws all counts of a bootstrap at once. Statistics with the same counts use the
same resampled seeds, so policies are compared in pairs.

Scenarios share seeds: seed 7 has the same motion everywhere, so a policy's errors in two scenarios
are correlated. An interval of an aggregate must therefore resample whole seeds (`resample(n)`).
Resampling the seeds of each scenario separately (`resample(n, strata=s)`; Agarwal et al., "Deep
Reinforcement Learning at the Edge of the Statistical Precipice", NeurIPS 2021) is right where
scenarios have different seeds, and too narrow here.

Smaller errors are better. A run that diverged counts with its worst error and is never left out:
NaN is refused.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from math import expm1, inf, log1p, nan
from typing import TypeAlias

import numpy as np
from numpy.typing import ArrayLike
from scipy import stats

from fbl_gym.arm import Array
from fbl_gym.checks import check_number, check_whole

LEVEL = 0.95
"""Confidence of every interval."""

TAIL = (1 - LEVEL) / 2
"""Share of the draws on each side of an interval."""

RESAMPLES = 2000
"""Default number of bootstrap resamples."""

BOUNDS = -100.0, 120.0
"""Least and largest score."""

DIVERGENCE_PRICE = 100 * np.log(2.0)
"""Price of a share of diverged runs in the logarithm of the error: each percent costs as much as
doubling the error."""

ENOUGH_EPISODES = 256
"""Test episodes that a claim about the share of diverged runs needs.

If none of them diverges, they bound the share by 1.4 % (`proportion`).
"""

ENOUGH_TRAINING_SEEDS = 10
"""An interval over fewer training seeds is labelled optimistic: it covers less often than its
confidence."""

Rng: TypeAlias = np.random.Generator | int
"""A generator, or the seed of one."""

Statistic: TypeAlias = Callable[[Array, Array], Array]
"""Runs [... x s x n] and counts [b x s x n] to one number per resample [b x ...]:
`geometric_mean` or `mean`."""


@dataclass(frozen=True)
class Estimate:
    """Values with their intervals, element by element.

    Args:
        value: of the data.
        low: lower end of the interval, in the shape of `value`.
        high: upper end of the interval.
        label: "optimistic" where the interval is known to be too narrow; else empty.
    """

    value: Array
    low: Array
    high: Array
    label: str = ""


def resample(n: int, rng: Rng, *, strata: int = 1, resamples: int = RESAMPLES) -> Array:
    """Return the weight of each seed in each resample, [b x strata x n]; each row of n sums to n.

    With 1 stratum, all scenarios share the resampled seeds. With one for each scenario, each
    resamples separately.
    """
    n, strata, b = (check_whole(*x, low=1) for x in (("n", n), ("strata", strata), ("resamples", resamples)))
    return np.random.default_rng(rng).multinomial(n, np.full(n, 1 / n), size=(b, strata)).astype(float)


def mean(runs: ArrayLike, counts: Array) -> Array:
    """Return the mean of the runs [... x s x n] of each resample, [b x ...].

    The counts are [b x s x n] or broadcast to it.
    """
    x, axes = _runs(runs, counts), list(range(1 - counts.ndim, 0))
    # Along an axis that shares its counts, resampling changes nothing: average it first.
    x = x.mean(axis=tuple(axis for axis in axes if counts.shape[axis] == 1), keepdims=True)
    total = counts.reshape(len(counts), -1).sum(axis=1)
    sums = np.tensordot(counts, x, axes=(axes, axes))
    return sums / total.reshape(-1, *[1] * (sums.ndim - 1))


def geometric_mean(runs: ArrayLike, counts: Array) -> Array:
    """Return the geometric mean of the runs [... x s x n] of each resample, [b x ...].

    The runs are above 0. The counts are as for `mean`.
    """
    return np.exp(mean(np.log(runs), counts))


def _runs(runs: ArrayLike, counts: Array) -> Array:
    x = np.asarray(runs, dtype=float)
    shape = x.shape[1 - counts.ndim :]
    if len(shape) != counts.ndim - 1 or any(k not in (1, m) for k, m in zip(counts.shape[1:], shape, strict=True)):
        raise ValueError(f"counts must be [b x s x n] for runs [... x s x n], got {counts.shape} for {x.shape}")
    if np.isnan(x).any():
        raise ValueError(f"every run must have a number, the worst where it diverged; got {np.isnan(x).sum()} NaN")
    return x


def interval(value: ArrayLike, draws: Array) -> Estimate:
    """Return a value [...] with the percentile interval of its bootstrap draws [b x ...]."""
    low, high = np.quantile(draws, (TAIL, 1 - TAIL), axis=0)
    return Estimate(np.asarray(value)[()], low, high)


def estimate(x: ArrayLike, counts: Array, statistic: Statistic = geometric_mean) -> Estimate:
    """Return a statistic of the runs [... x s x n] with its interval, each [...]."""
    once = np.ones((1,) * counts.ndim)  # counts each run once
    return interval(statistic(np.asarray(x), once)[0], statistic(np.asarray(x), counts))


def wins(a: ArrayLike, b: ArrayLike, counts: Array) -> Estimate:
    """Return the share of the runs in which a errs less than b on the same seed; ties are half."""
    a, b = np.asarray(a), np.asarray(b)
    return estimate((a < b) + 0.5 * (a == b), counts, mean)


def profile(x: ArrayLike, tau: ArrayLike, counts: Array) -> Estimate:
    """Return the share of the runs [... x s x n] with an error of at most tau [k], as [... x k].

    This is the performance profile, with a pointwise band.
    """
    reached = np.asarray(x)[..., None, :, :] <= np.asarray(tau)[:, None, None]
    return estimate(reached, counts, mean)


def ranks(draws: Array) -> Estimate:
    """Return median and interval of each policy's rank over the resamples.

    Rank 1 has the smallest number of a draw [b x p], and ties share their mean. Bounds and median
    are ranks that occurred.
    """
    rank = stats.rankdata(draws, axis=-1)
    low, median, high = np.quantile(rank, (TAIL, 0.5, 1 - TAIL), axis=0, method="inverted_cdf")
    return Estimate(median, low, high)


def score(gains: ArrayLike, spans: ArrayLike, diverged: ArrayLike) -> Array:
    """Return the score over s scenarios [...], without the lower bound of BOUNDS.

    This is the mean over the scenarios of 100 gain / span, each within BOUNDS, less the price of
    the diverged runs.

    Args:
        gains: ln(E_stay / E) [s x ...]. E is the geometric mean error of the runs, E_stay that of
            an arm that stays at its start.
        spans: ln(E_stay / E_ceiling) [s x ...] for the best law that knows the truth.
        diverged: share of the runs that diverged [...], see `diverged_share`.
    """
    spans = np.asarray(spans)
    errors = np.clip(100 * np.asarray(gains) / spans, *BOUNDS).mean(axis=0)
    return np.asarray(errors - 100 * DIVERGENCE_PRICE * np.asarray(diverged) / spans.mean(axis=0))


def diverged_share(diverged: ArrayLike, runs: int) -> Array:
    """Return the share of diverged runs that a score counts, of their number [...].

    It is Clopper and Pearson's upper bound, less the upper bound where none diverged: the bound
    alone would charge all policies for few runs.
    """
    bounds = proportion(np.arange(runs + 1), runs).high
    return np.asarray((bounds - bounds[0])[np.rint(diverged).astype(int)])


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
        low = np.where(k > 0, stats.beta.ppf(TAIL, k, n - k + 1), 0.0)
        high = np.where(k < n, stats.beta.ppf(1 - TAIL, k + 1, n - k), 1.0)
    return Estimate(k / n, low, high)


def enough(episodes: int) -> bool:
    """Return True if a claim about the share of diverged runs has enough independent episodes."""
    return check_whole("episodes", episodes) >= ENOUGH_EPISODES


@dataclass(frozen=True)
class Radius:
    """The largest radius up to which a policy tracks.

    Args:
        value: largest radius below the first failure; NaN where the bracket's lower end failed.
        fails: smallest radius that failed; infinite where none did, up to the bracket's upper end.
        tried: each radius with its share of successful seeds, in the order of the radii.
    """

    value: float
    fails: float
    tried: tuple[tuple[float, float], ...]

    @property
    def monotone(self) -> bool:
        """True if the share of successes never rises with the radius."""
        return all(after[1] <= before[1] for before, after in zip(self.tried, self.tried[1:], strict=False))

    def __str__(self) -> str:
        if np.isnan(self.value):
            return f"< {self.fails:.3g}"
        return f"≥ {self.value:.3g}" if self.fails == inf else f"{self.value:.3g}"


def radius(
    success_share: Callable[[float], float],
    *,
    bracket: tuple[float, float] = (0.0, 10.0),
    share: float = 0.95,
    scan: int = 6,
    tolerance: float = 0.01,
) -> Radius:
    """Return the largest radius up to which a policy tracks, by scan and bisection in log(1 + r).

    `success_share` returns the share of seeds that track within the bound at a radius; `share` of
    them must. Success need not fall with the radius, so the first failure is sought: `scan` radii
    are tried from below, evenly in log(1 + r), up to the first that fails, and the step before it
    is bisected to `tolerance` in log(1 + r). A gap of failures narrower than a step of the scan can
    be missed. Call this once for each direction of error (real parameters larger, or smaller, than
    nominal).
    """
    low, high = check_number("bracket[0]", bracket[0], low=0), check_number("bracket[1]", bracket[1], above=bracket[0])
    steps, tolerance = check_whole("scan", scan, low=1), check_number("tolerance", tolerance, above=0)
    tried: dict[float, float] = {}

    def works(z: float) -> bool:
        r = expm1(z)
        tried[r] = float(success_share(r))
        return tried[r] >= share

    def result(works_at: float, fails_at: float) -> Radius:
        return Radius(expm1(works_at), expm1(fails_at), tuple(sorted(tried.items())))

    grid = [float(z) for z in np.linspace(log1p(low), log1p(high), steps + 1)]
    first = next((i for i, z in enumerate(grid) if not works(z)), None)
    if first is None:
        return result(grid[-1], inf)
    if first == 0:
        return result(nan, grid[0])
    good, bad = grid[first - 1], grid[first]
    while bad - good > tolerance:
        middle = (good + bad) / 2
        good, bad = (middle, bad) if works(middle) else (good, middle)
    return result(good, bad)


@dataclass(frozen=True)
class Components:
    """The spread of a learned policy's runs as variances.

    Args:
        training: between training seeds.
        world: between test seeds, the same for every training seed.
        rest: of the remainder, since some training seeds do better in some worlds.
        standard_error: of the mean over both.
    """

    training: float
    world: float
    rest: float
    standard_error: float


def components(x: ArrayLike) -> Components:
    """Return the variance components of runs [t x n] of t training seeds on the same n test seeds.

    Every training seed meets the same worlds, so the two are crossed, not nested: y_tn = mu + a_t +
    w_n + e_tn. From mean squares, negative estimates set to 0: Searle, Casella and McCulloch,
    "Variance Components" (1992), chapter 4.
    """
    x = np.asarray(x, dtype=float)
    if x.ndim != 2 or min(x.shape) < 2:
        raise ValueError(f"x must be [training seeds x test seeds] with at least two of each, got shape {x.shape}")
    t, n = x.shape
    rows, columns = x.mean(axis=1), x.mean(axis=0)
    ms_training, ms_world = n * rows.var(ddof=1), t * columns.var(ddof=1)
    ms_rest = float(((x - rows[:, None] - columns + x.mean()) ** 2).sum() / ((t - 1) * (n - 1)))
    training, world = max((ms_training - ms_rest) / n, 0.0), max((ms_world - ms_rest) / t, 0.0)
    return Components(training, world, ms_rest, float(np.sqrt(training / t + world / n + ms_rest / (t * n))))


def over_training(counts: Array, training_seeds: int, rng: Rng) -> Array:
    """Return counts [b x t x s x n] that resample training seeds too, from counts [b x s x n].

    This is the bootstrap of crossed data (Owen, "The pigeonhole bootstrap", Annals of Applied
    Statistics 1, 2007): training seeds are drawn, and independently the test seeds that all of them
    meet. Test seeds keep their counts, so that learned policies are compared in pairs too.
    """
    drawn = resample(training_seeds, rng, resamples=len(counts))[:, 0]
    return drawn[:, :, None, None] * counts[:, None]


def trained(x: ArrayLike, counts: Array, rng: Rng, statistic: Statistic = geometric_mean) -> Estimate:
    """Return a statistic of a learned policy's runs [t x s x n] over training and test seeds."""
    t = np.asarray(x).shape[0]
    result = estimate(x, over_training(counts, t, rng), statistic)
    return replace(result, label="optimistic" if t < ENOUGH_TRAINING_SEEDS else "")
