"""Metrics of a trace, one row for each seed: pure functions.

A diverged run counts: from the sample at which it ended on, the error of both joints is half a
turn, the largest error of any sample. No policy gains by diverging.
"""

import itertools
import tomllib
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from benchmarks.run.rollout import Trace
from fbl_gym.model.arm import Array
from fbl_gym.options import FilteredSteps, Steps

#: Largest error of a joint [rad]; a joint whose run has diverged has it too.
WORST_ERROR = np.pi

#: A reference rests when it stands still at least this long [s].
#:
#: The steady-state error is that of the last quarter of each rest.
REST = 0.2

#: A step has settled when the joint stays within this share of the step.
BAND = 0.02

#: Counts of an ideal sensor, as if it were a very good encoder: the resolution is never 0.
FINEST = 2.0**20

#: An event's level before is the largest error of the last LOOK_BACK seconds. The error is back
#: when it stays near that level for HOLD seconds.
LOOK_BACK, HOLD = 1.0, 0.5

#: Near is within NEAR times the level before, which is at least LEAST_LEVEL [rad].
NEAR, LEAST_LEVEL = 1.5, 1e-3

#: Name and meaning of each metric, in the order of the columns.
METRICS: dict[str, str] = tomllib.loads(Path(__file__).with_suffix(".toml").read_text(encoding="utf-8"))

#: The metrics that are of the linearised loop and not of a trace.
MARGINS = ("phase_deg", "delay_samples", "gain_margin", "sensitivity")


def errors(trace: Trace) -> Array:
    """Return the absolute tracking error [T + 1 x n x 2] rad; diverged runs have the worst."""
    error = np.abs(trace.reference - trace.position)
    return np.where(trace.alive[..., None], np.minimum(error, WORST_ERROR), WORST_ERROR)


def amplitude(trace: Trace) -> Array:
    """Return half the range of the reference, (largest - smallest) / 2 [n x 2] rad.

    All errors in % are shares of it. It is 1 for a joint that shall stand still.
    """
    return _or_one(np.ptp(trace.reference, axis=0) / 2)


def departure(trace: Trace) -> Array:
    """Return the reference's largest distance from the arm's start [n x 2] rad: the size of a step.

    It is 1 for a joint that shall stand still. The paper's errors are shares of it.
    """
    return _or_one(np.abs(trace.reference - trace.position[0]).max(axis=0))


def _or_one(size: Array) -> Array:
    return np.where(size > 1e-9, size, 1.0)


def measure(trace: Trace, size: Array | None = None) -> list[dict[str, float]]:
    """Return the metrics of each seed, in the seeds' order.

    A metric that does not apply to the trace is NaN.

    Args:
        trace: of a rollout.
        size: 100 % of an error [n x 2] rad; left out: the `amplitude`.
    """
    error, size = errors(trace), amplitude(trace) if size is None else size
    alive = trace.alive[..., None]
    dt, mean_error = trace.scenario.control_dt, error.mean(axis=-1)
    count = np.maximum(trace.alive.sum(axis=0), 1)
    torque = np.where(alive, trace.torque, 0.0)
    change = np.abs(np.diff(trace.torque, axis=0)) * (trace.alive[1:] & trace.alive[:-1])[..., None]
    steady = _steady(trace, error) / size
    overshoot, settling, rise = _steps(trace)
    area, back, unrecovered = _recovery(trace, mean_error)
    limit = np.inf if trace.scenario.actuator.torque_limit is None else np.array(trace.scenario.actuator.torque_limit)
    at_limit = alive & (limit > 0) & (np.abs(trace.command) >= limit * (1 - 1e-9))
    none, constraints = np.full(len(trace.seeds), np.nan), trace.scenario.constraints
    beyond = ~trace.alive | (constraints is not None and constraints.violated(trace.position, trace.velocity))
    encoder = trace.scenario.encoder
    counts = np.array(FINEST if encoder is None or encoder.counts is None else encoder.counts)
    columns: dict[str, Array] = {
        "error_pct": 100 * (error.mean(axis=0) / size).mean(axis=-1),
        "error_mrad": 1e3 * mean_error.mean(axis=0),
        "rms_mrad": 1e3 * np.sqrt((error**2).mean(axis=(0, 2))),
        "max_mrad": 1e3 * error.max(axis=(0, 2)),
        "iae": dt * mean_error[1:].sum(axis=0),
        "itae": dt * trace.time[1:] @ mean_error[1:],
        "ise": dt * (error[1:] ** 2).mean(axis=-1).sum(axis=0),
        "steady_1_pct": 100 * steady[:, 0],
        "steady_2_pct": 100 * steady[:, 1],
        "overshoot_pct": overshoot,
        "settling_s": settling,
        "rise_s": rise,
        "energy_J": np.abs(np.diff(trace.position, axis=0) * torque[1:]).sum(axis=(0, 2), where=alive[1:]),
        "torque_rms": np.sqrt((torque**2).sum(axis=(0, 2)) / (2 * count)),
        "variation": change.sum(axis=(0, 2)) / (count * dt),
        "saturated_pct": 100 * at_limit.any(axis=-1).sum(axis=0) / count,
        "violation_pct": none if constraints is None else 100 * beyond[1:].mean(axis=0),
        "recovery_rad_s": area,
        "recovery_s": back,
        "unrecovered_pct": 100 * unrecovered,
        **dict.fromkeys(MARGINS, none),
        "diverged": (~trace.alive[-1]).astype(float),
        "baseline_error_pct": 100 * (np.abs(trace.reference - trace.position[0]).mean(axis=0) / size).mean(axis=-1),
        "resolution_pct": 100 * (2 * np.pi / counts / size).mean(axis=-1),
    }
    return [{name: float(column[i]) for name, column in columns.items()} for i in range(len(trace.seeds))]


def counted_errors(rows: Sequence[dict[str, float]]) -> list[float]:
    """Return the error of each run [%] on the board; see `counted_error`."""
    return [float(counted_error(row)) for row in rows]


def counted_error(metrics: Mapping[str, Any]) -> Any:
    """Return the error [%] that a board counts: at least the encoder's resolution.

    The metrics are numbers or arrays, by name.
    """
    return np.maximum(metrics["error_pct"], metrics["resolution_pct"])


def penalize(errors: ArrayLike, diverged: ArrayLike) -> Array:
    """Return the errors of some runs, times 2^100 where a run diverged.

    The geometric mean of the runs is the penalized error, which ranks: each percent of lost runs
    doubles it. `diverged` is 1 where a run diverged, else 0.
    """
    return np.asarray(errors) * 2.0 ** (100 * np.asarray(diverged))


def _recovery(trace: Trace, error: Array) -> Array:
    """Return area, time back and unrecovered share of each run's events [3 x n].

    They are NaN for a run without events, or that diverged.
    """
    dt, last = trace.scenario.control_dt, len(trace.time) - 1
    hold = max(round(HOLD / dt), 1)
    results = np.full((3, len(trace.seeds)), np.nan)
    for lane in np.flatnonzero(trace.alive[-1]) if trace.event_times.size else ():
        times = trace.event_times[lane] / dt + 1e-6
        starts = np.unique(np.floor(times[times < last]).astype(int))
        events = []
        for begin, end in itertools.pairwise([*starts, last]):
            first = max(begin - round(LOOK_BACK / dt), 0)
            level = max(error[first : begin + 1, lane].max(), LEAST_LEVEL)
            after = error[begin + 1 : end + 1, lane]
            near = np.convolve(after <= NEAR * level, np.ones(hold))[hold - 1 : len(after)]  # next `hold` samples
            backs = np.flatnonzero(near > hold - 0.5)
            time = backs[0] if backs.size else len(after)
            events.append((dt * np.maximum(after - level, 0.0).sum(), dt * time, not backs.size))
        if events:
            results[:, lane] = np.mean(events, axis=0)
    return results


def _steady(trace: Trace, error: Array) -> Array:
    """Return the mean error [n x 2] over the last quarter of each rest of the reference, or NaN."""
    dt = trace.scenario.control_dt
    still = np.abs(np.diff(trace.reference, axis=0)) < 1e-4 * dt
    steady = np.full(error.shape[1:], np.nan)
    for lane in range(error.shape[1]):
        for joint in (0, 1):
            edges = np.flatnonzero(np.diff(still[:, lane, joint], prepend=False, append=False))
            rests = [(i, j) for i, j in edges.reshape(-1, 2) if (j - i) * dt > REST - 1e-9]
            if last := [error[j - (j - i) // 4 + 1 : j + 1, lane, joint] for i, j in rests]:
                steady[lane, joint] = np.concatenate(last).mean()
    return steady


def _steps(trace: Trace) -> Array:
    """Return the largest overshoot in % of its step, mean settling and rise time [3 x n], or NaN.

    The times are in s.
    """
    reference, dt = trace.scenario.reference, trace.scenario.control_dt
    time = reference.period / dt if isinstance(reference, Steps | FilteredSteps) else len(trace.time)
    period = int(time + 1e-9)
    starts = np.ceil(time * np.arange(len(trace.time) // max(period, 1)) - 1e-6).astype(int)
    starts = starts[starts < len(trace.time) - period]
    if not starts.size:
        return np.full((3, len(trace.seeds)), np.nan)
    # Arrays of all steps, [steps x samples x n x 2] and without the samples.
    samples = starts[:, None] + np.arange(period)
    targets, alive = trace.reference[starts + period - 1], trace.alive[samples][..., None]
    begins = np.concatenate([trace.position[:1], targets[:-1]])
    moved = np.abs(targets - begins) > 1e-3
    scale = np.where(moved, targets - begins, 1.0)
    gone = np.where(alive, (trace.position[samples] - begins[:, None]) / scale[:, None], np.inf)
    overshoot = np.fmax.reduce(np.where(moved, np.maximum(gone.max(axis=1) - 1.0, 0.0), np.nan), axis=(0, 2))
    outside, high = np.abs(gone - 1.0) > BAND, (gone >= 0.9) & alive
    settling = np.where(outside.any(axis=1), period - np.argmax(outside[:, ::-1], axis=1), 0)
    rise = np.where(high.any(axis=1), np.argmax(high, axis=1) - np.argmax(gone >= 0.1, axis=1), period)
    times = np.where(moved[:, None], dt * np.stack([settling, rise], axis=1), np.nan)
    counts = np.isfinite(times).sum(axis=(0, 3))
    means = np.where(counts > 0, np.nansum(times, axis=(0, 3)) / np.maximum(counts, 1), np.nan)
    return np.stack([np.minimum(100 * overshoot, 1e3), *means])
