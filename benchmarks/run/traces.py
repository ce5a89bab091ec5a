"""Traces, written for other programs."""

import csv
import math
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.files import replacing
from benchmarks.run.rollout import Trace

SIGNALS = {
    "position": "position_rad",
    "velocity": "velocity_rad_s",
    "reference": "reference_rad",
    "torque": "torque_Nm",
    "disturbance": "disturbance_Nm",
    "payload": "payload_kg",
}
"""The name with its unit of each signal in a file."""

FORMATS = (".npz", ".csv")


def arrays(trace: Trace) -> dict[str, Any]:
    """Return the signals of a trace, [T + 1 x n x 2] or [T + 1 x n], by their names in a file.

    From the sample at which a run diverged on, all but the reference are NaN.

    Args:
        trace: with T steps of n seeds.
    """
    signals: dict[str, Any] = {"time_s": trace.time, "seed": np.array(trace.seeds), "alive": trace.alive}
    for name, column in SIGNALS.items():
        signal = getattr(trace, name)
        alive = trace.alive.reshape(trace.alive.shape + (1,) * (signal.ndim - 2))
        signals[column] = signal if name == "reference" else np.where(alive, signal, np.nan)
    return signals


def table(trace: Trace) -> dict[str, Any]:
    """Return a trace as columns of a table, with a row for each seed and sample.

    The columns of joint 1 are named such as "position_1_rad".

    Args:
        trace: to be written.
    """
    signals = arrays(trace)
    samples, lanes = trace.alive.shape
    columns = {
        "seed": np.repeat(signals.pop("seed"), samples),
        "time_s": np.tile(signals.pop("time_s"), lanes),
        "alive": signals.pop("alive").T.ravel(),
    }
    for name, signal in signals.items():
        if signal.ndim == 2:
            columns[name] = signal.T.ravel()
        for joint in (0, 1) if signal.ndim == 3 else ():
            columns[name.replace("_", f"_{joint + 1}_", 1)] = signal[..., joint].T.ravel()
    return columns


def export(trace: Trace, path: Path) -> None:
    """Write a trace to a file.

    Args:
        trace: to be written.
        path: a name that ends in one of `FORMATS`. NumPy's file has `arrays`, CSV the `table`.
    """
    with replacing(path) as beside:
        if path.suffix == ".npz":
            np.savez_compressed(beside, **arrays(trace))
        else:
            columns = table(trace)
            rows = zip(*(column.tolist() for column in columns.values()), strict=True)
            with beside.open("w", encoding="utf-8", newline="") as file:
                csv.writer(file, lineterminator="\n").writerows([columns, *(map(_field, row) for row in rows)])


def _field(value: Any) -> Any:
    """Return a field of a CSV file; one without a value is empty."""
    if not isinstance(value, float):
        return value
    return "" if math.isnan(value) else f"{value:.10g}"
