"""One cell: run it, in this process or in one that no other policy shares, and store its result."""

import contextlib
import time
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from benchmarks.policies import external
from benchmarks.policies.apart import Failed, Limits, call_apart, limits, reason_of
from benchmarks.policies.spec import PolicySpec
from benchmarks.run.contract import broken
from benchmarks.run.metrics import measure
from benchmarks.run.rollout import Trace, rollout, rollout_trials
from benchmarks.run.store import Result, Store, provenance
from benchmarks.run.suite import Cell
from benchmarks.run.traces import save_trace
from fbl_gym import Scenario

BATCH = 1000
"""Largest number of seeds that run at once. It limits the memory of a cell with many seeds."""


@dataclass(frozen=True)
class Outcome:
    """The end of a cell in a run.

    Args:
        id: of the cell.
        done: "computed", "found" (it was in the store), or "failed".
        wall_s: time that it took [s].
        error: why it failed.
    """

    id: str
    done: str
    wall_s: float = 0.0
    error: str = ""


def run_cell(cell: Cell, command: str = "", store: Store | None = None) -> Result:
    """Run one cell in this process and return its result, or its error where the policy fails.

    Args:
        cell: to be run.
        command: the command that was typed, for the record.
        store: for the trace of the first seed; None: it is not stored.
    """
    from threadpoolctl import threadpool_limits

    begin = time.perf_counter()
    rows: list[dict[str, float]] = []
    decisions: list[float] = []
    first_trace: Trace | None = None
    try:
        if cell.policy.problem:
            raise ValueError(cell.policy.problem)
        for first in range(0, len(cell.seeds), BATCH):
            with external.watch() as reads, threadpool_limits(1):
                trace = rollout(cell.policy, cell.scenario, cell.seeds[first : first + BATCH])
            cell.policy.check(reads)
            rows += measure(trace, more=cell.metrics)
            decisions.append(1e6 * trace.decision_time)
            if first == 0 and store is not None:
                first_trace = trace
    except (Exception, SystemExit) as problem:  # an external policy may raise anything, and other cells must not suffer
        return Result.failure(cell, reason_of(problem), time.perf_counter() - begin, command)
    if store is not None and first_trace is not None:
        with contextlib.suppress(OSError):  # the report makes absent traces
            save_trace(cell, first_trace, rows[0]["error_pct"], store)
    decision, wall = float(np.median(decisions)), time.perf_counter() - begin
    return Result(cell, tuple(rows), decision, wall, provenance=provenance(command))


def compute(cell: Cell, store: Store, command: str, workers: int = 1, traced: bool = False) -> Outcome:
    """Run a cell and write its result, and perhaps a trace, into the store, unless it is there.

    With one worker, a built-in policy runs in this process.
    """
    if store.find(cell) is not None:
        return Outcome(cell.id, "found")
    apart = workers > 1 or cell.policy.external or external.has_loaded() or limits() != Limits()
    result = (run_apart if apart else run_cell)(cell, command, store if traced else None)
    store.save(result)
    return Outcome(cell.id, "failed" if result.error else "computed", result.wall_s, result.error)


def run_apart(cell: Cell, command: str = "", store: Store | None = None) -> Result:
    """Run a cell as `run_cell` does, in a process that only its policy uses."""
    begin = time.perf_counter()
    owner = cell.policy.name if cell.policy.external else ""
    try:
        function = "run_checked" if owner else "run_cell"
        store = store and Store(store.folder.absolute())  # a policy may change the folder of its process
        result: Result = call_apart(owner, f"benchmarks.run.cell:{function}", cell, command, store)
    except (Failed, ValueError) as problem:
        return Result.failure(cell, str(problem), time.perf_counter() - begin, command)
    return result


def trace_apart(policy: PolicySpec, scenario: Scenario, seeds: Sequence[int]) -> Trace:
    """Return the trace of `rollout`; that of an external policy from a process of its own."""
    return trials_apart(policy, scenario, seeds, 1)[0]


def trials_apart(policy: PolicySpec, scenario: Scenario, seeds: Sequence[int], trials: int) -> list[Trace]:
    """Return the traces of `rollout_trials`, as `trace_apart` does."""
    if not (policy.external or external.has_loaded()):
        return rollout_trials(policy, scenario, seeds, trials)
    owner = policy.name if policy.external else ""
    traces: list[Trace] = call_apart(
        owner, "benchmarks.run.rollout:rollout_trials", policy, scenario, tuple(seeds), trials
    )
    return traces


def run_checked(cell: Cell, command: str, store: Store | None) -> Result:
    """Run a cell of an external policy, unless the policy breaks a promise on its scenario."""
    if not cell.policy.problem and (reason := broken(cell.policy, cell.scenario)):
        return Result.failure(cell, reason, command=command)
    return run_cell(cell, command, store)
