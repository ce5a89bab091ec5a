"""The stored results that the present code would give again; `fbl-gym query` asks for them."""

import json
from collections.abc import Iterator, Sequence

from benchmarks.policies.spec import PolicySpec, is_unchanged
from benchmarks.run.store import Result
from benchmarks.run.suite import plain_options
from fbl_gym import Scenario, scenarios


def current_keys(results: Sequence[Result]) -> set[str]:
    """Return the keys of the current results."""
    unchanged: dict[PolicySpec, bool] = {}
    for result in results:
        policy = result.cell.policy
        if policy not in unchanged:
            unchanged[policy] = is_unchanged(policy)
    metrics = {metric: metric.unchanged for metric in {metric for r in results for metric in r.cell.metrics}}
    return {
        r.cell.key for r in results
        if r.rows and unchanged[r.cell.policy] and _is_known(r.cell.scenario) and all(map(metrics.get, r.cell.metrics))
    }  # fmt: skip


def _is_known(scenario: Scenario) -> bool:
    """Return True unless a scenario has a built-in name and other options than the built-in one."""
    return scenario.name not in scenarios.names() or _options(scenarios.get(scenario.name)) == _options(scenario)


def _options(scenario: Scenario) -> str:
    return json.dumps(plain_options(scenario, "description"), sort_keys=True)


def current_runs(results: Sequence[Result]) -> Iterator[tuple[Result, int]]:
    """Yield each run of the current results once: a result, and the index of a seed in it."""
    keys = current_keys(results)
    seen: set[tuple[str, str, int]] = set()
    # Suites of different sizes share seeds; a result with external metrics has more columns.
    for result in sorted(results, key=lambda result: (-len(result.cell.metrics), -len(result.rows))):
        if result.cell.key in keys:
            scenario = _options(result.cell.scenario)
            for i, seed in enumerate(result.cell.seeds):
                run = result.cell.policy.name, scenario, seed
                if run not in seen:
                    seen.add(run)
                    yield result, i
