"""Traces: stored beside the results for the report's moving arms, or written for other programs."""

import dataclasses
import json
import math
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.files import replacing, write_text
from benchmarks.run.rollout import Trace
from benchmarks.run.store import Store
from benchmarks.run.suite import Cell
from fbl_gym.arm import Array

POINTS = 201
"""Largest number of samples of a stored trace: the start and 200 steps."""

SUFFIX = ".trace1"
"""Ending of a trace's file, with the number of its format."""


def trace_path(cell: Cell, store: Store) -> Path:
    """Return the place of the trace of a cell's first seed; cells that share the seed share it."""
    return store.path(dataclasses.replace(cell, seeds=cell.seeds[:1], metrics=())).with_suffix(SUFFIX)


def save_trace(cell: Cell, trace: Trace, error_pct: float, store: Store) -> None:
    """Write the trace of a cell's first seed with few samples and digits: a page has hundreds."""
    samples = slice(0, None, math.ceil((len(trace.time) - 1) / (POINTS - 1)))
    alive = trace.alive[:, 0]
    signals = {
        "time": trace.time,
        "lengths": trace.lengths[0],
        "reference": trace.reference[:, 0],
        "disturbance": trace.disturbance[:, 0],
        "position": np.where(alive[:, None], trace.position[:, 0], np.nan),
        "torque": np.where(alive[:, None], trace.torque[:, 0], np.nan),
    }
    thinned = {name: _short(signal if name == "lengths" else signal[samples].T) for name, signal in signals.items()}
    diverged = math.nan if alive.all() else trace.time[np.argmin(alive)]
    ends = dict(zip(("error_pct", "diverged"), _short(np.array([error_pct, diverged])), strict=True))
    write_text(trace_path(cell, store), json.dumps({**thinned, **ends}, separators=(",", ":")) + "\n")


def load_trace(cell: Cell, store: Store) -> dict[str, Any]:
    """Return the stored trace of a cell's first seed as plain data, None where it diverged.

    Time and `diverged`, the time at which the run diverged or None, are in s, `lengths` in m.
    `reference`, `position`, `torque` and `disturbance` are [2 x k], in rad and N m.
    """
    path = trace_path(cell, store)
    try:
        trace: dict[str, Any] = json.loads(path.read_text(encoding="utf-8"))
    except ValueError as problem:
        raise ValueError(f"{path} is damaged ({problem}): delete it, and the report writes it again") from None
    return trace


def _short(values: Array) -> Any:
    if values.ndim > 1:
        return [_short(row) for row in values]
    return [float(f"{value:.5g}") if math.isfinite(value) else None for value in values.tolist()]


SIGNALS = {
    "position": "position_rad",
    "velocity": "velocity_rad_s",
    "reference": "reference_rad",
    "torque": "torque_Nm",
    "disturbance": "disturbance_Nm",
    "payload": "payload_kg",
}
"""The name with its unit of each signal in a file."""

FORMATS = (".npz", ".csv", ".mat", ".parquet")


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
        path: a name that ends in one of `FORMATS`. NumPy's and MATLAB's files have `arrays`; CSV
            and Parquet have the `table`.
    """
    with replacing(path) as beside:
        if path.suffix == ".npz":
            np.savez_compressed(beside, **arrays(trace))
        elif path.suffix == ".mat":
            from scipy.io import savemat

            savemat(beside, arrays(trace), do_compression=True)
        else:
            import duckdb
            import pandas as pd

            frame = pd.DataFrame(table(trace))
            if path.suffix == ".csv":
                frame.to_csv(beside, index=False, float_format="%.10g")
            else:
                duckdb.from_df(frame).write_parquet(str(beside))
