"""Each metric against a number worked out by hand."""

import numpy as np
import pytest

from benchmarks.run.metrics import METRICS, WORST_ERROR, amplitude, errors, measure, summarize
from benchmarks.run.rollout import Trace
from fbl_gym import Actuator, MinimumJerk, Scenario, Steps


def trace(position, reference, *, torque=None, alive=None, scenario=None):
    """A trace of one seed from [T + 1 x 2] arrays."""
    position, reference = np.asarray(position, float)[:, None], np.asarray(reference, float)[:, None]
    n = len(position)
    scenario = scenario or Scenario(duration=0.01 * (n - 1), reference=MinimumJerk())
    return Trace(
        scenario=scenario,
        seeds=(7,),
        time=scenario.control_dt * np.arange(n),
        position=position,
        velocity=np.zeros_like(position),
        reference=reference,
        torque=np.zeros_like(position) if torque is None else np.asarray(torque, float)[:, None],
        disturbance=np.zeros_like(position),
        alive=np.ones((n, 1), bool) if alive is None else np.asarray(alive)[:, None],
        decision_time=1e-6,
    )


def ramp(n, top=1.0):
    return np.repeat(np.linspace(0.0, top, n)[:, None], 2, axis=1)


def test_tracking_error():
    reference = ramp(101, 2.0)
    position = reference - [0.02, 0.06]
    position[0] = 0.0
    (row,) = measure(trace(position, reference))
    assert row["error_mrad"] == pytest.approx(1e3 * 100 / 101 * 0.04)
    assert row["error_pct"] == pytest.approx(100 * 100 / 101 * 0.04 / 2.0)
    assert row["rms_mrad"] == pytest.approx(1e3 * np.sqrt(100 / 101 * (0.02**2 + 0.06**2) / 2))
    assert row["max_mrad"] == pytest.approx(60.0)
    assert row["diverged"] == 0.0


def test_perfect_tracking_is_zero():
    (row,) = measure(trace(ramp(50), ramp(50)))
    assert row["error_pct"] == row["rms_mrad"] == row["max_mrad"] == row["torque_rms"] == row["variation"] == 0.0


def test_a_joint_that_stands_still_is_measured_against_one_radian():
    reference = np.zeros((10, 2))
    assert amplitude(trace(reference, reference)) == pytest.approx(1.0)


def test_a_diverged_run_counts_with_the_worst_error():
    reference = ramp(101)
    alive = np.arange(101) < 51
    found = trace(reference, reference, alive=alive)
    assert np.all(errors(found)[51:] == WORST_ERROR)
    (row,) = measure(found)
    assert row["diverged"] == 1.0
    assert row["error_mrad"] == pytest.approx(1e3 * np.pi * 50 / 101)
    good = measure(trace(reference, reference))
    assert summarize([row, *good])["error_mrad"] == pytest.approx(row["error_mrad"] / 2)
    assert summarize([row, *good])["diverged"] == 0.5


def test_no_error_counts_more_than_half_a_turn():
    (row,) = measure(trace(ramp(11) + 100.0, ramp(11)))
    assert row["max_mrad"] == pytest.approx(1e3 * np.pi)


def test_steady_state_is_measured_in_the_last_quarter_of_a_rest():
    reference = np.vstack([ramp(51), np.ones((40, 2)), 1.0 + ramp(12)[1:]])
    # The reference rests from sample 50 to sample 90; the last quarter are the ten samples up to there.
    error = np.r_[np.full(81, 0.5), np.full(4, 0.1), np.full(6, 0.01), np.full(11, 0.7)][:, None] * [1.0, 2.0]
    position = reference - error
    position[0] = 0.0
    (row,) = measure(trace(position, reference))
    assert row["steady_1_pct"] == pytest.approx(100 * (4 * 0.1 + 6 * 0.01) / 10 / 2.0)
    assert row["steady_2_pct"] == pytest.approx(2 * row["steady_1_pct"])
    (moving,) = measure(trace(ramp(101), ramp(101)))
    assert np.isnan(moving["steady_1_pct"])


def test_step_response_of_a_known_second_order_system():
    """Damping 0.5, frequency 10 rad/s: overshoot exp(-pi z / sqrt(1 - z^2)) = 16.3 %, settling where it enters 2 %."""
    z, w, dt, n = 0.5, 10.0, 1e-3, 3000
    t = dt * np.arange(n + 1)
    wd = w * np.sqrt(1 - z * z)
    response = 1 - np.exp(-z * w * t) * (np.cos(wd * t) + z / np.sqrt(1 - z * z) * np.sin(wd * t))
    scenario = Scenario(
        reference=Steps(points=((0, 0), (1, 1)), period=3.0), duration=3.0, control_dt=dt, physics_dt=dt
    )
    (row,) = measure(trace(np.c_[response, response], np.ones((n + 1, 2)), scenario=scenario))
    assert row["overshoot_pct"] == pytest.approx(100 * np.exp(-np.pi * z / np.sqrt(1 - z * z)), rel=1e-3)
    settled = dt * (1 + np.flatnonzero(np.abs(response - 1) > 0.02).max())
    assert row["settling_s"] == pytest.approx(settled, abs=1.5e-3)
    (other,) = measure(trace(ramp(50), ramp(50)))
    assert np.isnan(other["overshoot_pct"])
    assert np.isnan(other["settling_s"])


def test_effort():
    n = 101
    torque = np.zeros((n, 2))
    torque[1::2, 0] = 10.0  # jumps by 10 N m at each of 100 samples, 100 samples a second
    torque[:, 1] = 20.0
    scenario = Scenario(duration=1.0, actuator=Actuator(torque_limit=(50.0, 20.0)))
    (row,) = measure(trace(ramp(n), ramp(n), torque=torque, scenario=scenario))
    assert row["torque_rms"] == pytest.approx(np.sqrt((50 * 100 + n * 400) / (2 * n)))
    assert row["variation"] == pytest.approx(100 * 10 / 1.01)
    assert row["saturated_pct"] == pytest.approx(100.0)


def test_every_metric_has_a_meaning():
    (row,) = measure(trace(ramp(20), ramp(20)))
    assert list(row) == list(METRICS)
    assert all(METRICS.values())
