"""`fbl-gym transfer`."""

import argparse
import sys

import numpy as np

from benchmarks.analysis.transfer import Agreement, Runs, compare_halves, compare_orders, transfer_best
from benchmarks.cli.common import add_policies, add_run, console, count, run_all, trust
from benchmarks.policies.spec import names
from benchmarks.report import markdown, terminal
from benchmarks.run.suite import Suite
from fbl_gym import scenarios

_PACKAGE = "package"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    add_policies(parser, "*", "every policy but nmpc")
    parser.add_argument(
        "--scenario", nargs="+", default=scenarios.in_tier("hardware", [2]), metavar="S",
        help="names of scenarios (the tier hardware at severity 2)",
    )  # fmt: skip
    parser.add_argument(
        "--world", nargs="+", choices=scenarios.WORLDS, default=["mujoco-lab"], metavar="W",
        help=f"out of {', '.join(scenarios.WORLDS)} (mujoco-lab)",
    )  # fmt: skip
    parser.add_argument("--top", type=count, default=5, metavar="N", help="best policies to follow into the worlds (5)")
    parser.add_argument("--markdown", action="store_true", help="print the tables in Markdown")
    add_run(parser, seeds=16)


def run(arguments: argparse.Namespace) -> int:
    """Run the policies in all worlds, print how their orders agree, and return the exit status."""
    if arguments.seeds < 4:
        raise ValueError(f"--seeds must be at least 4, two for each half, got {arguments.seeds}")
    trust(arguments)
    policies = arguments.policies or [name for name in names() if not name.startswith("nmpc")]
    tasks = [scenarios.get(name) for name in arguments.scenario]
    worlds = {world: [scenarios.in_world(task, world) for task in tasks] for world in arguments.world}
    suites = {
        side: Suite("transfer", tuple(policies), tuple(members), arguments.seeds)
        for side, members in {_PACKAGE: tasks, **worlds}.items()
    }
    results = run_all([cell for suite in suites.values() for cell in suite.cells], arguments)
    failures: dict[str, str] = {}
    for result in results.values():
        if result.error:
            failures.setdefault(result.cell.policy.name, result.error)
    for name, reason in failures.items():
        print(f"fbl-gym: without {name}, which failed: {reason}", file=sys.stderr)
    specs = {cell.policy.name: cell.policy for cell in suites[_PACKAGE].cells if cell.policy.name not in failures}
    if not specs:
        raise ValueError("every policy failed on a scenario, so no order can be compared")
    runs = {
        side: Runs.of([[results[f"{name}/{task.name}"] for task in suite.scenarios] for name in specs])
        for side, suite in suites.items()
    }
    _print_orders(arguments, runs)
    _print_best(arguments, runs, list(specs), np.array([spec.ranked for spec in specs.values()]))
    return 1 if failures else 0


def _print_orders(arguments: argparse.Namespace, runs: dict[str, Runs]) -> None:
    """Print Kendall's tau of each family, and of all scenarios together."""
    families: dict[str, list[int]] = {}
    for i, name in enumerate(arguments.scenario):
        member = scenarios.member(name)
        families.setdefault(member.family if member else name, []).append(i)
    if len(arguments.scenario) > 1:
        families["all"] = list(range(len(arguments.scenario)))
    header = ["family", *(f"{world}{part}" for world in arguments.world for part in ("", ", halves"))]
    lines = []
    for family, members in families.items():
        some = {side: r[:, members] for side, r in runs.items()}
        line = [family]
        for world in arguments.world:
            halves = [compare_halves(some[side]) for side in (_PACKAGE, world)]
            line += [_tau(compare_orders(some[_PACKAGE], some[world])), " / ".join(map(_tau, halves))]
        lines.append(line)
    title = f"tau (pairs) between the orders on the package's arm and in a world, {arguments.seeds} seeds"
    _print(arguments, title, header, lines)
    print("pairs: both sides separate them. halves: the same between halves of the seeds, package's arm / world")


def _print_best(arguments: argparse.Namespace, runs: dict[str, Runs], policies: list[str], ranked: np.ndarray) -> None:
    """Print the best policies on the package's arm, in each world."""
    header = ["policy", "world", "error", "diverged", "x best there", "worst scenario: x best there"]
    lines = []
    for world in arguments.world if ranked.any() else ():
        total = runs[world].diverged[0].size
        for best in transfer_best(runs[_PACKAGE], runs[world], ranked, arguments.top):
            place = f"{arguments.scenario[best.scenario]}: {best.worst:.2f}"
            lost = f"{best.diverged} of {total}"
            lines.append([policies[best.policy], world, f"{best.error:.3g} %", lost, f"{best.ratio:.2f}", place])
    _print(arguments, f"the best {arguments.top} on the package's arm over all scenarios", header, lines)
    print("error: geometric mean over runs. The order is that of the score: diverged runs have a price.")


def _print(arguments: argparse.Namespace, title: str, header: list[str], lines: list[list[str]]) -> None:
    if arguments.markdown:
        print(markdown.table(header, lines))
    else:
        console().print(terminal.table(title, header, lines))


def _tau(agreement: Agreement) -> str:
    return f"{agreement.tau:.2f} ({agreement.pairs})"
