"""`fbl-gym recommend`."""

import argparse
import dataclasses
import json
from collections.abc import Sequence
from functools import partial
from pathlib import Path

from benchmarks.analysis import recommend
from benchmarks.analysis.recommend import RULE, WITHIN, Recommendation
from benchmarks.analysis.statistics import proportion
from benchmarks.cli.common import add_folder, add_run, command_line, console, count, policy_name, run_all, trust
from benchmarks.policies.spec import resolve_apart
from benchmarks.report import terminal
from benchmarks.tuning.search import Task, judge, seeds, summary, tune, write_gains
from controllers.registry import tuned_gains
from fbl_gym.scenarios import Scenario, as_scenario


def add_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument(
        "scenario", nargs="?", default="hardware-nominal", metavar="SCENARIO",
        help="a scenario with your arm: a name or a TOML file (hardware-nominal)",
    )  # fmt: skip
    parser.add_argument(
        "--policies", nargs="+", type=policy_name, metavar="POLICY",
        help="to choose from (the laws, with tuned gains where there are some, and the agents)",
    )  # fmt: skip
    parser.add_argument(
        "--trials", type=count, metavar="N", help="retune the three best for this arm, with so many trials each"
    )
    parser.add_argument(
        "--check", type=count, metavar="N", help="check the first choice on so many drawn arms in mujoco-lab instead"
    )
    parser.add_argument("--json", action="store_true", help="print JSON")
    add_folder(parser, "--storage", "results/recommend", "the studies and gains of --trials")
    add_run(parser, seeds=16)


def run(arguments: argparse.Namespace) -> int:
    """Run the command and return its exit status: 1 if no policy is safe."""
    if arguments.seeds < 2:
        raise ValueError(f"--seeds must be at least 2 for an interval, got {arguments.seeds}")
    trust(arguments)
    policies, run_cells = arguments.policies or recommend.candidates(), partial(run_all, arguments=arguments)
    if arguments.check:
        return _check(arguments, policies, run_cells)
    base = as_scenario(arguments.scenario)
    result = recommend.recommend(base, policies, arguments.seeds, run_cells)
    if arguments.trials:
        best = [choice.policy for choice in result.choices]
        retuned = [_retune(name, base, arguments.trials, arguments.storage) for name in best]
        result = recommend.recommend(base, [*best, *retuned], arguments.seeds, run_cells)
    if arguments.json:
        print(json.dumps({**dataclasses.asdict(result), "safe": result.safe, "rule": RULE}, indent=1))
    else:
        _print(result)
    return 0 if result.safe else 1


def _retune(policy: str, base: Scenario, trials: int, folder: Path) -> str:
    """Tune a policy on practice motions of an arm, and return its text with the gains."""
    name = policy.removesuffix("@tuned")
    calm = recommend.practice(base)
    tried, fresh = seeds(8, 32)
    task = Task(resolve_apart(name), (calm, recommend.around(calm)["everything"]), tried)
    judging = dataclasses.replace(task, seeds=fresh)
    given = tuned_gains(policy) if policy.endswith("@tuned") else {}
    also = {gain: min(max(given[gain], low), high) for gain, (low, high) in task.ranges.items() if gain in given}
    study = tune(task, trials, folder, also)
    best = summary(task, study, judging, judge(judging, study, 3), command_line())
    return f"{name}@{write_gains(best, folder / task.digest)}" if best["gains"] else name


def _print(result: Recommendation) -> None:
    screen = console()
    if not result.safe:
        screen.print(f"No policy is safe on {result.scenario}. The best of those that are not:", style="bold")
    rows = [
        (
            choice.policy,
            f"{choice.median_pct:.3g} %",
            f"{choice.worst_pct:.3g} %",
            f"{choice.diverged} of {choice.runs} (< {100 * choice.diverged_bound:.1f} %)",
            "-" if choice.delay_margin_s is None else f"{1e3 * choice.delay_margin_s:.1f} ms",
            f"{choice.effort:.2f}",
        )
        for choice in result.choices
    ]
    header = ("policy", "error", "worst 5 %", "diverged (bound)", "delay margin", "effort")
    screen.print(terminal.table(f"{result.scenario}, {len(result.conditions)} conditions", header, rows))
    screen.print(f"conditions: {', '.join(result.conditions)}")
    first = result.choices[0].policy
    for condition, (policy, error, reference) in result.overturned.items():
        screen.print(f"{condition}: {policy} is better, {error:.3g} % against {reference:.3g} % of {first}")
    for reason in dict.fromkeys(result.failed.values()):
        without = ", ".join(policy for policy, why in result.failed.items() if why == reason)
        screen.print(f"without {without}: {reason}", markup=False)
    screen.print(f"{RULE}.\nerror: median of the runs of all conditions. delay margin: with exact sensors.")


def _check(arguments: argparse.Namespace, policies: Sequence[str], run_cells: recommend.Run) -> int:
    """Print the check of each drawn arm, and the share of good first choices."""
    rows = []
    for row in recommend.check(arguments.check, policies, arguments.seeds, run_cells):
        rows.append(row)
        if not arguments.json:
            choice = f"{row.choice}: {row.ratio:.2f} x, {row.diverged} diverged" if row.choice else "none is safe"
            print(f"{row.scenario}: {choice}; best in mujoco-lab: {row.best}", flush=True)
    chosen = [row for row in rows if row.choice]
    if arguments.json:
        print(json.dumps([dataclasses.asdict(row) for row in rows], indent=1))
    elif chosen:
        good = sum(row.ratio <= WITHIN for row in chosen)
        share = proportion(good, len(chosen))
        print(
            f"{good} of {len(chosen)} first choices within {WITHIN:g} times the best ({100 * share.low:.0f} to "
            f"{100 * share.high:.0f} %); none was safe on {len(rows) - len(chosen)} arms"
        )
    return 0
