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
"""Default confidence of every interval."""

RESAMPLES = 2000
"""Default number of bootstrap resamples."""

WORST_SCORE = -100.0
"""The score of a run that diverged, and the least score of any run."""

ENOUGH_EPISODES = 256
"""Test episodes that a claim about a failure rate needs: without any failure they bound it by 1.4 %
(`failures`)."""

ENOUGH_TRAINING_SEEDS = 10
"""An interval over fewer training seeds is labelled optimistic: it covers less often than its
confidence."""

ONCE = np.ones((1, 1, 1))
"""Counts of 1 for each run: with them a statistic is that of the data."""

Rng: TypeAlias = np.random.Generator | int
"""A generator, or the seed of one."""

Statistic: TypeAlias = Callable[[Array, Array], Array]
"""Runs [... x s x n] and counts [b x s x n] to one number per resample [b x ...]: `iqm` or
`mean`."""


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
    """Return how often each bootstrap resample counts each seed [b x strata x n].

    Each row of n sums to n.

    Args:
        n: seeds.
        rng: generator or seed.
        strata: 1: all scenarios share the resampled seeds; their number: each scenario resamples
            its own.
        resamples: b.
    """
    n, strata, b = (
        check_whole("n", n, low=1),
        check_whole("strata", strata, low=1),
        check_whole("resamples", resamples, low=1),
    )
    return np.random.default_rng(rng).multinomial(n, np.full(n, 1 / n), size=(b, strata)).astype(float)


def mean(runs: ArrayLike, counts: Array) -> Array:
    """Return the mean of the runs of each resample [b x ...].

    Args:
        runs: [... x s x n].
        counts: [b x s x n] or broadcast to it.
    """
    x, axes = _runs(runs, counts), list(range(1 - counts.ndim, 0))
    # Along an axis that shares its counts, resampling changes nothing: average it first.
    x = x.mean(axis=tuple(axis for axis in axes if counts.shape[axis] == 1), keepdims=True)
    total = counts.reshape(len(counts), -1).sum(axis=1)
    sums = np.tensordot(counts, x, axes=(axes, axes))
    return sums / total.reshape(-1, *[1] * (sums.ndim - 1))


def iqm(runs: ArrayLike, counts: Array) -> Array:
    """Return the interquartile mean of the runs of each resample [b x ...].

    This is the mean of the middle half of the runs of all scenarios.

    Args:
        runs: [... x s x n].
        counts: [b x s x n] or broadcast to it.
    """
    x = _runs(runs, counts)
    axes = counts.ndim - 1
    shape, x = x.shape[-axes:], x.reshape(*x.shape[:-axes], -1)
    order = np.argsort(x, axis=-1)
    x = np.take_along_axis(x, order, axis=-1)
    means = np.empty((len(counts), *x.shape[:-1]))
    for first in range(0, len(counts), _BLOCK):
        block = slice(first, first + _BLOCK)
        w = np.broadcast_to(counts[block], (len(counts[block]), *shape)).reshape(-1, x.shape[-1])
        total = w.sum(axis=1, keepdims=True)
        cut = np.floor(0.25 * total)
        for row in np.ndindex(x.shape[:-1]):
            # Of the runs in order, those from number `cut` to `total - cut` count.
            upto = np.clip(np.cumsum(w[:, order[row]], axis=1), cut, total - cut)
            means[(block, *row)] = np.diff(upto, axis=1, prepend=cut) @ x[row] / (total - 2 * cut)[:, 0]
    return means


_BLOCK = 16
"""Resamples of one block, which stays in the processor's cache."""


def _runs(runs: ArrayLike, counts: Array) -> Array:
    x = np.asarray(runs, dtype=float)
    shape = x.shape[1 - counts.ndim :]
    if len(shape) != counts.ndim - 1 or any(k not in (1, m) for k, m in zip(counts.shape[1:], shape, strict=True)):
        raise ValueError(f"counts must be [b x s x n] for runs [... x s x n], got {counts.shape} for {x.shape}")
    if np.isnan(x).any():
        raise ValueError(f"every run must have a number, the worst where it diverged; got {np.isnan(x).sum()} NaN")
    return x


def interval(value: ArrayLike, draws: Array, level: float = LEVEL) -> Estimate:
    """Return a value with the percentile interval of its bootstrap draws.

    Args:
        value: [...].
        draws: [b x ...].
        level: confidence.
    """
    tail = (1 - check_number("level", level, above=0, high=1)) / 2
    low, high = np.quantile(draws, (tail, 1 - tail), axis=0)
    return Estimate(np.asarray(value)[()], low, high)


def estimate(x: ArrayLike, counts: Array, statistic: Statistic = iqm, level: float = LEVEL) -> Estimate:
    """Return a statistic of the runs with its interval, each [...].

    With runs [families x severities x arms x n] it is a degradation curve with its pointwise band.

    Args:
        x: [... x s x n].
        counts: from `resample`.
        statistic: `iqm` or `mean`.
        level: confidence.
    """
    return interval(statistic(np.asarray(x), _once(counts))[0], statistic(np.asarray(x), counts), level)


def _once(counts: Array) -> Array:
    return np.ones((1,) * counts.ndim)


def difference(a: ArrayLike, b: ArrayLike, counts: Array, statistic: Statistic = iqm, level: float = LEVEL) -> Estimate:
    """Return the statistic of a minus that of b on the same resampled seeds; below 0, a errs less.

    Args:
        a: runs of one policy [... x s x n].
        b: runs of the other.
        counts: as in `estimate`.
        statistic: as in `estimate`.
        level: as in `estimate`.
    """
    a, b = np.asarray(a), np.asarray(b)
    value = statistic(a, _once(counts)) - statistic(b, _once(counts))
    return interval(value[0], statistic(a, counts) - statistic(b, counts), level)


def wins(a: ArrayLike, b: ArrayLike, counts: Array, level: float = LEVEL) -> Estimate:
    """Return the share of the runs in which a errs less than b on the same seed; ties count half.

    Args:
        a: runs of one policy [... x s x n].
        b: runs of the other.
        counts: as in `estimate`.
        level: as in `estimate`.
    """
    return estimate(_beats(np.asarray(a), np.asarray(b)), counts, mean, level)


def improvement(a: ArrayLike, b: ArrayLike, counts: Array, level: float = LEVEL) -> Estimate:
    """Return the probability that a run of a errs less than a run of b on another seed.

    It is averaged over scenarios.

    Args:
        a: runs of one policy [s x n].
        b: runs of the other. Seeds are resampled jointly, since both policies met the same ones.
        counts: as in `estimate`.
        level: as in `estimate`.
    """
    a, b = np.asarray(a, dtype=float), np.asarray(b, dtype=float)
    n = a.shape[-1]
    # U / n^2 = sum_ij [a_i < b_j] / n^2, ties half: Mann and Whitney (1947), averaged over
    # scenarios.
    u = _beats(a[:, :, None], b[:, None, :])
    c = counts.swapaxes(0, 1)
    if len(c) == 1:
        u = u.mean(axis=0, keepdims=True)
    draws = ((c @ u) * c).sum(axis=-1).mean(axis=0) / n**2
    return interval(u.mean(), draws, level)


def _beats(a: Array, b: Array) -> Array:
    return (a < b) + 0.5 * (a == b)


def profile(x: ArrayLike, tau: ArrayLike, counts: Array, level: float = LEVEL) -> Estimate:
    """Return the performance profile [... x k] with a pointwise band.

    This is the share of the runs with an error of at most tau.

    Args:
        x: [... x s x n].
        tau: [k]. For a score, where larger is better, give -x and -tau.
        counts: from `resample`.
        level: confidence of the band at each tau.
    """
    reached = np.asarray(x)[..., None, :, :] <= np.asarray(tau)[:, None, None]
    return estimate(reached, counts, mean, level)


def ranks(draws: Array, level: float = LEVEL) -> Estimate:
    """Return median and interval of each policy's rank over the resamples.

    Rank 1 has the smallest number, and ties share their mean.

    Args:
        draws: [b x p], such as `iqm(x, counts)` of runs [p x s x n].
        level: confidence. Bounds and median are ranks that occurred.
    """
    tail = (1 - check_number("level", level, above=0, high=1)) / 2
    rank = stats.rankdata(draws, axis=-1)
    low, median, high = np.quantile(rank, (tail, 0.5, 1 - tail), axis=0, method="inverted_cdf")
    return Estimate(median, low, high)


def score(error: ArrayLike, stay: ArrayLike, oracle: ArrayLike, diverged: ArrayLike) -> Array:
    """Return the score of each run.

    An arm that stays at its start has 0, the oracle with the true parameters 100.

    A run that diverged has WORST_SCORE, and no run has less. There is no upper bound: the oracle
    knows the arm, but its gains are not optimal.

    Args:
        error: of the policy [... x s x n].
        stay: error of an arm that stays at its start, on the same seeds.
        oracle: error of the oracle, on the same seeds.
        diverged: True where the policy's run diverged [... x s x n].
    """
    error, stay, oracle = (np.asarray(x, dtype=float) for x in (error, stay, oracle))
    if not np.all(oracle < stay):
        worst = tuple(int(i) for i in np.argwhere(~(oracle < stay))[0])
        raise ValueError(
            f"oracle must err less than staying does on every seed to score a run, got otherwise at {worst}"
        )
    scores = 100 * (stay - error) / (stay - oracle)
    return np.where(np.asarray(diverged, dtype=bool), WORST_SCORE, np.maximum(scores, WORST_SCORE))


def failures(failed: ArrayLike, runs: ArrayLike, level: float = LEVEL) -> Estimate:
    """Return the share of runs that failed with Clopper and Pearson's interval (1934).

    The interval covers at least as often as its confidence.

    Args:
        failed: number of runs that failed [...].
        runs: number of all runs [...].
        level: confidence.
    """
    k, n = np.asarray(failed, dtype=float), np.asarray(runs, dtype=float)
    if np.any((k < 0) | (k > n) | (n < 1)):
        raise ValueError(f"failed must lie between 0 and runs, and runs be positive, got {failed!r} of {runs!r}")
    tail = (1 - check_number("level", level, above=0, high=1)) / 2
    with np.errstate(invalid="ignore"):
        low = np.where(k > 0, stats.beta.ppf(tail, k, n - k + 1), 0.0)
        high = np.where(k < n, stats.beta.ppf(1 - tail, k + 1, n - k), 1.0)
    return Estimate(k / n, low, high)


def enough(episodes: int) -> bool:
    """Return whether there are enough independent episodes for a claim about a failure rate."""
    return check_whole("episodes", episodes) >= ENOUGH_EPISODES


@dataclass(frozen=True)
class Radius:
    """The largest radius up to which a policy tracks.

    Args:
        value: largest radius tried below which none failed; NaN where the bracket's lower end
            failed.
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

    Success need not fall with the radius, so the first failure is sought: `scan` radii are tried
    from below, evenly in log(1 + r), up to the first that fails, and the step before it is
    bisected. A gap of failures narrower than a step of the scan can be missed. Call this once for
    each direction of error (real parameters larger, or smaller, than nominal).

    Args:
        success_share: share of seeds that track within the bound at a radius; the same seeds at
            each.
        bracket: least and largest radius.
        share: of seeds that must succeed.
        scan: steps of the scan; 1: bisection alone.
        tolerance: of log(1 + r), so about that of the ratio real / nominal.
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
    """Return the variance components of runs of one scenario, or of a mean over some.

    Every training seed meets the same worlds, so the two are crossed, not nested: y_tn = mu + a_t +
    w_n + e_tn. From mean squares, negative estimates set to 0: Searle, Casella and McCulloch,
    "Variance Components" (1992), chapter 4.

    Args:
        x: [t x n], of t training seeds on the same n test seeds.
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
    """Return counts [b x t x s x n] that resample training seeds too.

    They are for runs [t x s x n] of a learned policy.

    This is the bootstrap of crossed data (Owen, "The pigeonhole bootstrap", Annals of Applied
    Statistics 1, 2007): training seeds are drawn, and independently the test seeds that all of them
    meet.

    Args:
        counts: [b x s x n] from `resample`; test seeds keep these counts, so that learned policies
            are compared in pairs too.
        training_seeds: t.
        rng: generator or seed.
    """
    drawn = resample(training_seeds, rng, resamples=len(counts))[:, 0]
    return drawn[:, :, None, None] * counts[:, None]


def trained(x: ArrayLike, counts: Array, rng: Rng, statistic: Statistic = iqm, level: float = LEVEL) -> Estimate:
    """Return a statistic of a learned policy's runs with an interval over training and test seeds.

    Args:
        x: [t x s x n], t training seeds.
        rng: generator or seed of the draw of training seeds.
        counts: as in `estimate`.
        statistic: as in `estimate`.
        level: as in `estimate`.
    """
    t = np.asarray(x).shape[0]
    result = estimate(x, over_training(counts, t, rng), statistic, level)
    return replace(result, label="optimistic" if t < ENOUGH_TRAINING_SEEDS else "")
