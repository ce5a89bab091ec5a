"""Each statistic against its definition by brute force, against SciPy, and by how often its interval covers."""

import numpy as np
import pytest
from scipy import stats

from benchmarks.analysis.statistics import (
    BOUNDS,
    diverged_shares,
    geometric_mean,
    interval,
    mean,
    proportion,
    ranks,
    resample,
    score,
    tail_mean,
    wins,
)


def runs(*shape, seed=0):
    return np.random.default_rng(seed).lognormal(size=shape)


@pytest.mark.parametrize("n", [1, 2, 3, 7, 10, 64])
def test_means_are_those_of_the_runs_drawn_again(n):
    x = runs(2, 3, n)
    x[0, 0] = x[0, 1]  # ties
    counts = resample(n, 1, resamples=40)
    np.testing.assert_array_equal(counts[0], 1.0)  # the data
    drawn = [[np.repeat(one, c.astype(int), axis=-1) for one in x] for c in counts]
    expected = [[stats.gmean(one, axis=None) for one in pair] for pair in drawn]
    np.testing.assert_allclose(geometric_mean(x, counts), expected, rtol=1e-12)
    np.testing.assert_allclose(mean(x, counts), np.mean(drawn, axis=(2, 3)), rtol=1e-12)


def test_resamples_draw_n_of_n_and_repeat_with_their_seed():
    counts = resample(50, 3, resamples=1200)
    assert counts.shape == (1201, 50)
    assert np.all(counts.sum(axis=-1) == 50)
    np.testing.assert_array_equal(counts, resample(50, 3, resamples=1200))
    # Multinomial: each seed once on average, with variance 1 - 1/n.
    assert counts.mean() == 1.0
    assert counts[1:].var() == pytest.approx(1 - 1 / 50, rel=0.03)


@pytest.mark.parametrize(
    ("statistic", "of_runs"), [(geometric_mean, lambda x: stats.gmean(x, axis=None)), (mean, np.mean)]
)
def test_intervals_agree_with_scipy(statistic, of_runs):
    """Whole seeds are one paired sample of scipy.stats.bootstrap, with a scenario in each of its variables."""
    x = runs(3, 80)
    found = interval(statistic(x, resample(80, 0, resamples=4000)))
    options = {"paired": True, "vectorized": False, "method": "percentile", "n_resamples": 4000, "random_state": 1}
    expected = stats.bootstrap(list(x), lambda *rows: of_runs(np.stack(rows)), **options)
    width = found.high - found.low
    assert found.value == pytest.approx(of_runs(x))
    assert found.low == pytest.approx(expected.confidence_interval.low, abs=0.06 * width)
    assert found.high == pytest.approx(expected.confidence_interval.high, abs=0.06 * width)


def test_the_ends_of_an_interval_are_quantiles():
    found = interval(np.r_[3.0, np.arange(1001.0)])
    assert (found.value, found.low, found.high) == pytest.approx((3.0, 25.0, 975.0))


def test_whole_seeds_cover_where_scenarios_share_them():
    """200 benchmarks of 4 scenarios and 60 seeds, where a hard seed is hard in all of them; the truth is that of 200,000."""
    rng = np.random.default_rng(0)

    def benchmark(n):
        return np.exp(0.5 * rng.standard_normal(n) + 0.3 * rng.standard_normal((4, n)))

    truth = np.exp(np.log(benchmark(200_000)).mean())
    covered = 0
    for k in range(200):
        found = interval(geometric_mean(benchmark(60), resample(60, k, resamples=300)))
        covered += found.low <= truth <= found.high
    assert 0.90 <= covered / 200 <= 0.99  # 95 % says the interval


def test_wins_are_counted_on_the_same_seed():
    a = runs(2, 30)
    counts = resample(30, 0)
    assert np.all(wins(a, a + 1e-9, counts) == 1.0)
    assert np.all(wins(a, a, counts) == 0.5)
    b = runs(2, 30, seed=1)
    assert wins(a, b, counts)[0] == pytest.approx(np.mean(a < b))


def test_ranks():
    x = np.stack([runs(2, 50), runs(2, 50) + 5.0, 1.001 * runs(2, 50, seed=1), runs(2, 50)])
    draws = geometric_mean(x, resample(50, 0))
    found = ranks(draws)
    assert (found.low[1], found.value[1], found.high[1]) == (4.0, 4.0, 4.0)
    assert (found.low[2], found.high[2]) == (1.0, 3.0)
    np.testing.assert_array_equal(found.value[[0, 3]], found.value[[3, 0]])
    order = [sorted(row).index(row[2]) + 1 for row in draws[1:]]
    assert found.value[2] == np.median(order)


def test_score():
    """Staying scores 0, the ceiling 100, half of the way in the logarithm 50."""
    gain, span = np.log([1.0, 4500.0, np.sqrt(4500.0)]), np.log(4500.0)
    np.testing.assert_allclose(score(gain[None], [[span] * 3], 0.0), [0.0, 100.0, 50.0])
    assert score(gain, [span] * 3, 0.0) == pytest.approx(50.0)
    # Each percent of diverged runs costs as much as halving the error gains.
    assert score(gain, [span] * 3, 0.01) == pytest.approx(score(gain - np.log(2.0), [span] * 3, 0.0))
    assert score([-50.0, 50.0], [span] * 2, 0.0) == pytest.approx(np.mean(BOUNDS))


def test_the_posterior_of_diverged_runs():
    """That of Jeffreys' prior for independent runs; none seen is not none; runs of one seed are one cluster."""
    flags = np.arange(64) < 3
    draws, prior = diverged_shares([flags], [1.0], 0, resamples=20_000)
    assert prior == 0.5 / 64.5
    assert draws[0] == pytest.approx(3.5 / 64.5)
    beta = stats.beta(3.5, 61.5)
    np.testing.assert_allclose(np.quantile(draws[1:], (0.025, 0.5, 0.975)), beta.ppf((0.025, 0.5, 0.975)), rtol=0.06)
    none = interval(diverged_shares([np.zeros(32)] * 15, np.ones(15), 0)[0])
    assert 0.0 < none.low < 0.5 / 480 < none.high < 3.0 / 480
    clustered, spread = np.zeros((2, 8, 32))
    clustered[:, 0] = spread[range(8), range(8)] = 1.0  # eight runs each: of one seed, of eight
    one, eight = (interval(diverged_shares(flags, np.ones(8), 0)[0]) for flags in (clustered, spread))
    assert one.high > 1.5 * eight.high
    many, prior = diverged_shares([np.zeros((2, 32)), np.array([[0.0] * 512, [1.0] * 512])], [1.0, 3.0], 0)
    assert many.shape == (2001, 2)
    assert prior == pytest.approx((0.125 / 32.125 + 0.375 / 512.375) / 2)
    assert many[0, 1] == pytest.approx(0.5 + 0.5 * 0.125 / 32.125)


@pytest.mark.parametrize("spread", [0.0, 2.0])
def test_intervals_of_diverged_runs_cover(spread):
    """Over drawn boards of four scenarios, whose seeds differ in difficulty."""
    random, covered = np.random.default_rng(0), 0
    rates = np.array([0.004, 0.001, 0.001, 0.001])[:, None]

    def lost(n):
        return random.random((4, n)) < rates * np.exp(spread * random.standard_normal(n) - spread**2 / 2)

    truth = lost(2_000_000).mean()
    for trial in range(200):
        estimate = interval(diverged_shares(lost(32), rates, trial, resamples=500)[0])
        covered += estimate.low <= truth <= estimate.high
    assert covered >= 0.92 * 200


def test_tail_mean():
    x = np.random.default_rng(0).permutation(200.0 * np.arange(1, 101)).reshape(1, 100)
    assert tail_mean(x) == pytest.approx(200 * 98)
    assert tail_mean([3.0, 1.0]) == 3.0


def test_shares_agree_with_scipy_and_cover():
    for k, n in [(0, 256), (1, 30), (15, 30), (30, 30)]:
        found, expected = proportion(k, n), stats.binomtest(k, n).proportion_ci(method="exact")
        assert (found.value, found.low, found.high) == pytest.approx((k / n, expected.low, expected.high))
    n = 40
    k = np.arange(n + 1)
    found = proportion(k, n)
    for p in np.linspace(0.01, 0.99, 50):
        assert stats.binom.pmf(k, n, p)[(found.low <= p) & (p <= found.high)].sum() >= 0.95
    with pytest.raises(ValueError, match="count must lie between 0 and runs"):
        proportion(3, 2)


def test_missing_runs_and_wrong_shapes_are_refused():
    counts = resample(4, 0, resamples=5)
    with pytest.raises(ValueError, match="every run must have a number, the worst where it diverged; got 1 NaN"):
        geometric_mean([[1.0, 2.0, np.nan, 4.0]], counts)
    with pytest.raises(ValueError, match=r"counts must be \[b x n\]"):
        mean(np.ones((2, 5)), counts)
