"""Each metric against a number worked out by hand; each statistic against brute force, SciPy and its coverage."""

import dataclasses

import numpy as np
import pytest
from scipy import signal, stats

from benchmarks.analysis import statistics
from benchmarks.run.metrics import METRICS, WORST_ERROR, amplitude, departure, errors, measure
from benchmarks.run.rollout import Trace, rollout
from fbl_gym import Actuator, MinimumJerk, Scenario, Steps


def trace(position, reference, *, torque=None, command=None, alive=None, scenario=None):
    """A trace of one seed from [T + 1 x 2] arrays."""
    position, reference = np.asarray(position, float)[:, None], np.asarray(reference, float)[:, None]
    n, zero = len(position), np.zeros_like(position)
    scenario = scenario or Scenario(duration=0.01 * (n - 1), reference=MinimumJerk())
    command, torque = (zero if given is None else np.asarray(given)[:, None] for given in (command, torque))
    return Trace(
        scenario=scenario, seeds=(7,), time=scenario.control_dt * np.arange(n), position=position, velocity=zero.copy(),
        reference=reference, disturbance=zero, alive=np.ones((n, 1), bool) if alive is None else alive[:, None],
        decision_time=1e-6, command=command, torque=torque,
    )  # fmt: skip


def ramp(n, top=1.0):
    return np.repeat(np.linspace(0.0, top, n)[:, None], 2, axis=1)


def test_tracking_error():
    reference = ramp(101, 2.0)
    position = reference - [0.02, 0.06]
    position[0] = 0.0
    (row,) = measure(trace(position, reference))
    assert row["error_mrad"] == pytest.approx(1e3 * 100 / 101 * 0.04)
    assert row["error_pct"] == pytest.approx(100 * 100 / 101 * 0.04 / 1.0)  # half of the range is 1 rad
    assert row["resolution_pct"] == pytest.approx(100 * 2 * np.pi / 2**20)
    assert row["rms_mrad"] == pytest.approx(1e3 * np.sqrt(100 / 101 * (0.02**2 + 0.06**2) / 2))
    assert (row["max_mrad"], row["diverged"], list(row)) == (pytest.approx(60.0), 0.0, list(METRICS))
    assert all(METRICS.values())  # each has a meaning


def test_the_papers_errors_are_shares_of_the_departure_from_the_start():
    """A step of 0.5 rad is 100 %, not half of it."""
    reference = np.tile((0.5, -0.25), (10, 1))
    reference[0] = 0.0
    step = trace(0.9 * reference, reference)
    np.testing.assert_allclose(departure(step), [[0.5, 0.25]])
    (row,) = measure(step, departure(step))
    assert row["error_pct"] == pytest.approx(9.0)


def test_errors_are_shares_of_half_the_range_of_the_reference():
    """The start does not matter; a joint that shall stand still is measured against one radian."""
    reference = np.c_[np.full(10, 0.3), np.linspace(-1.0, 2.0, 10)]
    (row,) = measure(found := trace(reference + 1e-3, reference))
    np.testing.assert_allclose(amplitude(found), [[1.0, 1.5]])
    assert row["error_pct"] == pytest.approx(100 * (1e-3 / 1.0 + 1e-3 / 1.5) / 2)
    scenario = Scenario(duration=0.09, encoder={"counts": (1000, 2000)})
    (row,) = measure(trace(reference, reference, scenario=scenario))
    assert row["resolution_pct"] == pytest.approx(100 * (2 * np.pi / 1000 + 2 * np.pi / 2000 / 1.5) / 2)


def test_integral_criteria():
    """An error of 0.2 and 0.4 rad over 1 s."""
    reference = ramp(101)
    (row,) = measure(trace(reference - [0.2, 0.4], reference))
    assert [row[name] for name in ("iae", "itae", "ise")] == pytest.approx([0.3, 0.3 * 0.505, (0.04 + 0.16) / 2])


def test_violation():
    """One sample of the position, one of the velocity, and two after the end, out of ten."""
    scenario = Scenario(duration=0.1, constraints={"high": (0.5, 9.0), "velocity": 2.0})
    position, alive = np.zeros((11, 2)), np.arange(11) < 9
    position[[0, 3], 0] = 0.6
    run = trace(position, position, scenario=scenario, alive=alive)
    run.velocity[5, 0, 1] = -3.0
    assert measure(run)[0]["violation_pct"] == pytest.approx(40.0)
    assert np.isnan(measure(trace(position, position))[0]["violation_pct"])


def test_recovery():
    """Two events: an error of 10 mrad before, a pulse of 0.1 rad for 0.3 s, and one without return."""
    t = 0.01 * np.arange(601)
    error = np.where((t > 2.0) & (t < 2.3 - 1e-9), 0.11, 0.01) + np.where(t > 4.0, 0.05, 0.0)
    scenario = Scenario(duration=6.0, reference=MinimumJerk())
    found = trace(-np.c_[error, error], np.zeros((601, 2)), scenario=scenario)
    names = ("recovery_rad_s", "recovery_s", "unrecovered_pct")
    (row,) = measure(dataclasses.replace(found, event_times=np.array([[2.0, 4.0]])))
    expected = (0.1 * 0.29 + 0.05 * 2.0) / 2, (0.29 + 2.0) / 2, 50.0
    assert [row[name] for name in names] == pytest.approx(expected)
    # An event without effect has no area, although the error of a moving arm swings.
    swing = 0.01 + 0.005 * np.sin(20 * t)
    found = trace(np.c_[swing, swing], np.zeros((601, 2)), scenario=scenario)
    (row,) = measure(dataclasses.replace(found, event_times=np.array([[3.0]])))
    assert [row[name] for name in names] == [pytest.approx(0.0, abs=1e-5), 0.0, 0.0]
    dead = dataclasses.replace(found, event_times=np.array([[3.0]]), alive=(t < 4.0)[:, None])
    late = dataclasses.replace(found, event_times=np.array([[6.0, 6.5]]))
    for other in (found, dead, late):  # no event, or the run diverged, or after the end
        assert np.isnan([measure(other)[0][name] for name in names]).all()


def test_event_times_are_those_of_each_lane():
    events = [{"kind": "knock", "time": {"uniform": [0.2, 0.8]}, "impulse": 30.0}, {"kind": "drop", "time": 0.9}]
    found = rollout("pd-gravity", Scenario(duration=1.0, events=events), range(20))
    assert found.event_times.shape == (20, 2)
    np.testing.assert_allclose(found.event_times[:, 1], 0.9)
    jumps = np.abs(np.diff(found.velocity, axis=0)).sum(axis=-1).argmax(axis=0)
    np.testing.assert_array_equal(jumps, np.floor(found.event_times[:, 0] / 0.01 + 1e-9))


def test_a_diverged_run_counts_with_the_worst_error():
    reference = ramp(101)
    alive = np.arange(101) < 51
    found = trace(reference, reference, alive=alive)
    assert np.all(errors(found)[51:] == WORST_ERROR)
    (far,) = measure(trace(reference + 100.0, reference))
    assert far["max_mrad"] == pytest.approx(1e3 * np.pi)  # half a turn at most
    (row,), good = measure(found), measure(trace(reference, reference))
    for runs, share in (([row], 1.0), ([row, *good], 0.5)):
        lost, error = (np.mean([run[name] for run in runs]) for name in ("diverged", "error_mrad"))
        assert (lost, error) == (share, pytest.approx(share * 1e3 * np.pi * 50 / 101))


def test_steady_state_is_measured_in_the_last_quarter_of_a_rest():
    reference = np.vstack([ramp(51), np.ones((40, 2)), 1.0 + ramp(12)[1:]])
    # The reference rests from sample 50 to sample 90; the last quarter are the ten samples up to there.
    error = np.r_[np.full(81, 0.5), np.full(4, 0.1), np.full(6, 0.01), np.full(11, 0.7)][:, None] * [1.0, 2.0]
    position = reference - error
    position[0] = 0.0
    (row,) = measure(trace(position, reference))
    assert row["steady_1_pct"] == pytest.approx(100 * (4 * 0.1 + 6 * 0.01) / 10)  # half of the range is 1 rad
    assert row["steady_2_pct"] == pytest.approx(2 * row["steady_1_pct"])
    (moving,) = measure(trace(ramp(101), ramp(101)))
    assert np.isnan(moving["steady_1_pct"])


def test_step_response_of_a_known_second_order_system():
    """Damping 0.5, frequency 10 rad/s: overshoot exp(-pi z / sqrt(1 - z^2)) = 16.3 %, settling where it enters 2 %."""
    z, w, dt, n = 0.5, 10.0, 1e-3, 3000
    t = dt * np.arange(n + 1)
    response = signal.step(([w**2], [1, 2 * z * w, w**2]), T=t)[1]
    steps = Steps(points=((0, 0), (1, 1)), period=3.0)
    scenario = Scenario(reference=steps, duration=3.0, control_dt=dt, physics_dt=dt)
    (row,) = measure(trace(np.c_[response, response], np.ones((n + 1, 2)), scenario=scenario))
    assert row["overshoot_pct"] == pytest.approx(100 * np.exp(-np.pi * z / np.sqrt(1 - z * z)), rel=1e-3)
    settled = dt * (1 + np.flatnonzero(np.abs(response - 1) > 0.02).max())
    assert row["settling_s"] == pytest.approx(settled, abs=1.5e-3)
    assert row["rise_s"] == pytest.approx(0.1637, abs=1e-3)  # 1.637 / w for this damping
    levels = np.repeat(np.floor(0.01 * np.arange(301) / 0.555 + 1e-9)[:, None] % 2, 2, axis=1)
    uneven = Scenario(reference=dataclasses.replace(steps, period=0.555), duration=3.0)
    (perfect,) = measure(trace(levels, levels, scenario=uneven))
    assert perfect["settling_s"] == perfect["rise_s"] == 0.0
    (other,) = measure(trace(ramp(50), ramp(50)))
    assert np.isnan([other[name] for name in ("overshoot_pct", "settling_s", "rise_s")]).all()


def test_effort():
    n = 101
    torque = np.zeros((n, 2))
    torque[1::2, 0] = 10.0  # jumps by 10 N m at each of 100 samples, 100 samples a second
    torque[:, 1] = 20.0
    scenario = Scenario(duration=1.0, actuator=Actuator(torque_limit=(50.0, 20.0)))
    command = np.where(np.arange(n)[:, None] < 25, -20.0, torque)
    (row,) = measure(trace(ramp(n), ramp(n), torque=0.5 * torque, command=command, scenario=scenario))
    assert row["torque_rms"] == pytest.approx(0.5 * np.sqrt((50 * 100 + n * 400) / (2 * n)))
    assert row["variation"] == pytest.approx(0.5 * 100 * 10 / 1.01)
    assert row["energy_J"] == pytest.approx(0.5 * (50 * 10 + 100 * 20) * np.diff(ramp(n)[:, 0]).mean())
    assert row["saturated_pct"] == pytest.approx(100.0)
    (row,) = measure(trace(ramp(n), ramp(n), torque=torque, command=0.5 * command, scenario=scenario))
    assert row["saturated_pct"] == 0.0


def runs(*shape, seed=0):
    return np.random.default_rng(seed).lognormal(size=shape)


@pytest.mark.parametrize("n", [1, 2, 3, 7, 10, 64])
def test_means_are_those_of_the_runs_drawn_again(n):
    x = runs(2, 3, n)
    x[0, 0] = x[0, 1]  # ties
    counts = statistics.resample(n, 1, resamples=40)
    np.testing.assert_array_equal(counts[0], 1.0)  # the data
    drawn = [[np.repeat(one, c.astype(int), axis=-1) for one in x] for c in counts]
    expected = [[stats.gmean(one, axis=None) for one in pair] for pair in drawn]
    np.testing.assert_allclose(statistics.geometric_mean(x, counts), expected, rtol=1e-12)
    np.testing.assert_allclose(statistics.mean(x, counts), np.mean(drawn, axis=(2, 3)), rtol=1e-12)


def test_resamples_draw_n_of_n_and_repeat_with_their_seed():
    counts, again = (statistics.resample(50, 3, resamples=1200) for _ in range(2))
    np.testing.assert_array_equal(counts, again)
    np.testing.assert_array_equal(counts.sum(axis=-1), np.full(1201, 50))
    assert counts[1:].var() == pytest.approx(1 - 1 / 50, rel=0.03)  # multinomial


def test_intervals_agree_with_scipy():
    """Whole seeds are one paired sample of scipy.stats.bootstrap, with a scenario in each of its variables."""
    x = runs(3, 80)
    found = statistics.interval(statistics.geometric_mean(x, statistics.resample(80, 0, resamples=4000)))
    options = {"paired": True, "vectorized": False, "method": "percentile", "n_resamples": 4000, "random_state": 1}
    expected = stats.bootstrap(list(x), lambda *rows: stats.gmean(np.stack(rows), axis=None), **options)
    width = found.high - found.low
    assert found.value == pytest.approx(stats.gmean(x, axis=None))
    assert (found.low, found.high) == pytest.approx(tuple(expected.confidence_interval), abs=0.06 * width)


def test_whole_seeds_cover_where_scenarios_share_them():
    """200 benchmarks of 4 scenarios and 60 seeds, where a hard seed is hard in all of them; the truth is that of 200,000."""
    rng = np.random.default_rng(0)

    def benchmark(n):
        return np.exp(0.5 * rng.standard_normal(n) + 0.3 * rng.standard_normal((4, n)))

    truth = np.exp(np.log(benchmark(200_000)).mean())
    counts = (statistics.resample(60, k, resamples=300) for k in range(200))
    found = [statistics.interval(statistics.geometric_mean(benchmark(60), each)) for each in counts]
    assert 0.90 <= np.mean([each.low <= truth <= each.high for each in found]) <= 0.99  # 95 % says the interval


def test_wins_are_counted_on_the_same_seed():
    a, b, counts = runs(2, 30), runs(2, 30, seed=1), statistics.resample(30, 0)
    for other, share in ((a + 1e-9, 1.0), (a, 0.5)):
        assert np.all(statistics.wins(a, other, counts) == share)
    assert statistics.wins(a, b, counts)[0] == pytest.approx(np.mean(a < b))


def test_ranks():
    x = np.stack([runs(2, 50), runs(2, 50) + 5.0, 1.001 * runs(2, 50, seed=1), runs(2, 50)])
    draws = statistics.geometric_mean(x, statistics.resample(50, 0))
    found = statistics.ranks(draws)
    assert (found.low[1], found.value[1], found.high[1]) == (4.0, 4.0, 4.0)
    assert (found.low[2], found.high[2], found.value[0]) == (1.0, 3.0, found.value[3])
    assert found.value[2] == np.median([sorted(row).index(row[2]) + 1 for row in draws[1:]])


def test_tail_mean():
    x = np.random.default_rng(0).permutation(200.0 * np.arange(1, 101)).reshape(1, 100)
    assert statistics.tail_mean(x) == pytest.approx(200 * 98)
    assert statistics.tail_mean([3.0, 1.0]) == 3.0


def test_shares_agree_with_scipy_and_cover():
    for k, n in [(0, 256), (1, 30), (15, 30), (30, 30)]:
        found, expected = statistics.proportion(k, n), stats.binomtest(k, n).proportion_ci(method="exact")
        assert (found.value, found.low, found.high) == pytest.approx((k / n, expected.low, expected.high))
    n = 40
    k = np.arange(n + 1)
    found = statistics.proportion(k, n)
    for p in np.linspace(0.01, 0.99, 50):
        assert stats.binom.pmf(k, n, p)[(found.low <= p) & (p <= found.high)].sum() >= 0.95
    with pytest.raises(ValueError, match="count must lie between 0 and runs"):
        statistics.proportion(3, 2)
