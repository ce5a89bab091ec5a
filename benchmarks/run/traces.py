"""Traces: stored beside the results for the report's moving arms, or written for other programs."""

import dataclasses
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.files import replacing
from benchmarks.run.cell import trace_apart
from benchmarks.run.rollout import Trace
from benchmarks.run.store import Store
from benchmarks.run.suite import Cell

_ARRAYS = (
    "time", "position", "velocity", "reference", "torque", "disturbance", "alive", "payload", "lengths", "event_times",
)  # fmt: skip


def trace_of(cell: Cell, store: Store) -> Trace:
    """Return the trace of a cell; run the cell and store its trace if the store lacks it.

    Args:
        cell: Cell, whose policy must not fail.
        store: Store of results and traces.
    """
    path = store.path(cell).with_suffix(".npz")
    if not path.exists():
        trace = dataclasses.replace(trace_apart(cell.policy, cell.scenario, cell.seeds), watched={})
        arrays = {name: getattr(trace, name) for name in _ARRAYS}
        with replacing(path) as beside:
            np.savez_compressed(beside, decision_time=trace.decision_time, **arrays)
    with np.load(path, allow_pickle=False) as file:
        arrays = {name: file[name] for name in _ARRAYS}
        return Trace(scenario=cell.scenario, seeds=cell.seeds, decision_time=float(file["decision_time"]), **arrays)


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
