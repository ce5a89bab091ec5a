"""Traces, written for other programs."""

import csv
import math
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.files import replacing
from benchmarks.run.rollout import Trace
from fbl_gym.model.arm import Array

UNITS = {
    "position": "rad",
    "velocity": "rad_s",
    "reference": "rad",
    "command": "Nm",
    "torque": "Nm",
    "disturbance": "Nm",
    "payload": "kg",
    "measured_position": "rad",
    "measured_velocity": "rad_s",
    "measured_acceleration": "rad_s2",
    "motor_position": "rad",
    "motor_velocity": "rad_s",
}
"""The unit of each signal in a file, at the end of its name. A policy's state has none."""

FORMATS = (".npz", ".csv")


def signals(trace: Trace) -> dict[str, Array]:
    """Return the signals of a trace, [T + 1 x n x ...], by name, and then its `details`.

    From the sample at which a run diverged on, all but the reference are NaN.

    Args:
        trace: with T steps of n seeds.
    """
    named = {name: getattr(trace, name) for name in UNITS if hasattr(trace, name)} | trace.details
    for name, signal in named.items():
        alive = trace.alive.reshape(trace.alive.shape + (1,) * (signal.ndim - 2))
        named[name] = signal if name == "reference" else np.where(alive, signal, np.nan)
    return named


def arrays(trace: Trace) -> dict[str, Any]:
    """Return the `signals` of a trace by their names in a file, such as "position_rad"."""
    named = {_column(name): signal for name, signal in signals(trace).items()}
    return {"time_s": trace.time, "seed": np.array(trace.seeds), "alive": trace.alive} | named


def _column(name: str, *indices: int) -> str:
    """Return the name of a signal in a file, with the place of a number in it, counted from 1."""
    return "_".join([name, *(str(i + 1) for i in indices), *([UNITS[name]] if name in UNITS else [])])


def table(trace: Trace) -> dict[str, Any]:
    """Return a trace as columns of a table, with a row for each seed and sample.

    The columns of joint 1 are named such as "position_1_rad".

    Args:
        trace: to be written.
    """
    samples, lanes = trace.alive.shape
    columns = {
        "seed": np.repeat(np.array(trace.seeds), samples),
        "time_s": np.tile(trace.time, lanes),
        "alive": trace.alive.T.ravel(),
    }
    for name, signal in signals(trace).items():
        for place in np.ndindex(signal.shape[2:]):
            columns[_column(name, *place)] = signal[:, :, *place].T.ravel()
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
