"""One cell: run it, in this process or a fresh one, and return its result."""

from collections.abc import Sequence
from typing import Any

from threadpoolctl import threadpool_limits

from benchmarks.policies.isolation import CallLimits, Failed
from benchmarks.policies.spec import PolicySpec
from benchmarks.run.contract import broken, watch
from benchmarks.run.metrics import measure
from benchmarks.run.rollout import Trace, rollout_trials
from benchmarks.run.store import Result, provenance
from benchmarks.run.suite import Cell
from benchmarks.text import reason_of
from fbl_gym import Scenario


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
    return [Trace(scenario=scenario, **signals) for signals in policy.call(_run, *arguments, limits=limits)]


def _run(
    policy: PolicySpec, scenario: Scenario, seeds: Sequence[int], trials: int, check: bool, detailed: bool
) -> list[dict[str, Any]]:
    """Return the fields of each trial's trace, but the scenario."""
    with threadpool_limits(1):
        if check and (reason := broken(policy, scenario)):
            raise Failed(reason)
        with watch(policy) as seen:
            traces = [*map(vars, rollout_trials(policy, scenario, seeds, trials, detailed=detailed))]
        if check and seen.seen:
            raise Failed("; ".join(seen.seen))
        return [{name: signal for name, signal in trace.items() if name != "scenario"} for trace in traces]
