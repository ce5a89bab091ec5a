"""`fbl-gym recommend`."""

from __future__ import annotations

import argparse
import dataclasses
import json
import math
import os
from collections.abc import Sequence
from pathlib import Path

from rich.box import SIMPLE_HEAD
from rich.table import Table

from benchmarks.analysis import recommend
from benchmarks.analysis.recommend import RULE, WITHIN, Recommendation
from benchmarks.analysis.statistics import proportion
from benchmarks.cli.common import add_store, add_trust, command_line, console, count, episodes, policy_name, trust
from benchmarks.policies.spec import resolve_apart
from benchmarks.run.runner import run as run_cells
from benchmarks.run.store import Result, Store
from benchmarks.run.suite import Cell
from benchmarks.tuning.search import Task, judge, seeds, summary, tune, write_gains
from controllers.registry import tuned_gains
from fbl_gym.scenarios import Scenario, as_scenario


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the arguments of the command."""
    parser.add_argument(
        "scenario", nargs="?", default="hardware-nominal", metavar="SCENARIO",
        help="a scenario with your arm: a name or a TOML file (hardware-nominal)",
    )  # fmt: skip
    parser.add_argument(
        "--policies", nargs="+", type=policy_name, metavar="POLICY",
        help="to choose from (the laws, with tuned gains where there are some, and the agents)",
    )  # fmt: skip
    parser.add_argument("--seeds", type=episodes, default=16, metavar="N", help="test seeds 0 to N-1 (16)")
    parser.add_argument(
        "--trials", type=count, metavar="N", help="retune the three best for this arm, with so many trials each"
    )
    parser.add_argument(
        "--check", type=count, metavar="N", help="check the first choice on so many drawn arms in mujoco-lab instead"
    )
    parser.add_argument("--json", action="store_true", help="print JSON")
    parser.add_argument(
        "--storage", type=Path, default=Path("results/recommend"), metavar="DIR",
        help="folder of the studies and gains of --trials (results/recommend)",
    )  # fmt: skip
    parser.add_argument(
        "--workers", type=count, default=os.cpu_count() or 1, metavar="N", help="processes (one per core)"
    )
    add_trust(parser)
    add_store(parser)


def run(arguments: argparse.Namespace) -> int:
    """Run the command and return its exit status: 1 if no policy is safe."""
    if arguments.seeds < 2:
        raise ValueError(f"--seeds must be at least 2 for an interval, got {arguments.seeds}")
    trust(arguments, *(arguments.policies or ()))
    store, command = Store(arguments.store), command_line()
    policies = arguments.policies or recommend.candidates()

    def run_all(cells: Sequence[Cell]) -> dict[str, Result]:
        errors = {}
        for outcome in run_cells(cells, store, workers=arguments.workers, command=command):
            if outcome.error:
                errors[outcome.id] = outcome.error
        return {
            cell.id: store.find(cell) or Result(cell, (), math.nan, 0.0, errors.get(cell.id, "no result"))
            for cell in cells
        }

    if arguments.check:
        return _check(arguments, policies, run_all)
    base = as_scenario(arguments.scenario)
    result = recommend.recommend(base, policies, arguments.seeds, run_all)
    if arguments.trials:
        best = [choice.policy for choice in result.choices]
        retuned = [_retune(name, base, arguments.trials, arguments.storage, command) for name in best]
        result = recommend.recommend(base, [*best, *retuned], arguments.seeds, run_all)
    if arguments.json:
        print(json.dumps({**dataclasses.asdict(result), "safe": result.safe, "rule": RULE}, indent=1))
    else:
        _print(result)
    return 0 if result.safe else 1


def _retune(policy: str, base: Scenario, trials: int, folder: Path, command: str) -> str:
    """Tune a policy on practice motions of an arm, and return its text with the gains."""
    name = policy.removesuffix("@tuned")
    calm = recommend.practice(base)
    tasks = calm, recommend.around(calm)["everything"]
    tried, fresh = seeds(8, 32)
    task = Task(resolve_apart(name), tasks, tried)
    judging = dataclasses.replace(task, seeds=fresh)
    given = tuned_gains(policy) if policy.endswith("@tuned") else {}
    also = {gain: min(max(given[gain], low), high) for gain, (low, high) in task.ranges.items() if gain in given}
    study = tune(task, trials, folder, also)
    best = summary(task, study, judging, judge(judging, study, 3), command)
    return f"{name}@{write_gains(best, folder / task.digest)}" if best["gains"] else name


def _print(result: Recommendation) -> None:
    screen = console()
    if not result.safe:
        screen.print(f"No policy is safe on {result.scenario}. The best of those that are not:", style="bold")
    table = Table(title=f"{result.scenario}, {len(result.conditions)} conditions", title_style="bold", box=SIMPLE_HEAD)
    for name in ("policy", "error", "worst 5 %", "diverged (bound)", "delay margin", "effort"):
        table.add_column(name, justify="left" if name == "policy" else "right", overflow="fold")
    for choice in result.choices:
        margin = choice.delay_margin_s
        table.add_row(
            choice.policy,
            f"{choice.median_pct:.3g} %",
            f"{choice.worst_pct:.3g} %",
            f"{choice.diverged} of {choice.runs} (< {100 * choice.diverged_bound:.1f} %)",
            "-" if margin is None else f"{1e3 * margin:.1f} ms",
            f"{choice.effort:.2f}",
        )
    screen.print(table)
    screen.print(f"conditions: {', '.join(result.conditions)}")
    first = result.choices[0].policy
    for condition, (policy, error, reference) in result.overturned.items():
        screen.print(f"{condition}: {policy} is better, {error:.3g} % against {reference:.3g} % of {first}")
    for policy, reason in result.failed.items():
        screen.print(f"without {policy}, which failed: {reason}", markup=False)
    screen.print(f"{RULE}.\nerror: median of the runs of all conditions. delay margin: with exact sensors.")


def _check(arguments: argparse.Namespace, policies: Sequence[str], run_all: recommend.Run) -> int:
    """Print the check of each drawn arm, and the share of good first choices."""
    rows = []
    for row in recommend.check(arguments.check, policies, arguments.seeds, run_all):
        rows.append(row)
        if not arguments.json:
            choice = f"{row.choice}: {row.ratio:.2f} x, {row.diverged} diverged" if row.choice else "none is safe"
            print(f"{row.scenario}: {choice}; best in mujoco-lab: {row.best}", flush=True)
    chosen = [row for row in rows if row.choice]
    good = sum(row.ratio <= WITHIN for row in chosen)
    if arguments.json:
        print(json.dumps([dataclasses.asdict(row) for row in rows], indent=1))
    elif chosen:
        share = proportion(good, len(chosen))
        print(
            f"{good} of {len(chosen)} first choices within {WITHIN:g} times the best ({100 * share.low:.0f} to "
            f"{100 * share.high:.0f} %); none was safe on {len(rows) - len(chosen)} arms"
        )
    return 0
