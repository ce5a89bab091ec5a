"""One cell: run it, in this process or in one that no other policy shares, and store its result."""

import time
from collections.abc import Sequence
from dataclasses import dataclass

from benchmarks.policies import external
from benchmarks.policies.apart import Failed, Limits, call_apart, limits, reason_of
from benchmarks.policies.spec import PolicySpec
from benchmarks.run.contract import broken
from benchmarks.run.metrics import measure
from benchmarks.run.rollout import Trace, rollout, rollout_trials
from benchmarks.run.store import Result, Store, provenance
from benchmarks.run.suite import Cell
from fbl_gym import Scenario


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


def run_cell(cell: Cell, command: str = "") -> Result:
    """Run one cell in this process and return its result, or its error where the policy fails.

    `command` is the command that was typed, for the record.
    """
    from threadpoolctl import threadpool_limits

    begin = time.perf_counter()
    try:
        if cell.policy.problem:
            raise ValueError(cell.policy.problem)
        with external.watch() as reads, threadpool_limits(1):
            trace = rollout(cell.policy, cell.scenario, cell.seeds)
        cell.policy.check(reads)
        rows, decision = tuple(measure(trace, more=cell.metrics)), 1e6 * trace.decision_time
    except (Exception, SystemExit) as problem:  # an external policy may raise anything, and other cells must not suffer
        return Result.failure(cell, reason_of(problem), time.perf_counter() - begin, command)
    return Result(cell, rows, decision, time.perf_counter() - begin, provenance=provenance(command))


def compute(cell: Cell, store: Store, command: str, workers: int = 1) -> Outcome:
    """Run a cell and write its result into the store, unless it is there.

    With one worker, a built-in policy runs in this process.
    """
    if store.find(cell) is not None:
        return Outcome(cell.id, "found")
    apart = workers > 1 or cell.policy.external or external.has_loaded() or limits() != Limits()
    result = run_apart(cell, command) if apart else run_cell(cell, command)
    store.save(result)
    return Outcome(cell.id, "failed" if result.error else "computed", result.wall_s, result.error)


def run_apart(cell: Cell, command: str = "") -> Result:
    """Run a cell as `run_cell` does, in a process that only its policy uses."""
    begin = time.perf_counter()
    owner = cell.policy.name if cell.policy.external else ""
    try:
        function = "run_checked" if owner else "run_cell"
        result: Result = call_apart(owner, f"benchmarks.run.cell:{function}", cell, command)
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


def run_checked(cell: Cell, command: str) -> Result:
    """Run a cell of an external policy, unless the policy breaks a promise on its scenario."""
    if not cell.policy.problem and (reason := broken(cell.policy, cell.scenario)):
        return Result.failure(cell, reason, command=command)
    return run_cell(cell, command)
