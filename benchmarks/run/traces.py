"""Traces, written for other programs as CSV."""

from pathlib import Path

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


def _column(name: str, place: tuple[int, ...]) -> str:
    """Return the name of a column: the signal, the place of a number in it from 1, the unit."""
    return "_".join([name, *(str(i + 1) for i in place), *([UNITS[name]] if name in UNITS else [])])


def table(trace: Trace) -> dict[str, Array]:
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
            columns[_column(name, place)] = signal[:, :, *place].T.ravel()
    return columns


def export(trace: Trace, path: Path) -> None:
    """Write the `table` of a trace to a CSV file; a number that there is not is "nan".

    Args:
        trace: to be written.
        path: of the file.
    """
    columns = table(trace)
    rows = np.column_stack(list(columns.values()))
    with replacing(path) as beside:
        np.savetxt(beside, rows, "%.10g", delimiter=",", header=",".join(columns), comments="")
