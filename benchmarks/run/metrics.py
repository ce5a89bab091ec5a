"""Metrics of a trace, one row for each seed. Pure functions.

A diverged run counts: from the sample at which it ended on, the error of both joints is half a
turn, the largest error of any sample. No policy gains by diverging.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from benchmarks.run.rollout import Trace
from fbl_gym.arm import Array
from fbl_gym.references import FilteredSteps, Steps

WORST_ERROR = np.pi
"""Largest error of a joint [rad]; a joint whose run has diverged has it too."""

REST = 0.2
"""A reference rests when it stands still at least this long [s].

The steady-state error is that of the last quarter of each rest.
"""

BAND = 0.02
"""A step has settled when the joint stays within this share of the step."""

METRICS: dict[str, str] = {
    "error_pct": "mean absolute tracking error, both joints, in % of the reference's amplitude",
    "error_mrad": "mean absolute tracking error, both joints [mrad]",
    "rms_mrad": "root mean square tracking error, both joints [mrad]",
    "max_mrad": "largest absolute tracking error of either joint [mrad]",
    "steady_1_pct": "mean absolute error of link 1 while the reference rests, in % of its amplitude",
    "steady_2_pct": "mean absolute error of link 2 while the reference rests, in % of its amplitude",
    "overshoot_pct": "largest overshoot beyond a step of the reference, in % of the step (step references only)",
    "settling_s": "mean 2 % settling time of the steps [s] (step references only); the whole period if it never settles",
    "torque_rms": "root mean square torque, both joints [N m]",
    "variation": "total variation of the torque per second, both joints [N m/s]",
    "saturated_pct": "share of samples in which a joint's torque is at its limit [%]",
    "diverged": "1 where the run diverged, else 0",
    "stay_pct": "error_pct of an arm that stays at its start, for which the score is 0",
}
"""Name and meaning of each metric, in the order of the columns."""


def errors(trace: Trace) -> Array:
    """Return the absolute tracking error [T + 1 x n x 2] rad; diverged runs have the worst."""
    error = np.abs(trace.reference - trace.position)
    return np.where(trace.alive[..., None], np.minimum(error, WORST_ERROR), WORST_ERROR)


def amplitude(trace: Trace) -> Array:
    """Return the reference's largest distance from the arm's start [n x 2] rad.

    It is 1 for a joint that shall stand still.
    """
    size = np.abs(trace.reference - trace.position[0]).max(axis=0)
    return np.where(size > 1e-9, size, 1.0)


def measure(trace: Trace) -> list[dict[str, float]]:
    """Return the metrics of each seed, in the seeds' order.

    A metric that does not apply to the trace is NaN.
    """
    error, size = errors(trace), amplitude(trace)
    alive = trace.alive[..., None]
    count = np.maximum(trace.alive.sum(axis=0), 1)
    torque = np.where(alive, trace.torque, 0.0)
    change = np.abs(np.diff(trace.torque, axis=0)) * (trace.alive[1:] & trace.alive[:-1])[..., None]
    duration = count * trace.scenario.control_dt
    steady = _steady(trace, error) / size
    overshoot, settling = _steps(trace)
    limit = trace.scenario.actuator.torque_limit
    at_limit = np.zeros_like(torque) if limit is None else np.abs(torque) >= np.array(limit) * (1 - 1e-9)
    columns = {
        "error_pct": 100 * (error.mean(axis=0) / size).mean(axis=-1),
        "error_mrad": 1e3 * error.mean(axis=(0, 2)),
        "rms_mrad": 1e3 * np.sqrt((error**2).mean(axis=(0, 2))),
        "max_mrad": 1e3 * error.max(axis=(0, 2)),
        "steady_1_pct": 100 * steady[:, 0],
        "steady_2_pct": 100 * steady[:, 1],
        "overshoot_pct": overshoot,
        "settling_s": settling,
        "torque_rms": np.sqrt((torque**2).sum(axis=(0, 2)) / (2 * count)),
        "variation": change.sum(axis=(0, 2)) / duration,
        "saturated_pct": 100 * at_limit.any(axis=-1).sum(axis=0) / count,
        "diverged": (~trace.alive[-1]).astype(float),
        "stay_pct": 100 * (np.abs(trace.reference - trace.position[0]).mean(axis=0) / size).mean(axis=-1),
    }
    return [{name: float(columns[name][i]) for name in METRICS} for i in range(len(trace.seeds))]


def _steady(trace: Trace, error: Array) -> Array:
    """Return the mean error [n x 2] over the last quarter of each rest of the reference, or NaN."""
    dt = trace.scenario.control_dt
    still = np.abs(np.diff(trace.reference, axis=0)) < 1e-4 * dt
    steady = np.full(error.shape[1:], np.nan)
    for lane in range(error.shape[1]):
        for joint in (0, 1):
            padded = np.concatenate([[False], still[:, lane, joint], [False]]).astype(int)
            begins, ends = np.flatnonzero(np.diff(padded) == 1), np.flatnonzero(np.diff(padded) == -1)
            rests = [(i, j) for i, j in zip(begins, ends, strict=True) if (j - i) * dt > REST - 1e-9]
            last = [error[j - (j - i) // 4 + 1 : j + 1, lane, joint] for i, j in rests]
            if last:
                steady[lane, joint] = np.concatenate(last).mean()
    return steady


def _steps(trace: Trace) -> tuple[Array, Array]:
    """Return the largest overshoot [n] in % of its step and mean settling time [n] s, or NaN."""
    reference = trace.scenario.reference
    n = len(trace.seeds)
    if not isinstance(reference, Steps | FilteredSteps):
        return np.full(n, np.nan), np.full(n, np.nan)
    period = round(reference.period / trace.scenario.control_dt)
    overshoot, settling = np.full(n, np.nan), []
    begin = trace.position[0]
    for first in range(0, len(trace.time) - period, period):
        window = slice(first, first + period)
        target = trace.reference[first + period - 1]
        height = target - begin
        moved = np.abs(height) > 1e-3
        scale = np.where(moved, height, 1.0)
        gone = np.where(trace.alive[window, :, None], (trace.position[window] - begin) / scale, np.inf)
        beyond = np.where(moved, np.maximum(gone.max(axis=0) - 1.0, 0.0), np.nan)
        outside = np.abs(gone - 1.0) > BAND
        last = period - np.argmax(outside[::-1], axis=0)
        times = np.where(outside.any(axis=0), last, 0) * trace.scenario.control_dt
        settling.append(np.where(moved, times, np.nan))
        overshoot = np.fmax(overshoot, np.fmax(beyond[:, 0], beyond[:, 1]))
        begin = target
    worst = np.minimum(100 * overshoot, 1e3)
    if not settling:
        return worst, np.full(n, np.nan)
    stacked = np.stack(settling)
    counts = np.isfinite(stacked).sum(axis=(0, 2))
    return worst, np.where(counts > 0, np.nansum(stacked, axis=(0, 2)) / np.maximum(counts, 1), np.nan)


def summarize(rows: list[dict[str, float]]) -> dict[str, float]:
    """Return the mean of each metric over all seeds; NaN where it applies to none."""
    return {name: _mean([row[name] for row in rows]) for name in METRICS}


def _mean(values: list[float]) -> float:
    known = [x for x in values if not np.isnan(x)]
    return float(np.mean(known)) if known else float("nan")


def describe(summary: dict[str, float]) -> list[tuple[str, str, str]]:
    """Return name, value and meaning of each metric, for a table."""
    return [(name, _format(summary[name]), meaning) for name, meaning in METRICS.items()]


def _format(value: Any) -> str:
    return "-" if np.isnan(value) else f"{value:.4g}"
