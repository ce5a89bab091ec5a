"""Traces, written for other programs as CSV or for MATLAB."""

from collections.abc import Mapping
from pathlib import Path

import numpy as np
from scipy.io import savemat

from benchmarks.files import replacing
from benchmarks.run.rollout import Trace
from fbl_gym.model.arm import Array

#: The unit of each signal in a file, at the end of its name. A policy's state has none.
UNITS = {
    "position": "rad", "velocity": "rad_s", "reference": "rad", "command": "Nm", "torque": "Nm", "disturbance": "Nm",
    "payload": "kg", "measured_position": "rad", "measured_velocity": "rad_s", "measured_acceleration": "rad_s2",
    "motor_position": "rad", "motor_velocity": "rad_s",
}  # fmt: skip


def table(trace: Trace) -> dict[str, Array]:
    """Return a trace as columns of a table, with a row for each seed and sample.

    The columns of joint 1 are named such as "position_1_rad". From the sample at which a run
    diverged on, all but the reference are NaN.

    Args:
        trace: to be written, perhaps with its `details`.
    """
    samples, lanes = trace.alive.shape
    columns = {
        "seed": np.repeat(np.array(trace.seeds), samples),
        "time_s": np.tile(trace.time, lanes),
        "alive": trace.alive.T.ravel(),
    }
    signals = {name: getattr(trace, name) for name in UNITS if hasattr(trace, name)} | trace.details
    for name, signal in signals.items():
        for place in np.ndindex(signal.shape[2:]):
            column = "_".join([name, *(str(i + 1) for i in place), *([UNITS[name]] if name in UNITS else [])])
            numbers = signal[:, :, *place]
            columns[column] = (numbers if name == "reference" else np.where(trace.alive, numbers, np.nan)).T.ravel()
    return columns


def export(trace: Trace, path: Path) -> None:
    """Write the `table` of a trace to a CSV file, or to a .mat file with a variable per column."""
    if path.suffix == ".mat":
        with replacing(path) as beside:
            savemat(beside, table(trace), oned_as="column")
    else:
        write_columns(path, table(trace))


def write_columns(path: Path, columns: Mapping[str, Array]) -> None:
    """Write columns [n], by name, to a CSV file; a number that there is not is "nan"."""
    rows = np.column_stack(list(columns.values()))
    with replacing(path) as beside:
        np.savetxt(beside, rows, "%.10g", delimiter=",", header=",".join(columns), comments="")
