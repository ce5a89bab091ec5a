"""`fbl-gym recommend`."""

import argparse
import dataclasses
import json
from functools import partial

from benchmarks.analysis import recommend
from benchmarks.analysis.recommend import RULE, Recommendation
from benchmarks.cli.common import add_run, policy_name, results_by_id, trust
from benchmarks.report.terminal import Screen, table
from fbl_gym.scenarios import as_scenario


def add_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument(
        "scenario", nargs="?", default="servo-nominal", metavar="SCENARIO",
        help="a scenario with your arm: a name or a TOML file (servo-nominal)",
    )  # fmt: skip
    parser.add_argument(
        "--policies", nargs="+", type=policy_name, metavar="POLICY",
        help="to choose from (the laws, with tuned gains where there are some, and the agents)",
    )  # fmt: skip
    parser.add_argument("--json", action="store_true", help="print JSON")
    add_run(parser, seeds=16)


def run(arguments: argparse.Namespace) -> int:
    """Run the command and return its exit status: 1 if no policy is safe."""
    if arguments.seeds < 2:
        raise ValueError(f"--seeds must be at least 2 for an interval, got {arguments.seeds}")
    trust(arguments)
    policies, run_cells = arguments.policies or recommend.candidates(), partial(results_by_id, arguments=arguments)
    base = as_scenario(arguments.scenario)
    result = recommend.recommend(base, policies, arguments.seeds, run_cells)
    if arguments.json:
        print(json.dumps({**dataclasses.asdict(result), "safe": result.safe, "rule": RULE}, indent=1))
    else:
        _print(result)
    return 0 if result.safe else 1


def _print(result: Recommendation) -> None:
    screen = Screen()
    if not result.safe:
        screen.print(f"No policy is safe on {result.scenario}. The best of those that are not:", style="bold")
    rows = [
        (
            choice.policy,
            f"{choice.median_pct:.3g} %",
            f"{choice.worst_pct:.3g} %",
            f"{choice.diverged} of {choice.runs} (< {100 * choice.diverged_bound:.1f} %)",
            f"{choice.effort:.2f}",
        )
        for choice in result.choices
    ]
    header = ("policy", "error", "worst 5 %", "diverged (bound)", "effort")
    screen.print(table(f"{result.scenario}, {len(result.conditions)} conditions", header, rows))
    screen.say(f"conditions: {', '.join(result.conditions)}")
    first = result.choices[0].policy
    for condition, (policy, error, reference) in result.overturned.items():
        screen.say(f"{condition}: {policy} is better, {error:.3g} % against {reference:.3g} % of {first}")
    for reason in dict.fromkeys(result.failed.values()):
        without = ", ".join(policy for policy, why in result.failed.items() if why == reason)
        screen.say(f"without {without}: {reason}")
    screen.say(f"{RULE}.\nerror: median of the runs of all conditions.")
