"""Traces of cells, stored beside the results: the source of the report's moving arms."""

from __future__ import annotations

import dataclasses

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
