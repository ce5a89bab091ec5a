"""Runs one cell, and the cells that a store lacks, in processes of this machine.

A finished cell is in the store, which this process alone writes.
"""

import contextlib
import functools
from collections.abc import Iterator, Sequence
from typing import Any

from threadpoolctl import threadpool_limits

from benchmarks.policies.isolation import CallLimits, Failed, run_parallel
from benchmarks.policies.spec import PolicySpec
from benchmarks.policies.watch import Watch
from benchmarks.run.cell import Cell
from benchmarks.run.contract import broken
from benchmarks.run.linearize import ARMS, has_margins, margin_metrics
from benchmarks.run.metrics import measure
from benchmarks.run.rollout import Trace, rollout_trials
from benchmarks.run.store import Result, Store, provenance
from benchmarks.text import reason_of
from fbl_gym import Scenario


def run(
    cells: Sequence[Cell], store: Store, *, workers: int = 1, command: str = "", limits: CallLimits | None = None
) -> Iterator[tuple[str, Result]]:  # fmt: skip
    """Run the cells that the store lacks, in any order, and yield each result with its origin.

    The origin is "computed", "found" (it was in the store), or "failed".

    Args:
        cells: all cells that the store shall have.
        store: for the results.
        workers: number of processes.
        command: the command that was typed, for the record.
        limits: of the time and memory of a cell; None: those of external policies.
    """
    stored = [(cell, store.find(cell)) for cell in cells]
    yield from (("found", result) for _, result in stored if result is not None)
    absent = [cell for cell, result in stored if result is None]
    work = functools.partial(run_cell, command=command, limits=limits)
    for cell, answer in run_parallel(work, absent, min(workers, len(absent))):
        result = Result.failure(cell, str(answer), command) if isinstance(answer, Failed) else answer
        store.save(result)
        yield "failed" if result.error else "computed", result


def run_cell(cell: Cell, command: str = "", limits: CallLimits | None = None) -> Result:
    """Run one cell and return its result, or its error where the policy fails.

    Code of an external policy runs in a fresh process, and its trace is measured in this one.

    Args:
        cell: to be run.
        command: the command that was typed, for the record.
        limits: of the time and memory of a cell; None: those of external policies.
    """
    try:
        if cell.policy.problem:
            raise ValueError(cell.policy.problem)
        (trace,) = run_trials(cell.policy, cell.scenario, cell.seeds, 1, limits, check=True)
        rows = measure(trace)
        if has_margins(cell.policy, cell.scenario, cell.seeds):
            # The code of an external policy may fail there: then its result has no margins.
            with contextlib.suppress(*((Exception, SystemExit) if cell.policy.external else ())):
                few = cell.policy, cell.scenario, cell.seeds[:ARMS]
                for row, margins in zip(rows, cell.policy.call(margin_metrics, *few, limits=limits), strict=False):
                    row |= margins
    except (Exception, SystemExit) as problem:  # a policy may raise anything, and other cells must not suffer
        error = str(problem) if isinstance(problem, Failed) else reason_of(problem)
        return Result.failure(cell, error, command)
    return Result(cell, tuple(rows), 1e6 * trace.decision_time, provenance=provenance(command, cell.packages))


def run_trials(
    policy: PolicySpec, scenario: Scenario, seeds: Sequence[int], trials: int = 1, limits: CallLimits | None = None, *,
    check: bool = False, detailed: bool = False,
) -> list[Trace]:  # fmt: skip
    """Return the traces of `rollout_trials`; code of an external policy runs in a fresh process.

    Args:
        policy: to be run.
        scenario: the task.
        seeds: a lane each.
        trials: in a row.
        limits: of time and memory.
        check: an external policy must keep its promises on the scenario first.
        detailed: the traces have their `details`.
    """
    arguments = policy, scenario, tuple(seeds), trials, check and policy.external, detailed
    return [Trace(scenario=scenario, **signals) for signals in policy.call(_traces, *arguments, limits=limits)]


def _traces(
    policy: PolicySpec, scenario: Scenario, seeds: Sequence[int], trials: int, check: bool, detailed: bool
) -> list[dict[str, Any]]:
    """Return the fields of each trial's trace, but the scenario."""
    with threadpool_limits(1):
        if check and (reason := broken(policy, scenario)):
            raise Failed(reason)
        with Watch(policy) as seen:
            traces = [*map(vars, rollout_trials(policy, scenario, seeds, trials, detailed=detailed))]
        if check and seen.seen:
            raise Failed("; ".join(seen.seen))
        return [{name: signal for name, signal in trace.items() if name != "scenario"} for trace in traces]
